"""Natural modes of a scene about an equilibrium."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import null_space

from pisplit.brief import brief
from pisplit.checks import Array, count, finite_array
from pisplit.models.rod.analysis.fields import station_points

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.scene import Scene


#: Error of an eigenvalue up to which a mode counts as resolved, likeness of shapes (cosine) from which modes are one,
#: and difference of eigenvalues up to which they are the same.
RESOLVED, ALIKE, SAME = 1e-2, 0.8, 1e-3
#: Stiffness, in parts of the largest, up to which a motion costs nothing, and rate at which speeds fade, in parts of
#: the first bending rate, up to which nothing resists them.
COSTS_NOTHING, UNRESISTED = 1e-10, 1e-7
#: Imaginary part of an eigenvalue, in parts of its size, that is rounding.
ROUNDING = 1e-7
#: Stations at which shapes are compared.
POINTS = 21


@brief
@dataclass(frozen=True)
class NaturalModes:
    """Natural modes of the linear dynamics about an equilibrium, slowest first; one of each conjugate pair.

    Motions that cost nothing (a base on joints) come once each, with a frequency of zero.

    Maxwell branches add as many modes that creep, at rates not far from 1/time, as they have states. These lie close
    together, so that no single one is found again on a finer grid (``error`` infinite).

    The fastest modes of a grid are no modes of the rod: ``resolved`` says which are.

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

    @cached_property
    def error(self) -> Array:
        """Estimated error (M,) of the eigenvalues in parts of their size, infinite where a finer grid has no such mode.

        Beside the modes whose displacements are most alike on two more nodes an element; those of one frequency count
        together, for any mixture of them is a mode.
        """
        resolution = self.scene.statics().resolution
        finer = natural_modes(resolution.finer, resolution.on_finer(self.state))
        here, there = (m.displacements(POINTS).reshape(len(m.strains), -1) for m in (self, finer))
        size, length = np.abs(finer.eigenvalues), np.linalg.norm(here, axis=1)
        alike = np.zeros((len(here), len(there)))
        for k, value in enumerate(finer.eigenvalues):
            same = np.abs(finer.eigenvalues - value) <= SAME * size[k]
            basis = np.linalg.qr(there[same].T)[0]
            alike[:, k] = np.linalg.norm(here @ basis.conj(), axis=1) / np.where(length > 0.0, length, np.inf)
        nearest = alike.argmax(axis=1)
        off = np.abs(self.eigenvalues - finer.eigenvalues[nearest])
        found = np.divide(off, size[nearest], out=np.full(len(off), np.inf), where=size[nearest] > 0.0)
        return np.where(alike.max(axis=1) > ALIKE, found, np.inf)

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Which modes (M,) the nodes resolve: those whose ``error`` is at most 1e-2."""
        return np.asarray(self.error <= RESOLVED)

    def displacements(self, stations: int | ArrayLike = 6) -> NDArray[np.complex128]:
        """Displacement shapes (M, S, 3) in m at stations, in world axes."""
        points = station_points(stations, self.scene.rod.length)
        slope = _position_slope(self.scene, points, self.state)
        return (self.strains @ slope.T).reshape(len(self.strains), len(points), 3)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Shapes of the slowest modes, frequencies of all; written to ``path`` where one is given."""
        from pisplit.models.rod.analysis.pictures import plot_modes

        return plot_modes(self, path)


def natural_modes(scene: Scene, state: ArrayLike, number: int | None = None) -> NaturalModes:
    """The slowest ``number`` modes (all when not given) of ``scene`` about an equilibrium ``state`` [xi, 0, u]."""
    x = finite_array(state, "state", (scene.n_states,)).copy()
    n = scene.n_strains
    values, vectors = _without_rigid(scene, x, *_eigen(scene, x))
    real = np.abs(values.imag) <= ROUNDING * np.abs(values)  # two real ones that are the same come as a pair
    values = np.where(real, values.real, values)
    kept = np.flatnonzero(values.imag >= 0.0)
    kept = kept[np.argsort(np.abs(values[kept]), kind="stable")][: None if number is None else count(number, "number")]
    values, strains = values[kept].astype(np.complex128), vectors[:n, kept].T.astype(np.complex128)
    tips = strains @ _position_slope(scene, (scene.rod.length,), x).T
    largest = tips[np.arange(len(tips)), np.abs(tips).argmax(axis=1)]
    moving = np.abs(largest) > 1e-9 * scene.rod.length**2 * np.abs(strains).max(axis=1)
    strongest = strains[np.arange(len(strains)), np.abs(strains).argmax(axis=1)]
    strains = strains / np.where(moving, largest, strongest)[:, None]
    size = np.abs(values)
    damping = np.divide(-values.real, size, out=np.zeros(len(size)), where=size > 0.0)
    return NaturalModes(size / (2.0 * np.pi), damping, values, strains, x, scene)


