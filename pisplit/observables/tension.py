"""What tendons feel of state and coming command together: the joint feature behind slack."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import positive

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tension:
    """Stretch of every tendon, a function of state and command: a tendon is slack where it is negative.

    A tendon that is let out by u_i (displacements pull where they are positive) is stretched by e_i = u_i + a_i(x), and
    pulls where e_i > 0. Which tendons are slack depends on state and command together, so no column of the state alone
    or of the command alone says it. ``ReliftedEDMDc(tension=)`` makes softplus functions of the stretch, gates that say
    whether a tendon pulls, their products in pairs, and gates times all coordinates of it, with the stretch at the
    begin, in the middle and at the end of the step under the *coming* command.

    Args:
        function: x (n,) -> (2 m,): a (m,) in the unit of the inputs, and its rate in that unit per s; of an arm
            ``arm.tension(stations)``.
        widths: of the two softplus functions, in parts of the spread of the inputs.
        gate: width of the gates, in parts of that spread.

    Raises ValueError for a function that is none of CasADi of one state, and for widths that are not positive.
    """

    function: ca.Function
    widths: tuple[float, ...] = (0.015, 0.15)
    gate: float = 0.15

    def __post_init__(self) -> None:
        if not isinstance(self.function, ca.Function) or self.function.n_in() != 1 or self.function.size2_in(0) != 1:
            raise ValueError(
                "function is not one of CasADi of one state x (n,); an arm gives it: arm.tension(stations)"
            )
        for width in (*self.widths, self.gate):
            positive(width, "Tension width")

    def along(self, x: Array, m: int) -> tuple[Array, Array]:
        """a (N, m) and its rate (N, m) at states ``x`` (N, n), for ``m`` inputs.

        Raises ValueError where the function is one of other states or inputs.
        """
        sizes = self.function.size1_in(0), self.function.size1_out(0)
        if sizes != (x.shape[1], 2 * m):
            told = f"the function of Tension takes {sizes[0]} states and gives {sizes[1]} values"
            raise ValueError(
                f"{told}; expected {x.shape[1]} and {2 * m}, two a tendon: give that of this arm and its stations"
            )
        found = np.asarray(self.function.map(len(x))(x.T)).T
        return found[:, :m], found[:, m:]
