"""All fields of an arm from recordings of a few markers: its own equations carry what these do not show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit import Episodes
from pisplit.checks import Array
from pisplit.models.arm.energy_prior import energy_root, moving_energy
from pisplit.models.arm.marker_sight import MarkerSight, read_markers
from pisplit.models.arm.motion_capture import MotionCapture
from pisplit.models.arm.recording import labels

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Variances of what a step may miss, in those of the arm in motion: the likeliest by the innovations is taken.
UNKNOWN = (1e-7, 1e-5, 1e-3, 1e-1)
#: Steps of the first recording that it is judged on.
JUDGED = 60
#: Corrections by one row of markers, about the last state each: bends are seen nonlinearly.
CORRECTIONS = 3
#: Root mean square of the misses, in standard deviations, beyond which markers are those of another arm.
MISSED = 3.0


def fields_from_markers(arm: Arm, episodes: Episodes, capture: MotionCapture, stations: int = 6) -> Episodes:
    """Recordings of all 24 fields, from those of markers: what the physics of an arm is identified on.

    An extended Kalman filter over the arm's own equations and a smoother backwards, in coordinates of its energy. It
    starts at rest under ``arm.rest_inputs``, within what motion allows; what a step may miss is chosen by the
    likelihood of the innovations of the first recording. What the result is worth is what the arm is worth: calibrate
    it first (:func:`pisplit.models.calibration.calibrate_from_markers`).

    Args:
        arm: drawn or calibrated, moved by displacements; its Maxwell branches are not seen by markers.
        episodes: recordings with the columns of the markers, NaN-free; inputs in m.
        capture: which they are and where they sit; its pose is given (``Calibration.capture``).
        stations: points along the arm whose fields are returned.

    Returns recordings of 24 ``stations`` states, as ``arm.record`` gives them, with [xi, xi_t] as ``extra["strains"]``
    and the residual under ``provenance["markers"]``. Raises ValueError for columns that do not fit, an unknown pose, an
    arm with branches, and markers that are missed by more than three times their noise; RuntimeError where the arm
    cannot be moved as recorded.

    Source: Rauch, Tung, Striebel, AIAA Journal 3, 1965; Jazwinski, Stochastic Processes and Filtering Theory, 1970,
    ch. 8.
    """
    if capture.pose != "given":
        raise ValueError("the pose of the base is unknown; take the capture of a calibration, which has found it")
    if arm.scene.branches:
        raise ValueError("the arm has Maxwell branches, whose stress no marker tells; leave them out (rod.Maxwell)")
    columns, data = read_markers(episodes, arm, capture)
    smoother = _Smoother.of(arm, capture, data.dt)
    first = columns[0][: JUDGED + 1], data.us[0][:JUDGED]
    likely = [smoother.filtered(*first, q).log_likelihood for q in UNKNOWN]
    unknown = UNKNOWN[int(np.argmax(likely))]
    states, misses = [], []
    for y, u in zip(columns, data.us, strict=True):
        found = smoother.smoothed(smoother.filtered(y, u, unknown))
        seen = np.stack([smoother.sight.look(x)[0] for x in found])
        misses.append(((seen - y) / smoother.sight.sizes).ravel())
        states.append(found)
    residual = float(np.sqrt(np.mean(np.concatenate(misses) ** 2)))
    if residual > MISSED:
        raise ValueError(
            f"the arm misses the markers by {residual:.2g} times their noise; calibrate it (calibrate_from_markers), "
            "or tell the noise that they have"
        )
    moved = [np.vstack([arm.rest_inputs, u]) for u in data.us]
    whole = [np.hstack([x, u]) for x, u in zip(states, moved, strict=True)]
    xs = [np.asarray(arm.scene.fields(rows, stations)).reshape(len(rows), -1) for rows in whole]
    told = {"markers": {"residual": residual, "unknown": unknown, "columns": list(capture.names)}}
    return Episodes(
        xs,
        data.us,
        data.dt,
        extra={"strains": states},
        provenance={**(episodes.provenance or {}), **told},
        **labels(arm, arm.scene.field_map(stations)),
    )


@dataclass(frozen=True)
class _Filtered:
    """States (T+1, d) and covariances before and after each row of markers, slopes (T, d, d) of the steps between."""

    before: Array
    before_cov: Array
    after: Array
    after_cov: Array
    slopes: Array
    log_likelihood: float


@dataclass(frozen=True)
class _Smoother:
    """Filter and smoother over x = state - rest in units of its energy: z = root x."""

    arm: Any
    sight: MarkerSight
    stepper: Any
    rest: Array
    root: Array
    back: Array

    @classmethod
    def of(cls, arm: Arm, capture: MotionCapture, dt: float) -> _Smoother:
        scene = arm.scene
        found = scene.statics().solve(arm.rest_inputs)
        if not found.success:
            raise RuntimeError("the arm does not rest under its rest inputs: no start is known")
        n = scene.n_strains
        rest = np.concatenate([found.state[:n], np.zeros(n)])
        root = energy_root(scene, rest[:n], arm.rest_inputs, moving_energy(arm), dt)
        return cls(
            arm, MarkerSight(scene, capture), scene.fast_stepper(dt), rest, root, np.asarray(np.linalg.inv(root))
        )

    def filtered(self, y: Array, u: Array, unknown: float) -> _Filtered:
        """Forwards over markers ``y`` (T+1, K) and commands ``u`` (T, m); NaN: lost."""
        d = len(self.rest)
        moves = np.vstack([self.arm.rest_inputs, u])
        z, cov, likely = np.zeros(d), np.eye(d), 0.0
        before, before_cov, after, after_cov, slopes = [], [], [], [], []
        for k, row in enumerate(y):
            if k:
                state = np.concatenate([self.rest + self.back @ z, moves[k - 1]])
                step = self._step(state, moves[k], k)
                slope = self.root @ step.d_state[:d, :d] @ self.back
                z, cov = self.root @ (step.x[:d] - self.rest), slope @ cov @ slope.T + unknown * np.eye(d)
                slopes.append(slope)
            before.append(z)
            before_cov.append(cov)
            z, cov, gained = self._corrected(z, cov, row)
            likely += gained
            after.append(z)
            after_cov.append(cov)
        return _Filtered(
            np.array(before), np.array(before_cov), np.array(after), np.array(after_cov), np.array(slopes), likely
        )

    def _step(self, state: Array, command: Array, k: int) -> Any:
        try:
            return self.stepper.sensitivity(state, command)
        except RuntimeError as error:
            raise RuntimeError(
                f"the arm cannot be moved along the markers at step {k}: are they its own, and the commands in m? "
                f"({error})"
            ) from None

    def _corrected(self, z: Array, cov: Array, row: Array) -> tuple[Array, Array, float]:
        """State and covariance after one ``row`` (K,), by an iterated update, and its log likelihood."""
        seen = np.isfinite(row)
        if not seen.any():
            return z, cov, 0.0
        at, likely = z, 0.0
        for number in range(CORRECTIONS):
            look, of_state, _ = self.sight.look(self.rest + self.back @ at)
            h = (of_state @ self.back)[seen] / self.sight.sizes[seen, None]
            miss = (row[seen] - look[seen]) / self.sight.sizes[seen] - h @ (z - at)
            size = h @ cov @ h.T + np.eye(len(h))
            gain = np.linalg.solve(size, h @ cov).T
            if number == 0:
                likely = -0.5 * float(miss @ np.linalg.solve(size, miss) + np.linalg.slogdet(size)[1])
            at = z + gain @ miss
        return at, cov - gain @ size @ gain.T, likely

    def smoothed(self, f: _Filtered) -> Array:
        """States [xi, xi_t] (T+1, d) given all markers, backwards."""
        z = f.after[-1]
        found = [z]
        for k in range(len(f.slopes) - 1, -1, -1):
            gain = np.linalg.solve(f.before_cov[k + 1], f.slopes[k] @ f.after_cov[k]).T
            z = f.after[k] + gain @ (z - f.before[k + 1])
            found.append(z)
        return np.asarray(self.rest + np.array(found[::-1]) @ self.back.T)
