"""Natural modes of a scene about an equilibrium."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.analysis.fields import station_points

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene


@dataclass(frozen=True)
class NaturalModes:
    """Natural modes of the linear dynamics about an equilibrium, slowest first; one of each conjugate pair.

    Attributes:
        frequency: (M,) |lambda| / 2 pi in Hz.
        damping: (M,) ratio -Re(lambda) / |lambda|; 1 for modes that do not oscillate, negative for those that grow.
        eigenvalues: (M,) lambda in 1/s, imaginary part >= 0.
        strains: (M, n_strains) complex shapes of the free strains, largest tip displacement 1 m (where the tip moves).
        state: the equilibrium (n_states,) of ``scene`` about which it moves.
    """

    frequency: Array
    damping: Array
    eigenvalues: NDArray[np.complex128]
    strains: NDArray[np.complex128]
    state: Array = field(repr=False)
    scene: Scene = field(repr=False, compare=False)

    def displacements(self, stations: int | ArrayLike = 6) -> NDArray[np.complex128]:
        """Displacement shapes (M, S, 3) in m at stations, in world axes."""
        points = station_points(stations, self.scene.rod.length)
        slope = _position_slope(self.scene, points, self.state)
        return (self.strains @ slope.T).reshape(len(self.strains), len(points), 3)


def natural_modes(scene: Scene, state: ArrayLike, number: int | None = None) -> NaturalModes:
    """The slowest ``number`` modes (all when not given) of ``scene`` about an equilibrium ``state`` [xi, 0, u]."""
    x = finite_array(state, "state", (scene.n_states,)).copy()
    n = scene.n_strains
    values, vectors = np.linalg.eig(scene.linearise(x).A)
    kept = np.flatnonzero(values.imag >= 0.0)
    kept = kept[np.argsort(np.abs(values[kept]))][: None if number is None else count(number, "number")]
    values, strains = values[kept].astype(np.complex128), vectors[:n, kept].T.astype(np.complex128)
    tips = strains @ _position_slope(scene, (scene.rod.length,), x).T
    largest = tips[np.arange(len(tips)), np.abs(tips).argmax(axis=1)]
    moving = np.abs(largest) > 1e-9 * scene.rod.length**2 * np.abs(strains).max(axis=1)
    strongest = strains[np.arange(len(strains)), np.abs(strains).argmax(axis=1)]
    strains = strains / np.where(moving, largest, strongest)[:, None]
    size = np.abs(values)
    damping = np.divide(-values.real, size, out=np.zeros(len(size)), where=size > 0.0)
    return NaturalModes(size / (2.0 * np.pi), damping, values, strains, x, scene)


def _position_slope(scene: Scene, points: tuple[float, ...], state: Array) -> Array:
    """Derivative (3 S, n_strains) of the positions at arclengths."""
    xi, u, balance = scene.static_balance
    slope = ca.jacobian(ca.vec(balance.motion.position_at(list(points))), xi)
    n = scene.n_strains
    return np.asarray(ca.Function("slope", [xi, u], [slope])(state[:n], state[2 * n :]), dtype=np.float64)
