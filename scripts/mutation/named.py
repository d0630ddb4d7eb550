"""Mutations that are always tried: each breaks a fact that a test states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mutation.operators import Mutation, replaced


@dataclass(frozen=True)
class Named:
    """In ``file``, ``old`` (found once) becomes ``new``, which breaks ``fact``."""

    file: str
    old: str
    new: str
    fact: str

    def mutation(self, root: Path) -> Mutation | None:
        """The mutation of the source as it is now; None where ``old`` is not found exactly once."""
        path = root / self.file
        source = path.read_bytes() if path.is_file() else b""
        old = self.old.encode()
        if source.count(old) != 1:
            return None
        start = source.index(old)
        return replaced(self.file, source, start, start + len(old), self.new, "named")


#: The two lines of Strang's splitting that say where the half steps stand, and what is between them.
STRANG = '''return unknown_part(self.context, k_f.K, k_f.K, moments, alpha)

    def composed(self, k_f: HalfStep, k_h: Unknown) -> SplitFit:
        """K_f K_h K_f of the half step ``k_f`` and the kick ``k_h`` (paper, eq. koopman_strang_splitting)."""
        k = k_f.K @ k_h.K @ k_f.K'''

NAMED = (
    Named(
        "pisplit/splitting/strang.py",
        STRANG,
        STRANG.replace("k_f.K, k_f.K,", "k_f.K @ k_f.K, __import__('numpy').eye(len(k_f.K)),").replace(
            "k_f.K @ k_h.K @ k_f.K", "k_f.K @ k_f.K @ k_h.K"
        ),
        "K_f K_h K_f is of order 2 in dt, K_f^2 K_h of order 1",
    ),
    Named(
        "controllers/mpc/mpc.py",
        "y_free += np.tile(estimation.readout[list",
        "y_free -= np.tile(estimation.readout[list",
        "no offset with a wrong read-out C",
    ),
    Named(
        "pisplit/estimators/alpha_search.py",
        "return 1.0 / column_scales(std, theta.names.quantities)",
        "return np.ones(len(std))",
        "the choice of alpha does not depend on the units of the states",
    ),
    Named(
        "models/rod/equations/balance.py",
        "j * alpha + columnwise_cross(omega, j * omega)",
        "j * alpha - columnwise_cross(omega, j * omega)",
        "Euler's equations: J alpha + omega x J omega",
    ),
    Named(
        "controllers/feedforward.py",
        "self._limits.project(wanted, self._u)",
        "np.clip(wanted, self.u_min, self.u_max)",
        "feed-forward respects the rate limit",
    ),
    Named(
        "models/rod/terms/tendons.py",
        "tension = tension * float(np.sum(motion.rule.weights[:n])) / (decay @ weights)",
        "tension = tension * 1.0",
        "the stretch of a tendon with friction is that of its mean tension",
    ),
    Named(
        "models/rod/terms/points.py",
        "radius**2 / 4.0 + thickness**2 / 12.0",
        "radius**2 / 4.0",
        "a thick disc resists tilting more: m (r^2 / 4 + h^2 / 12)",
    ),
    Named(
        "pisplit/evaluation/horizon.py",
        "(piece.diverged_at[:, None] <= ahead)",
        "(piece.diverged_at[:, None] < ahead)",
        "a roll-out that diverges at step h is lost at horizon h",
    ),
    Named(
        "pisplit/data/units.py",
        "factor = UNITS[parts[0]][1] / (UNITS[parts[1]][1]",
        "factor = UNITS[parts[0]][1] * (UNITS[parts[1]][1]",
        "1 mm/ms is 1 m/s",
    ),
    Named(
        "pisplit/estimators/twin.py",
        "np.sqrt(alpha), np.sqrt(1.0 + alpha)",
        "np.sqrt(alpha), 1.0",
        "the ridge of a twin is (1 + alpha) mu: it stays in proportion to the data",
    ),
    Named(
        "pisplit/regression/penalties.py",
        "float((a**2).sum()) / a.shape[1]",
        "float((a**2).sum())",
        "generator_alpha is relative to the mean diagonal of the Gram matrix",
    ),
    Named(
        "pisplit/generator/generator.py",
        "unit = unit_weight(a, y, options.penalty) if alpha > 0.0 else 0.0",
        "unit = 1.0",
        "generator_alpha has no unit: it is relative to the Gram matrix",
    ),
    Named(
        "pisplit/estimators/boundedness.py",
        "EXCURSION * np.max([state_range",
        "EXCURSION * np.min([state_range",
        "the limit of an excitation is that of the data set that reaches farthest",
    ),
    Named(
        "models/rod/statics/search.py",
        "TOLERANCE = 1e-8",
        "TOLERANCE = 1e-3",
        "an equilibrium that is called solved solves the equations",
    ),
    Named(
        "pisplit/lifted/operators.py",
        "source, at = target, at + len(source)",
        "at = at + len(source)",
        "x[k-2] becomes what x[k-1] was",
    ),
    Named(
        "models/rod/kinematics/kinematics.py",
        "self.tangent) + 2.0 * self._stretching",
        "self.tangent) + 1.0 * self._stretching",
        "Coriolis acceleration is 2 omega x v",
    ),
)
