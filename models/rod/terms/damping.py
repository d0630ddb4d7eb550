"""Internal damping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from pisplit.checks import non_negative
from pisplit.models.rod.kinematics.kinematics import Motion
from pisplit.models.rod.terms.loads import Input, Loads


@dataclass(frozen=True)
class KelvinVoigt:
    """Kelvin-Voigt material damping: stress proportional to strain rate.

    Args:
        bending, torsion: coefficients of w_t (``Bbt`` of the paper) in N m^2 s.
        shear, stretch: coefficients of v_t (``Bse``) in N s; without effect where those strains are not free.
    """

    bending: float = 0.0
    torsion: float = 0.0
    shear: float = 0.0
    stretch: float = 0.0

    def __post_init__(self) -> None:
        for name in ("bending", "torsion", "shear", "stretch"):
            non_negative(getattr(self, name), f"KelvinVoigt {name}")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def coefficient(self, component: int) -> float:
        """Damping of one of the strains (w1, w2, w3, v1, v2, v3). ``component`` counts them from 0 to 5."""
        return (self.bending, self.bending, self.torsion, self.shear, self.shear, self.stretch)[component]

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Stress B w_t and B v_t. ``motion`` is that of the rod; ``loads`` takes what is added."""
        loads.stress_w += ca.mtimes(_diagonal(self, 0), motion.w_t)
        loads.stress_v += ca.mtimes(_diagonal(self, 3), motion.v_t)

    def idle(self, rod: Any, terms: tuple[Any, ...]) -> str | None:
        """Which coefficients act on nothing, if any: those of strains that are not free in the ``rod``.

        ``rod`` and ``terms`` are those of the scene.
        """
        parts = {"bending": (0, 1), "torsion": (2,), "shear": (3, 4), "stretch": (5,)}
        free = set(rod.strain_set.free)
        names = [name for name, strains in parts.items() if getattr(self, name) > 0.0 and not free & set(strains)]
        if not names:
            return None
        return f"{' and '.join(names)}: no effect on a rod whose strains ({rod.strain_set.name}) do not include it"

    def describe(self, rod: Any) -> str:
        """Coefficients. ``rod`` is that of the scene."""
        return f"Kelvin-Voigt damping, bending {self.bending:g}, torsion {self.torsion:g} N m^2 s"


@dataclass(frozen=True)
class Retardation:
    """Kelvin-Voigt material damping in proportion to the stiffness: stress ``time * K * strain rate`` in every strain.

    The coefficients follow the section where it varies, and shear and stretch are damped as bending is.

    Args:
        time: retardation time in s.
    """

    time: float

    def __post_init__(self) -> None:
        non_negative(self.time, "Retardation time", "s")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """None."""
        return ()

    def coefficient(self, component: int) -> float:
        """Positive where the strain is damped: everywhere, unless the time is zero.

        ``component`` counts the strains from 0 to 5.
        """
        return self.time

    def apply(self, motion: Motion, loads: Loads) -> None:
        """Stress time K w_t and time K v_t at every node.

        ``motion`` is that of the rod; ``loads`` takes what is added.
        """
        if motion.rates.nnz() == 0 or self.time == 0.0:
            return
        damping = ca.DM(self.time * motion.profile.stiffness)
        loads.stress_w += damping[:3, :] * motion.w_t
        loads.stress_v += damping[3:, :] * motion.v_t

    def describe(self, rod: Any) -> str:
        """Time. ``rod`` is that of the scene."""
        return f"Kelvin-Voigt damping, retardation time {self.time:g} s"


def _diagonal(damping: KelvinVoigt, first: int) -> ca.SX:
    return ca.sparsify(ca.diag(ca.SX(ca.DM([damping.coefficient(first + k) for k in range(3)]))))