def _eigen(scene: Scene, state: Array) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues (M,) and vectors (q, M) of the linear dynamics, of motions that leave a held tip in its place."""
    made, (strains, *_, inputs) = scene.linearise(state).A, scene.layout.split(state)
    *_, balance = scene.static_balance
    if balance.holding is None:
        values, vectors = np.linalg.eig(made)
        return values.astype(np.complex128), vectors.astype(np.complex128)
    xi, u, _ = scene.static_balance
    slope = ca.Function("slope", [xi, u], [balance.holding.slope @ ca.diag(ca.DM(scene.nominal_strains))])
    blocks = 2 + scene.layout.n_branches
    unit = np.tile(scene.nominal_strains, blocks)
    basis = null_space(np.asarray(slope(strains, inputs)), rcond=1e-9)
    both = np.kron(np.eye(blocks), basis)
    values, vectors = np.linalg.eig(both.T @ (made * unit / unit[:, None]) @ both)
    return values.astype(np.complex128), (unit[:, None] * (both @ vectors)).astype(np.complex128)


def _without_rigid(
    scene: Scene, state: Array, values: NDArray[np.complex128], vectors: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues (M,) and vectors (q, M) with one zero for every motion that costs nothing.

    A place and a constant speed along it are a double eigenvalue of zero, of which rounding makes any small numbers:
    they give way to the motions themselves, once each. Where something resists the speed it is a mode of its own.
    """
    rigid = _rigid(scene, state)
    n, free = scene.n_strains, rigid.shape[1]
    if not free:
        return values, vectors
    speeds = scene.linearise(state).A[n : 2 * n, n : 2 * n] @ rigid / scene.nominal_strains[:, None]
    sizes = np.linalg.norm(rigid / scene.nominal_strains[:, None], axis=0)
    resisted = int((np.linalg.svd(speeds / sizes, compute_uv=False) > UNRESISTED * scene.rod.bending_rate).sum())
    order = np.argsort(np.abs(values))[2 * free - resisted :]
    whole = np.vstack([rigid, np.zeros((vectors.shape[0] - n, free))]).astype(np.complex128)
    return np.concatenate([np.zeros(free, dtype=np.complex128), values[order]]), np.hstack([whole, vectors[:, order]])


def _rigid(scene: Scene, state: Array) -> Array:
    """Coordinates (n_strains, r) of the motions of a rod on joints, with a free tip, that cost nothing."""
    xi, u, balance = scene.static_balance
    if not scene.n_joint or balance.holding is not None:
        return np.zeros((scene.n_strains, 0))
    strains, *_, inputs = scene.layout.split(state)
    unit = scene.nominal_strains
    slope = np.asarray(ca.Function("slope", [xi, u], [ca.jacobian(balance.residual, xi)])(strains, inputs))
    found: Array = unit[:, None] * null_space(slope * unit / scene.nominal_residual[:, None], rcond=COSTS_NOTHING)
    return found


def _position_slope(scene: Scene, points: tuple[float, ...], state: Array) -> Array:
    """Derivative (3 S, n_strains) of the positions at arclengths."""
    xi, u, balance = scene.static_balance
    slope = ca.jacobian(ca.vec(balance.motion.position_at(list(points))), xi)
    strains, *_, inputs = scene.layout.split(state)
    return np.asarray(ca.Function("slope", [xi, u], [slope])(strains, inputs), dtype=np.float64)
