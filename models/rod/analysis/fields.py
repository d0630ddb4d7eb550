"""The 24 fields of the paper at stations along the rod."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, real_array
from pisplit.models.rod.answers import finite_answer
from pisplit.models.rod.sharing import Rebuilt, in_turn

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Fields of a station in their order: quantity and number of components (R row by row).
LAYOUT = (("p", 3), ("R", 9), ("v", 3), ("w", 3), ("q", 3), ("omega", 3))
N_FIELDS = sum(size for _, size in LAYOUT)
UNITS = {"p": "m", "R": "1", "v": "1", "w": "1/m", "q": "m/s", "omega": "rad/s"}
BLOCK = 512


def station_points(stations: int | ArrayLike, length: float) -> tuple[float, ...]:
    """Arclengths of the stations: a number S stands for L/S, 2L/S, ..., L (the clamp is left out), with
    L = ``length`` in m.

    Raises ValueError for arclengths that do not increase or lie off the rod.
    """
    if isinstance(stations, int | np.integer):
        n = count(stations, "stations")
        return tuple((length * np.arange(1, n + 1) / n).tolist())
    points = finite_array(stations, "stations", (None,))
    if points.size == 0 or points.min() < 0.0 or points.max() > length * (1 + 1e-12) or np.any(np.diff(points) <= 0.0):
        raise ValueError(f"stations = {points.tolist()}; expected increasing arclengths between 0 and L = {length:g} m")
    return tuple(points.tolist())


class Fields(Rebuilt):
    """Map from states [xi, xi_t, u] to p, R, v, w (body), q, omega (body velocities) at stations.

    The fields of eq. cosserat_rod_eq; velocities obey its kinematic rows, p_t = R q and R_t = R omega^.

    Where shear and stretch are not free strains, v is recovered from the internal force, v = v* + K_se^-1 n; the force
    needs the accelerations, which the balance gives exactly.

    Args:
        scene: the rod and what acts on it.
        points: arclengths of the stations in m.
    """

    def __init__(self, scene: Scene, points: tuple[float, ...]) -> None:
        self.scene = scene
        self.points = points

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries station by station: ``p_x[1]`` is the x position of the first station."""
        axes = {3: "xyz", 9: ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")}
        station = [f"{name}_{axis}" for name, size in LAYOUT for axis in axes[size]]
        return tuple(f"{entry}[{k + 1}]" for k in range(len(self.points)) for entry in station)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Physical quantity of every entry."""
        return tuple(name for _ in self.points for name, size in LAYOUT for _ in range(size))

    @property
    def outputs(self) -> dict[str, tuple[int, ...]]:
        """Entries that are often wanted: ``tip`` and ``tip_velocity`` of the last station, ``shape`` of all."""
        last = N_FIELDS * (len(self.points) - 1)
        return {
            "tip": tuple(range(last, last + 3)),
            "tip_velocity": tuple(range(last + 18, last + 21)),
            "shape": tuple(N_FIELDS * k + axis for k in range(len(self.points)) for axis in range(3)),
        }

    @property
    def expression(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """The symbols xi, xi_t, xi_tt, u, and the fields (24 S,) of them."""
        xi, xi_t, xi_tt, u, balance = self.scene.dynamic_balance
        motion, rule = balance.motion, self.scene.rule
        points = list(self.points)
        at = rule.interpolate(points)
        w, v = motion.integral(motion.w, at), motion.integral(balance.strain_v, at)
        p, spin, velocity = motion.position_at(points), motion.spin_at(points), motion.velocity_at(points)
        columns = []
        for k, frame in enumerate(motion.frames_at(points)):
            rotation = ca.vec(frame.T)
            body = (v[:, k], w[:, k], frame.T @ velocity[:, k], frame.T @ spin[:, k])
            columns.append(ca.vertcat(p[:, k], rotation, *body))
        return [xi, xi_t, xi_tt, u], [ca.vertcat(*columns)]

    @cached_property
    def symbolic(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> fields`` (24 S,) in SX."""
        return ca.Function("fields", *self.expression)

    @cached_property
    def function(self) -> ca.Function:
        """``x -> fields`` (24 S,) of a state [xi, xi_t, u]."""
        x = ca.MX.sym("x", self.scene.n_states)
        xi, xi_t, u = self.scene.layout.arguments(x)
        y = self.symbolic(xi, xi_t, self.scene.acceleration(xi, xi_t, u), u)
        return ca.Function("fields", [x], [y], ["x"], ["y"])

    @in_turn()
    def evaluate(self, x: ArrayLike) -> Array:
        """Fields (..., S, 24) of states ``x`` (..., n_states).

        Raises ValueError for states of another scene, or so large that the fields overflow.
        """
        states = real_array(x, "states")
        if states.ndim == 0 or states.shape[-1] != self.scene.n_states:
            raise ValueError(f"states have shape {states.shape}; expected (..., {self.scene.n_states}) for this scene")
        flat = finite_array(states.reshape(-1, states.shape[-1]), "states", (None, self.scene.n_states))
        values = np.empty((len(flat), N_FIELDS * len(self.points)))
        native = self.scene.native(self.function)
        for start in range(0, len(flat), BLOCK):
            block = flat[start : start + BLOCK]
            values[start : start + len(block)] = np.asarray(native.map(len(block))(block.T)).T
        return finite_answer(values, "fields").reshape(*states.shape[:-1], len(self.points), N_FIELDS)
