"""Flutter: vibrations that loads without an energy (followers, friction, spin) feed."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pisplit.checks import Array
from pisplit.mapping import Buffered
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.terms.loads import NoEffect

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene
    from pisplit.models.rod.statics.whitened import Whitened

#: Growth in parts of the frequency from which on a vibration grows (that of loads with an energy is 1e-12 or less), and
#: in a scene that damps nothing: a damping ratio of that much, less than any material has, would end what is slower.
GROWS, UNDAMPED = 1e-6, 1e-3
#: Sum of the damping ratios, in parts of what it could be, up to which nothing is damped.
NO_DAMPING = 1e-10
#: Rate in parts of the first bending rate below which motions are the business of statics.
SLOW = 1e-3
#: Skew part of the stiffness, in parts of the elastic one, up to which loads count as those of an energy, and up to
#: which a way is not looked at that ends at rest.
SKEW, MILD = 1e-7, 0.1
#: Points of a way that are looked at before its end if that flutters or is at rest, and halvings by which the load is
#: found where flutter begins.
SHAKEN, CALM, HALVINGS = 4, 2, 12
#: Modes of the unloaded rod, the slowest ones, in which a vibration on the way to an end without one is looked for.
SLOWEST = 10


@dataclass(frozen=True)
class Vibration:
    """The vibration of small size about an equilibrium that grows fastest in parts of its frequency.

    Attributes:
        value: its eigenvalue in 1/s.
    """

    value: complex

    def __str__(self) -> str:
        """``a vibration of 0.9 Hz grows by 1.2 1/s``."""
        return f"a vibration of {abs(self.value) / (2.0 * np.pi):.3g} Hz grows by {self.value.real:.2g} 1/s"


@dataclass(frozen=True)
class Spot:
    """An equilibrium on a way.

    Attributes:
        t: parameter of the way.
        y: whitened strains (n,).
        u: inputs (n_inputs,).
        part: of the loads that act.
        stiffness: about it (n, n), under that part.
    """

    t: float
    y: Array
    u: Array
    part: float
    stiffness: Array


class Flutter(Rebuilt):
    """Tells equilibria about which a vibration grows, by the eigenvalues of the linearised motion.

    M d'' + D d' + H d = 0 with the inertia and the damping of the scene: what it has, for small damping of the material
    may lower the load at which a rod flutters (Beck's column: 20.05 EI/L^2 without any, 10.94 in the limit of little;
    V. V. Bolotin, *Nonconservative Problems of the Theory of Elastic Stability*, 1963).

    Args:
        whitened: the balance in which stiffness is judged.
    """

    def __init__(self, whitened: Whitened) -> None:
        self.whitened = whitened

    def at(self, y: Array, u: Array, part: float = 1.0) -> Vibration | None:
        """The vibration that grows about the strains ``y`` (n,) under a ``part`` of the loads; None where none does.

        Args:
            y: whitened strains.
            u: inputs (n_inputs,).
            part: of the loads; those that depend on rates act as a whole.
        """
        whole = self.whitened.stiffness(y, u)
        return self.under(y, u, part * whole + (1.0 - part) * self.whitened.identity)

    def under(
        self, y: Array, u: Array, stiffness: Array, along: Array | None = None, across: Array | None = None
    ) -> Vibration | None:
        """The same with a ``stiffness`` H (n, n), of motions d = Z q where the tip is held.

        Args:
            y: whitened strains.
            u: inputs (n_inputs,).
            stiffness: H.
            along: Z (n, f), the motions that the conditions leave; all when not given.
            across: W (n, f), what balances are left by their multipliers; all when not given.
        """
        scene, (of_x, of_residual, _) = self.whitened.search.scene, self.whitened.sizes
        layout, (fractions, relaxing) = scene.layout, scene.relaxation
        of_strains = scene.nominal_strains / of_x  # of y
        rows = -of_residual / scene.nominal_residual
        strains = self.whitened.search.strains(self.whitened.unknowns(y))
        n, hidden = len(strains), layout.n_overstress
        columns = (rows * self._inertia(strains, u)[0].reshape(2 * n + hidden, n)).T  # rows of the balance
        mass, right = columns[:, :n] * of_strains, np.hstack([stiffness, columns[:, n:]])
        right[:, n : 2 * n] *= of_strains
        strained = np.diag(of_strains)
        if along is not None and across is not None:
            still, moved, felt = (right[:, k * n : (k + 1) * n] for k in range(3))
            mass, strained = across.T @ mass @ along, of_strains[:, None] * along
            right = across.T @ np.hstack([still @ along, moved @ along, felt])
        free, moving = len(mass), slice(len(mass), 2 * len(mass))
        generator = np.zeros((2 * free + hidden,) * 2)
        np.fill_diagonal(generator[:free, moving], 1.0)
        if hidden:
            generator[2 * free :, moving] = fractions[:, None] * np.tile(
                strained[: layout.n_free], (layout.n_branches, 1)
            )
            generator[2 * free :, 2 * free :] = -np.diag(relaxing)
        try:
            generator[moving] = -np.linalg.solve(mass, right)
            return growing(scene, np.linalg.eigvals(generator))
        except np.linalg.LinAlgError:  # numbers that are not finite, which the balance tells
            return None

    @cached_property
    def _inertia(self) -> Buffered:
        """``(xi, u) -> `` derivatives of the balance at rest with respect to [xi_tt, xi_t, sigma], as one matrix."""
        scene = self.whitened.search.scene
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NoEffect)  # said by the scene itself
            xi, xi_t, xi_tt, acting, balance = scene.dynamic_balance
        hidden = scene.layout.n_overstress
        still = [ca.SX.zeros(scene.n_strains), ca.SX.zeros(scene.n_strains), ca.SX.zeros(hidden)]
        wanted = [ca.jacobian(balance.residual, symbol) for symbol in (xi_tt, xi_t, acting)]
        at_rest = ca.substitute(wanted, [xi_t, xi_tt, acting[:hidden, :]], still)
        at_rest[2] = at_rest[2][:, :hidden]
        return Buffered(ca.Function("inertia", [xi, acting[hidden:, :]], [ca.densify(ca.horzcat(*at_rest))]))

    @cached_property
    def _slowest(self) -> Array:
        """Slowest modes (n, f) of the unloaded rod, of unit size."""
        scene, (of_x, of_residual, _) = self.whitened.search.scene, self.whitened.sizes
        n = scene.n_strains
        strains = self.whitened.search.strains(self.whitened.unknowns(np.zeros(n)))
        columns = self._inertia(strains, np.zeros(scene.n_inputs))[0].reshape(-1, n)[:n]
        mass = (-of_residual / scene.nominal_residual * columns).T * (scene.nominal_strains / of_x)
        modes: Array = np.linalg.eigh(0.5 * (mass + mass.T))[1]
        return modes[:, -SLOWEST:]

    def met(self, way: list[Spot]) -> tuple[Vibration | None, tuple[float, Vibration] | None]:
        """The vibration that grows at the end of a ``way``, and parameter and vibration where one does first.

        None where there is none: at the end, and at the few points that are looked at; equilibria between those of the
        way are interpolated. Loads that are hardly skew are looked at where they are largest; on the way to an end
        about which nothing grows, motions in the slowest modes alone.
        """
        end = way[-1]
        skew = _skew(end.stiffness)
        if skew <= SKEW * np.sqrt(len(end.y)):
            return None, None
        at_end = self.under(end.y, end.u, end.stiffness)
        if at_end is None and skew <= MILD:
            return None, None
        points = (CALM if at_end is None else SHAKEN) + 2
        before = way[0]
        for k in np.unique(np.linspace(0, len(way) - 1, points).astype(int)[1:]).tolist():
            there = at_end if k == len(way) - 1 else self._on_the_way(way[k], at_end is None)
            if there is not None:
                return at_end, self._between(before, way[k], there)
            before = way[k]
        return None, None

    def _on_the_way(self, spot: Spot, slowest: bool) -> Vibration | None:
        """The vibration that grows about a ``spot``, in the ``slowest`` modes first where they rule it out."""
        if slowest and _skew(spot.stiffness) <= MILD:
            return None
        if slowest and len(spot.y) > SLOWEST:
            modes = self._slowest
            if self.under(spot.y, spot.u, spot.stiffness, modes, modes) is None:
                return None
        return self.at(spot.y, spot.u, spot.part)

    def _between(self, calm: Spot, shaken: Spot, found: Vibration) -> tuple[float, Vibration]:
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            s = 0.5 * (low + high)
            y, u = ((1.0 - s) * a + s * b for a, b in ((calm.y, shaken.y), (calm.u, shaken.u)))
            part = (1.0 - s) * calm.part + s * shaken.part
            there = self.at(y, u, part)
            low, high, found = (s, high, found) if there is None else (low, s, there)
        return calm.t + high * (shaken.t - calm.t), found


def _skew(stiffness: Array) -> float:
    return 0.5 * float(np.linalg.norm(stiffness - stiffness.T))


def growing(scene: Scene, values: NDArray[Any]) -> Vibration | None:
    """The growing vibration of ``scene`` among the eigenvalues ``values`` (q,) of its linear dynamics, or None."""
    size: Array = np.abs(values)
    damped = -float(values.real.sum()) > NO_DAMPING * float(size.sum())  # what a vibration gains its twin loses
    least = GROWS if damped else UNDAMPED
    grows = (values.real > least * size) & (size > SLOW * scene.rod.bending_rate)
    if not grows.any():
        return None
    worst = values[np.where(grows, values.real / np.maximum(size, 1e-300), -1.0).argmax()]
    return Vibration(complex(worst.real, abs(worst.imag)))
