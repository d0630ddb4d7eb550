"""An arm identified again from the log of its loop: what is told, what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import LoopLog
from pisplit.front import ArmIdentifier, Causes
from pisplit.models import rod
from pisplit.models.arm import RestShapes, TendonArm

DT, STEPS, S = 0.03, 48, 6


def changed(arm: TendonArm, *terms: Any) -> TendonArm:
    scene = arm.scene
    for term in terms:
        scene = scene + term
    return TendonArm(scene, arm.pretension, arm.amplitude)


def log_of(arm: TendonArm, u: np.ndarray | None = None) -> LoopLog:
    """A log as a loop on the ``arm`` leaves it: recorded motion, or under given inputs."""
    if u is None:
        made = arm.record(1, 0, STEPS, DT, S, workers=1, progress=False)
        x, u = made.xs[0], made.us[0]
    else:
        stepper = arm.scene.fast_stepper(dt=DT, stations=S)
        x = np.array([stepper.reset(u[0]), *(stepper.step(v).state for v in u)])
    N, fields = len(u), arm.scene.field_map(S)
    none = np.zeros(N)
    return LoopLog(
        dt=DT,
        t=DT * np.arange(N + 1),
        x=x,
        reference=np.full((N + 1, 3), np.nan),
        u=u,
        u0=arm.rest_inputs,
        tracked=tuple(fields.outputs["tip"]),
        state_names=tuple(fields.names),
        input_names=arm.scene.input_names,
        state_units=("",) * x.shape[1],
        input_units=("m",) * 3,
        statuses=("solved",) * N,
        actions=("",) * N,
        iterations=none,
        fallback=none.astype(bool),
        solve_time=none,
        cpu_time=none,
        plant_time=none,
        jitter=none,
        missing=none.astype(int),
        rejected=none.astype(int),
        stuck=none.astype(int),
        limit_violations=0,
    )


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(3)


@pytest.fixture(scope="module")
def loaded(arm: TendonArm) -> LoopLog:
    return log_of(changed(arm, rod.PointMass(s=arm.scene.rod.length, mass=0.02)))


def test_a_payload_is_weighed_and_told_from_other_causes(arm: TendonArm, loaded: LoopLog) -> None:
    def rebuild(found: TendonArm, dt: float, stations: int) -> Any:
        assert (dt, stations) == (DT, S) and found.scene.n_inputs == 3
        data = Episodes([loaded.x], [loaded.u], dt)
        theta = Dictionary(ob.Constant(), ob.Identity(), n_states=data.n_states, n_inputs=3)
        return LinearEDMDc(theta, 1e-6).fit(data)

    identify = ArmIdentifier(arm, free=("load",), windows=3, steps=3, rebuild=rebuild)
    new = identify(loaded)
    mass = next(e for e in new.found.estimates if e.name == "tip_mass")
    assert abs(mass.value - 0.02) < 2e-4 and mass.error < 2e-4 and mass.identified
    assert "tip_mass 0.0" in str(new) and "3 windows" in str(new) and new.episodes is not None
    assert identify.causes(loaded, ["payload", "stiffness"]).verdict == "payload"
    pushed = log_of(changed(arm, rod.TipWrench(force=(0.0, 0.05, 0.0))))
    with pytest.raises(ValueError, match="do not explain what was measured"):
        identify.calibrated(pushed)


@pytest.mark.parametrize(
    ("missed", "verdict"),
    [
        ((0.9, 40.0), "payload"),
        ((2.0, 2.4), "not told apart: payload, play"),
        ((0.01, 1.2), "not told apart: payload, play"),  # both below what the sensors see
        ((4.0, 3.5), "none of them"),
    ],
)
def test_causes_are_told_apart_by_what_they_leave(missed: tuple[float, float], verdict: str) -> None:
    found = Causes({"payload": (missed[0], ""), "play": (missed[1], "")})
    assert found.verdict.startswith(verdict) and str(found).startswith(verdict)
    assert [bar.get_width() for bar in found.plot().axes[0].patches] == list(missed)


def test_shapes_at_rest_weigh_it_too(arm: TendonArm, loaded: LoopLog) -> None:
    heavy = changed(arm, rod.PointMass(s=arm.scene.rod.length, mass=0.02))
    shapes: RestShapes = heavy.rest_shapes(6, seed=1, stations=S)
    (mass,) = ArmIdentifier(arm, free=("load",), shapes=shapes).calibrated(loaded).estimates
    assert abs(mass.value - 0.02) < 3.0 * mass.error and mass.error < 5e-3


def test_a_limit_cycle_tells_payload_and_stiffness_at_once(arm: TendonArm) -> None:
    """Inputs thrown from limit to limit, on an arm that is far from what was known of it."""
    body, turns = (
        arm.scene.rod,
        2e-3 * np.array([[1.0, -0.5, -0.5], [0.0, 1.0, -1.0], [-1.0, 0.5, 0.5], [0.0, -1.0, 1.0]]),
    )
    assert isinstance(body.material, rod.Elastic)
    soft = replace(body.material, young=0.85 * body.material.young, shear=0.85 * body.material.shear)
    scene = rod.Scene(replace(body, material=soft), *arm.scene.terms, nodes=arm.scene.nodes)
    heavy = changed(replace(arm, scene=scene), rod.PointMass(s=body.length, mass=0.03))
    u = arm.rest_inputs + np.cumsum(np.repeat(turns, 3, axis=0)[np.arange(36) % 12], axis=0)
    found = ArmIdentifier(arm, windows=12, steps=4).calibrated(log_of(heavy, u))
    known = {e.name: e.value for e in found.estimates}
    assert abs(known["tip_mass"] - 0.03) < 1e-4 and abs(known["bending"] - 0.85) < 2e-3


def test_what_the_log_does_not_say_is_refused(arm: TendonArm, loaded: LoopLog) -> None:
    with pytest.raises(ValueError, match="identify no tip_mass: move the arm more"):
        ArmIdentifier(arm, ("load",), None, 1.0, 1.0, 10.0, windows=2, steps=3).calibrated(loaded)
    gaps = replace(loaded, x=np.where(np.arange(len(loaded.x))[:, None] % 3 == 0, np.nan, loaded.x))
    with pytest.raises(ValueError, match="no 7 samples in a row are measured"):
        ArmIdentifier(arm)(gaps)
    with pytest.raises(ValueError, match="not the fields of the arm"):
        ArmIdentifier(arm)(replace(loaded, state_names=tuple(reversed(loaded.state_names))))
