"""What an identification may know: recordings, the arm as drawn, its shapes at rest; what follows from them, once."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array
from pisplit.data.suspicions import noise_level
from pisplit.models import rod
from pisplit.models.arm import Arm, ArmPhysics, TendonArm, equilibrium_table, make_phase_samples
from pisplit.models.arm.predictor import ArmPredictor
from pisplit.models.arm.recording import make_episodes, random_displacements
from pisplit.models.arm.resting import RestShapes
from pisplit.models.calibration import (
    Calibration,
    CalibrationChoice,
    calibrate_from_recordings,
    calibrate_from_shapes,
    choose_calibration,
)
from pisplit.models.rod.analysis.fields import N_FIELDS

#: Half width of the table of equilibria in usual displacements, phase samples, recordings of the twin.
TABLE_WIDTH, PHASE_SAMPLES, TWIN_EPISODES = 2.2, 1000, 16
#: Seeds of what is simulated, apart from those of a user's recordings.
SEED = 7919
#: Windows of the recordings from which damping is identified, and their steps.
WINDOWS, WINDOW_STEPS = 12, 6
#: Roll-outs under recorded inputs that a model has to survive.
EXCITATIONS = 8
#: Ways to calibrate an arm by its shapes, the usual one first.
CALIBRATE: tuple[str, ...] = ("auto", "choose", "shapes")
#: Root mean square of misses, in standard deviations, beyond which shapes at rest or recordings say that it is not the
#: arm that was drawn; and disks of an arm on which nobody has counted them.
UNLIKE, DISKS = 3.0, 8
#: Recordings of a twin whose tendons rub over disks: each costs ten times as much.
DEAR_EPISODES = 6
#: Groups of outputs by which models are compared, the first that the data have.
GROUPS = ("shape", "tip")


@dataclass(frozen=True)
class Case:
    """Recordings and what is known beside them.

    Attributes:
        d1: recordings to learn from.
        arm: the arm as drawn, if there is one.
        shapes: its shapes at rest, if there are any.
        states: outputs by which models are compared: a group, names or positions of states, None for all.
        progress: whether to show bars of long simulations.
        calibrate: how the arm is calibrated by its shapes: see :func:`pisplit.identify`.
        disks: forms of the tendons to choose from.
        made: what was simulated already, by name; shared between cases of one identification.
    """

    d1: Episodes
    arm: Arm | None
    shapes: RestShapes | None
    states: Any
    progress: bool = True
    calibrate: str = CALIBRATE[0]
    disks: tuple[Any, ...] | None = None
    made: dict[str, Any] = field(default_factory=dict)

    def on(self, d1: Episodes) -> Case:
        """The same with other recordings ``d1`` of the same system."""
        return replace(self, d1=d1)

    @property
    def excitation(self) -> Array:
        """Inputs (E, T, m) of the recorded kind: those of recordings, cut to one length."""
        steps = min(len(u) for u in self.d1.us)
        return np.stack([u[:steps] for u in self.d1.us[:EXCITATIONS]])

    @property
    def is_rod(self) -> bool:
        """Whether the states are the 24 fields of a rod at stations, in their order."""
        if self.arm is None:
            return False
        stations = self.d1.n_states // N_FIELDS
        return bool(
            stations
            and self.d1.n_states % N_FIELDS == 0
            and tuple(self.d1.state_names or ()) == tuple(self.arm.scene.field_map(stations).names)
        )

    @property
    def is_simulated(self) -> bool:
        """Whether this very arm made the recordings, by the fingerprint of its scene."""
        told = (self.d1.provenance or {}).get("scene")
        return self.arm is not None and told == self.arm.scene.fingerprint(self.stations)

    @property
    def stations(self) -> int:
        """Number of points whose fields are recorded."""
        return max(1, self.d1.n_states // N_FIELDS)

    @cached_property
    def noise(self) -> Array:
        """Noise (n,) of the states, a standard deviation; where motion hides it that of others of their unit, or 0."""
        states, units = self.d1.stacked_states(), self.d1.units or ()
        runs = np.split(np.arange(len(states)), np.cumsum([len(x) for x in self.d1.xs])[:-1])
        seen = [noise_level(column, runs) for column in states.T]
        alike = {
            u: [n for n, unit in zip(seen, units, strict=True) if u and unit == u and n is not None] for u in units
        }
        usual = {u: float(np.median(n)) if n else 0.0 for u, n in alike.items()}
        return np.array([usual[u] if n is None else n for n, u in zip(seen, units, strict=True)])

    def no_rod(self) -> str:
        """Why the physics of a rod cannot be used, empty if it can."""
        if self.arm is None:
            return "no arm given: identify(d1, arm=...) with a drawing of it"
        if not isinstance(self.arm, TendonArm):
            return f"{type(self.arm).__name__} has no table of equilibria yet"
        if self.d1.n_inputs != self.arm.scene.n_inputs:
            return f"the arm has {self.arm.scene.n_inputs} tendons, the recordings {self.d1.n_inputs} inputs"
        if not self.is_rod:
            return "the states are not the 24 fields of a rod at every station"
        return ""

    def physics(self) -> ArmPhysics:
        """Statics and linear dynamics of the arm as drawn or calibrated."""
        return self._once("physics", lambda: ArmPhysics(self._table(), self.stations))

    def _table(self) -> Any:
        arm = self.known_arm()
        used = np.abs((self.d1.stacked_inputs() - arm.rest_inputs) @ arm.differential_basis).max()
        return equilibrium_table(arm, max(TABLE_WIDTH * arm.amplitude, 1.05 * float(used)), self.stations)

    def phase_samples(self) -> PhaseSamples:
        """Phase-space samples of the backbone about the recorded shapes and rates."""
        return self._once(f"phase samples about {len(self.d1)} recordings", self._phase_samples)

    def _phase_samples(self) -> PhaseSamples:
        physics = self.physics()
        scene, n = physics.arm.scene, physics.arm.scene.n_strains
        x = np.concatenate([x[1:] for x in self.d1.xs])
        coordinates = np.asarray(scene.coordinates(self.stations).function.map(len(x))(x.T)).T
        inside = physics.table.outside(self.d1.stacked_inputs()) <= 0.0
        rest = physics.table.values(self.d1.stacked_inputs()[inside])[:, :n]
        with tempfile.TemporaryDirectory() as folder:
            return make_phase_samples(
                physics.arm,
                Path(folder) / "d2.h5",
                PHASE_SAMPLES,
                coordinates[:, n:],
                stations=self.stations,
                seed=SEED,
                workers=1,
                progress=False,
                deviations=coordinates[inside, :n] - rest,
            )

    def known_arm(self) -> TendonArm:
        """The arm calibrated by its shapes at rest where there are some, as drawn otherwise."""
        assert isinstance(self.arm, TendonArm)
        return self.arm if self.shapes is None else self.calibration().arm

    def calibration(self) -> Calibration:
        """Tendons and stiffness from shapes at rest, damping from windows of the recordings.

        Where these say that it is not the arm that was drawn, form and numbers from all of them (``choice``). Raises
        RuntimeError where nothing explains them.
        """
        return self._once("calibration", self._calibration)

    def _calibration(self) -> Calibration:
        if self.calibrate == "choose":
            return self.choice().calibration
        try:
            return self._usual()
        except RuntimeError:
            if self.calibrate == "shapes":
                raise
            return self.choice().calibration

    def choice(self) -> CalibrationChoice:
        """Form of the tendons, servos, friction and loads by held-out roll-outs (``choose_calibration``).

        Raises RuntimeError where there are fewer than two recordings, or no calibration predicts those held out.
        """
        return self._once("choice", self._choice)

    @property
    def forms(self) -> tuple[Any, ...] | None:
        """Forms of the tendons to choose from; None for that of the drawing alone."""
        drawn = self.arm.tendons if isinstance(self.arm, TendonArm) else None
        if self.disks is not None or not isinstance(drawn, rod.Tendons) or drawn.disks is not None:
            return self.disks
        return None, DISKS

    @property
    def chosen(self) -> CalibrationChoice | None:
        """The choice of form and groups, where there was one."""
        return self.made.get("choice")

    def _choice(self) -> CalibrationChoice:
        arm = self.arm
        assert isinstance(arm, TendonArm)
        if len(self.d1) < 2:
            raise RuntimeError("one recording cannot choose the form of an arm: two or more are needed")
        return choose_calibration(arm, self.d1, self.shapes, disks=self.forms, progress=self.progress)

    def _usual(self) -> Calibration:
        arm, shapes = self.arm, self.shapes
        assert isinstance(arm, TendonArm) and shapes is not None
        resting = calibrate_from_shapes(
            arm, shapes.inputs, shapes.fields, shapes.position_error, shapes.rotation_error, shapes.stations
        )
        if resting.residual > UNLIKE:
            raise RuntimeError(
                f"the drawing does not explain the shapes at rest: they are missed by {resting.residual:.2g} standard "
                "deviations; check its numbers, or the errors of the shapes"
            )
        fields, moves = self._windows()
        found = calibrate_from_recordings(
            resting.arm,
            fields,
            moves,
            self.d1.dt,
            shapes.position_error,
            shapes.rotation_error,
            stations=self.stations,
            free=("damping",),
            start=resting.parameters,
        )
        if found.residual > UNLIKE and self.calibrate != "shapes":
            raise RuntimeError(f"the recordings are missed by {found.residual:.2g} standard deviations")
        return found

    def _windows(self) -> tuple[Array, Array]:
        """Fields (N, T+1, n) and displacements (N, T+1, m) of short windows, spread over the recordings."""
        fields: list[Array] = []
        moves: list[Array] = []
        for x, u in zip(self.d1.xs, self.d1.us, strict=True):
            room = len(u) - WINDOW_STEPS
            each = max(1, WINDOWS // len(self.d1))
            if room < 1 or len(fields) >= WINDOWS:
                continue
            for k in np.unique(np.linspace(1, room, each + 1).astype(int))[-each:]:
                fields.append(x[k : k + WINDOW_STEPS + 1])
                moves.append(u[k - 1 : k + WINDOW_STEPS])
        if not fields:
            raise RuntimeError(f"no recording has {WINDOW_STEPS + 2} steps, which the damping is identified from")
        return np.stack(fields), np.stack(moves)

    def twin(self) -> Episodes:
        """Recordings of the simulated twin: the calibrated arm, or the arm itself where it made the recordings."""
        return self._once("twin", self._twin)

    def _twin(self) -> Episodes:
        steps, arm = max(60, min(200, max(len(u) for u in self.d1.us))), self.known_arm()
        if self.chosen is None:
            return arm.record(TWIN_EPISODES, SEED, steps, self.d1.dt, self.stations, progress=self.progress)
        rubs = arm.tendons.disks is not None and self.chosen.calibration.parameters.friction > 0.0
        number = min(TWIN_EPISODES, DEAR_EPISODES) if rubs else TWIN_EPISODES
        with tempfile.TemporaryDirectory() as folder:
            return make_episodes(
                arm,
                Path(folder) / "twin.h5",
                number,
                steps,
                self.d1.dt,
                stations=self.stations,
                seed=SEED,
                progress=self.progress,
                actuator=self.chosen.actuator,
            )

    def predictor(self) -> ArmPredictor | None:
        """Roll-outs of the calibrated arm behind its servos; None without shapes that calibrate it.

        Raises RuntimeError where nothing explains the shapes.
        """
        if self.shapes is None or self.no_rod():
            return None
        found = self.calibration()
        return self._once("predictor", lambda: ArmPredictor(found.arm, self.d1.dt, self.stations, found.actuator))

    def twin_excitation(self) -> Array:
        """Displacements (E, T, m) in m of the kind that the twin was moved by."""
        arm = self.known_arm()
        return np.stack([random_displacements(arm, 120, np.random.default_rng(SEED + k)) for k in range(4)])

    def _once(self, name: str, make: Callable[[], Any]) -> Any:
        if name not in self.made:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what is told of it is told in the report
                self.made[name] = make()
        return self.made[name]

    @cached_property
    def rest(self) -> Array:
        """Inputs (m,) about which the system rests: the arm's, or the mean of the first recorded inputs."""
        if self.arm is not None and self.arm.scene.n_inputs == self.d1.n_inputs:
            return self.arm.rest_inputs
        return np.mean([u[0] for u in self.d1.us], axis=0)
