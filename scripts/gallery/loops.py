"""Pictures of closed loops: circles and set-points, noise, delays, references, weights."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pisplit as ps
from gallery.models import DT, _duffing, _fitted
from pisplit.controllers import MPC, ClosedLoop, KalmanFilter, LoopLog, PlantStep, plants
from pisplit.models import systems
from pisplit.pictures.figures import below, new_figure, tidy

Array = NDArray[np.float64]


class _Spring:
    """The Duffing oscillator as a plant."""

    dt, n_inputs, n_states = DT, 1, 2

    def __init__(self) -> None:
        self.system, self.x = systems.duffing(stiffness=1.0), np.zeros(2)

    def reset(self, u0: Any = None) -> Array:
        self.x = np.zeros(2)
        return self.x

    def step(self, u: Any) -> PlantStep:
        self.x = self.system.simulate(self.x, np.atleast_2d(u), DT)[-1]
        return PlantStep(self.x)


JUMPS = ps.references.setpoint([[0.5], [-0.4], [0.2]], [0.5, 4.0, 8.0], track="")


def _loop(plant: Any, steps: int = 220, **settings: Any) -> LoopLog:
    mpc = MPC(_fitted().lifted, 20, -1.0, 1.0, 0.5, track=["x"], **settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ClosedLoop(plant, mpc).run(JUMPS, steps, progress=False)


def set_points() -> Any:
    """MPC on the cubic model of the Duffing oscillator: jumps between set-points under limits of the input and of
    its rate. The preview of the reference moves ahead of the jump (`log.plot()`).
    """
    return _loop(_Spring()).plot()


def _beside(logs: dict[str, Array], title: str) -> Any:
    figure = new_figure(8.0, 4.6)
    axis: Any = figure.subplots()
    t = DT * np.arange(len(next(iter(logs.values()))))
    axis.plot(t, JUMPS.starting_at([0.0])(t)[:, 0], "k--", lw=1.0, label="reference")
    for name, x in logs.items():
        axis.plot(t, x, lw=1.4, label=name)
    axis.set(xlabel="time (s)", ylabel="x", title=title, ylim=(-0.9, 0.9))
    below(axis)
    tidy(axis)
    return figure


def delay() -> Any:
    """Commands that act four steps late: a controller that is not told swings, one that is told
    (`command_delay=4`) predicts the delay away.
    """
    runs: dict[str, dict[str, Any]] = {"not told": {}, "told": {"command_delay": 4.0}}
    logs = {name: _loop(plants.DelayedCommands(_Spring(), 4.0), **more) for name, more in runs.items()}
    return _beside({name: log.x[:, 0] for name, log in logs.items()}, "commands four steps late")


def noise() -> Any:
    """Noise of 0.05 on position and speed: the true position of the plant without and with a Kalman filter in the
    lifted state (`KalmanFilter.from_data`).
    """
    found: dict[str, Array] = {}
    for name in ("without a filter", "with a filter"):
        seen = plants.NoisyMeasurements(_Spring(), 0.05, seed=3)
        more: dict[str, Any] = {}
        if name == "with a filter":
            more = {"observer": KalmanFilter.from_data(_linear(), _duffing()[:6], std=0.05, measured=["x", "v"])}
        mpc = MPC(_linear().lifted, 20, -1.0, 1.0, 0.5, track=["x"], estimator_gain=0.1, **more)
        ClosedLoop(seen, mpc).run(JUMPS, 220, progress=False)
        found[name] = seen.true_states[:, 0]
    return _beside(found, "noise of 0.05")


@cache
def _linear() -> ps.LinearEDMDc:
    theta = ps.Dictionary(ps.observables.Constant(), ps.observables.Identity(), n_states=2, n_inputs=1)
    return ps.LinearEDMDc(theta, alpha=1e-6).fit(_duffing()[:6])


def weights() -> Any:
    """How the weight of the input rate is chosen: loops on the two best models, each as the plant of the
    controller; ringed: the choice (`model.mpc(...).plot()`).
    """
    model = ps.identify(_duffing(), candidates=["L-EDMDc", "L-EDMDc, cubic"], progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return model.mpc(u_max=1.0, du_max=0.5).plot()


def way_points() -> Any:
    """Rest-to-rest moves of minimum jerk through way-points (`references.waypoints(...).plot()`)."""
    points = [[0.1, 0.0, 0.6], [0.1, 0.1, 0.55], [-0.05, 0.1, 0.6]]
    return ps.references.waypoints(points, [2.0, 5.0, 8.0]).plot()


@cache
def _circle() -> tuple[LoopLog, ps.TendonArm]:
    arm = ps.TendonArm.paper(4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        d1 = arm.record(6, steps=80, workers=1, progress=False)
        model = ps.identify(d1, arm=arm, candidates=["L-EDMDc"], progress=False)
        mpc = model.mpc(u_max=0.016, du_max=0.002, rate_weight=0.1)
        return mpc.run(arm, ps.references.circle(radius=0.1, period=4.0), 280, progress=False), arm


def circle() -> Any:
    """The tip of the paper's arm on a circle of 0.1 m in 4 s: L-EDMDc on six recordings of 2.4 s (`log.plot()`)."""
    return _circle()[0].plot()


def arm_on_the_circle() -> Any:
    """The same in space: shapes of the arm on the way, tendons of the last one coloured by tension."""
    from pisplit.models.rod.output.pictures import plot_arm
    from pisplit.models.rod.output.results import hung

    log, arm = _circle()
    rods = arm.scene.coordinates(6).function.map(len(log.x))
    states = np.hstack([np.asarray(rods(log.x.T)).T, np.vstack([log.u0, log.u])])
    return hung(plot_arm(arm.scene, states[::6], "on the circle"), arm.scene)


def ghost() -> Any:
    """Distance between the tip and where the model predicted it 0.6 s before, along the circle
    (`log.beside(model)`; the page `run.html` draws both).
    """
    log, _ = _circle()
    assert log.ghost is not None
    tip = list(log.tracked)
    away = 1e3 * np.linalg.norm((log.ghost - log.x)[:, tip], axis=1)
    figure = new_figure(7.0, 4.2)
    axis: Any = figure.subplots()
    axis.plot(log.t, away, lw=1.4)
    axis.set(xlabel="time (s)", ylabel="error of the prediction (mm)", title="what the model missed 20 steps ahead")
    tidy(axis)
    return figure
