"""How fast tendons slide through what they rub on: the joint feature behind friction that turns round."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import positive

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Slip:
    """Speeds at which tendons slide at several places; friction there turns round with their signs.

    Dry friction multiplies what tendons do to an arm by a factor that depends on the sign of slip at every disk, and so
    no polynomial of the states holds it. ``ReliftedEDMDc(slip=)`` makes gates of the mean slip over the coming step,
    which state and coming command tell together, and gates times all coordinates of it.

    Args:
        function: x (n,) -> (G,), speeds at G places; of an arm ``arm.slip(stations)``.
        widths: of the gates, in parts of the spread of the fastest slip.

    Raises ValueError for a function that is none of CasADi of one state, and for widths that are not positive.

    Source: smoothed Coulomb friction, Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30 (1994).
    """

    function: ca.Function
    widths: tuple[float, ...] = (0.05, 0.2)

    def __post_init__(self) -> None:
        if not isinstance(self.function, ca.Function) or self.function.n_in() != 1 or self.function.size2_in(0) != 1:
            raise ValueError("function is not one of CasADi of one state x (n,); an arm gives it: arm.slip(stations)")
        for width in self.widths:
            positive(width, "Slip width")

    def speeds(self, x: Array) -> Array:
        """Speeds (N, G) at states ``x`` (N, n).

        Raises ValueError where the function is one of other states.
        """
        if self.function.size1_in(0) != x.shape[1]:
            raise ValueError(
                f"the function of Slip takes {self.function.size1_in(0)} states; expected {x.shape[1]}: give that of "
                "this arm and its stations"
            )
        return np.asarray(self.function.map(len(x))(x.T)).T
