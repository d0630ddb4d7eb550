"""The front door: the five lines of the design document, other arms, other systems, and what fails in one line."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pisplit as ps
from pisplit.front import case as case_module
from pisplit.models import systems

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def arm() -> ps.TendonArm:
    """Not the paper's: shorter, four tendons, hanging, with a load."""
    return ps.TendonArm(
        length=0.45,
        radius=0.7e-3,
        material="steel",
        offset=0.01,
        angles_deg=(20, 110, 200, 290),
        tip_mass=0.01,
        nodes=3,
    )


@pytest.fixture(scope="module")
def d1(arm: ps.TendonArm) -> ps.Episodes:
    return arm.record(4, steps=60, progress=False)


@pytest.fixture(scope="module")
def duffing() -> ps.Episodes:
    spring = systems.duffing(stiffness=1.0)
    draws = [np.random.default_rng(k) for k in range(6)]
    runs = [np.repeat(g.uniform(-1, 1, (20, 1)), 6, axis=0) for g in draws]
    return ps.Episodes.from_system(spring, np.array([g.uniform(-1, 1, 2) for g in draws]), runs, 0.05)


def test_the_five_lines_on_an_arm_of_ones_own(
    arm: ps.TendonArm, d1: ps.Episodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(case_module, "TWIN_EPISODES", 5)
    model = ps.identify(d1, arm=arm, progress=False)
    report = model.report()
    errors = {t.name: t.error for t in report.tried}
    assert np.isfinite([errors["B-EDMDc"], errors["PI-EDMDc, hold"], errors["PI-EDMDc, twin"]]).all()
    assert errors[report.chosen] <= 1.05 * min(errors.values())
    assert "not tried: 144 states" in str(report) and report.helps and report.unfit
    mpc = model.mpc(u_max=0.008, du_max=0.002, rate_weight=0.1)  # its choice is tested below
    log = mpc.run(arm, ps.references.circle(radius=0.03, period=1.5), steps=110, progress=False)
    assert not log.stopped and log.limit_violations == 0
    assert log.rms_error(after=0.75) < 0.1 * 0.03  # follows to a tenth of the radius
    log.plot(tmp_path / "run.png")
    log.save(tmp_path / "run.h5")
    model.plot(tmp_path / "model.png")
    model.save(tmp_path / "model.h5")
    assert (tmp_path / "run.png").stat().st_size > 10_000 and (tmp_path / "model.png").stat().st_size > 10_000
    told = ps.LiftedModel.load(tmp_path / "model.h5").provenance["report"]
    assert str(type(report).of_dict(told)) == str(report)


def test_shapes_at_rest_calibrate_a_wrong_drawing(
    arm: ps.TendonArm, d1: ps.Episodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(case_module, "TWIN_EPISODES", 4)
    monkeypatch.setattr(case_module, "WINDOWS", 3)
    wrong = ps.TendonArm(
        length=0.45,
        radius=0.72e-3,
        material="steel",
        offset=0.0106,
        angles_deg=(20, 110, 200, 290),
        tip_mass=0.01,
        damping_ratio=0.08,
        nodes=3,
    )
    blind = ps.identify(d1, arm=wrong, candidates=["L-EDMDc", "PI-EDMDc, twin"], progress=False)
    (twin,) = [t for t in blind.report().tried if t.name == "PI-EDMDc, twin"]
    assert "no shapes at rest" in twin.note and any("shapes at rest" in h for h in blind.report().helps)
    seen = ps.identify(d1, wrong, arm.rest_shapes(6), candidates=["L-EDMDc", "PI-EDMDc, twin"], progress=False)
    errors = {t.name: t.error for t in seen.report().tried}
    assert errors["PI-EDMDc, twin"] < errors["L-EDMDc"] and seen.report().chosen == "PI-EDMDc, twin"
    found = seen.case.calibration()
    assert np.hypot(*found.parameters.offset.T).mean() == pytest.approx(0.01, rel=0.02)


def test_recordings_of_any_system_without_an_arm(duffing: ps.Episodes) -> None:
    names = ["L-EDMDc", "L-EDMDc, cubic", "B-EDMDc, cubic", "PI-EDMDc, hold"]
    model = ps.identify(duffing, candidates=names, progress=False)
    report = model.report()
    assert "cubic" in report.chosen  # the spring is
    notes = {t.name: t.note for t in report.tried}
    assert notes["PI-EDMDc, hold"].startswith("not tried: no arm given")
    assert report.horizons[0][0] == pytest.approx(0.05) and report.horizons[-1][1] < 0.1
    assert report.predicted in " ".join(str(report).split()) and "lost" not in report.predicted
    assert report.predicted.count(" after ") == len(report.horizons)
    assert type(report).of_dict(report.as_dict()).predicted == report.predicted
    mpc = model.mpc(u_max=1.0, du_max=2.0)

    class Spring:
        """The oscillator as a plant."""

        dt, n_inputs, n_states = 0.05, 1, 2

        def reset(self, u0: Any = None) -> np.ndarray:
            self.x = np.array([0.0, 0.0])
            return self.x

        def step(self, u: np.ndarray) -> Any:
            from pisplit.controllers import PlantStep

            self.x = systems.duffing(stiffness=1.0).simulate(self.x, np.atleast_2d(u), 0.05)[-1]
            return PlantStep(self.x)

    log = mpc.run(Spring(), ps.references.setpoint([[0.5]], [0.0], track=""), steps=120, progress=False)
    assert not log.stopped and np.abs(log.y[-5:] - 0.5).max() < 0.01


def test_noisy_recordings_are_filtered_and_clean_ones_are_not(duffing: ps.Episodes) -> None:
    noise = np.random.default_rng(0)
    seen = replace(duffing, xs=[x + 0.02 * noise.standard_normal(x.shape) for x in duffing.xs])
    for data, filtered in ((seen, True), (duffing, False)):
        found = ps.identify(data, candidates=["L-EDMDc"], progress=False)
        control = found.mpc(u_max=1.0, du_max=2.0, rate_weight=0.1, track=["x"])
        assert control.controller.estimates is filtered
        assert any("Kalman filter" in note for note in control.notes) is filtered


def test_columns_of_noise_without_a_unit_are_named(duffing: ps.Episodes) -> None:
    noise = np.random.default_rng(0)
    seen = [np.hstack([x, 0.01 * noise.standard_normal((len(x), 2))]) for x in duffing.xs]
    for units, told in (([""] * 4, True), (["m", "m/s", "m", "m"], False)):
        data = ps.Episodes(seen, duffing.us, duffing.dt, state_names=["x", "v", "a", "b"], units=units)
        report = ps.identify(data, candidates=["L-EDMDc"], progress=False).report()
        assert any("a, b count with their noise alone" in line for line in report.helps) is told


@pytest.mark.parametrize("name", ["L-EDMDc, 4 delays", "L-EDMDc, cubic", "B-EDMDc"])
def test_the_printed_code_does_the_same_by_hand(duffing: ps.Episodes, name: str) -> None:
    found = ps.identify(duffing, candidates=[name], progress=False)
    names: dict[str, Any] = {"d1": duffing}
    exec(found.report().code, names)
    np.testing.assert_array_equal(names["model"].lifted.A, found.lifted.A)


def test_the_printed_code_of_the_hold_split_does_the_same(
    arm: ps.TendonArm, d1: ps.Episodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = ps.identify(d1, arm=arm, candidates=["PI-EDMDc, hold"], progress=False)
    names: dict[str, Any] = {"d1": d1, "arm": arm}
    exec(found.report().code, names)
    assert names["model"].alpha_ == found.estimator.alpha_
    np.testing.assert_allclose(names["model"].K_, found.estimator.K_, rtol=1e-6, atol=1e-8)


def test_a_single_recording_is_cut_into_pieces(duffing: ps.Episodes) -> None:
    found = ps.identify(duffing[:1], candidates=["L-EDMDc"], progress=False)
    assert len(found.held) == 1 and len(found.held.us[0]) == 24


def test_failures_are_said_in_one_line(duffing: ps.Episodes, arm: ps.TendonArm, d1: ps.Episodes) -> None:
    short = replace(duffing[:1], xs=[duffing.xs[0][:20]], us=[duffing.us[0][:19]])
    still = replace(duffing, us=[np.ones_like(u) for u in duffing.us])
    frozen = replace(duffing, xs=[np.ones_like(x) for x in duffing.xs])
    noise = np.random.default_rng(0)
    white = replace(duffing, xs=[noise.standard_normal(x.shape) for x in duffing.xs])
    for given, said in (
        ({"d1": short}, "have 19 steps; expected 40 or more"),
        ({"d1": still}, "inputs never change"),
        ({"d1": frozen}, "states never change"),
        ({"d1": duffing.xs}, "expected Episodes"),
        ({"d1": duffing, "arm": 3}, "arm is a int; expected Arm"),
        ({"d1": duffing, "shapes": arm.rest_shapes(2)}, "without a drawing"),
        ({"d1": duffing, "candidates": ["PI"]}, "expected some of 'L-EDMDc'"),
        ({"d1": duffing, "candidates": ["PI-EDMDc, hold"]}, "no candidate predicts"),
    ):
        with pytest.raises(ValueError, match=said) as caught:
            ps.identify(**given, progress=False)
        assert "\n" not in str(caught.value)
    report = ps.identify(white, candidates=["L-EDMDc", "B-EDMDc"], progress=False).report()
    assert any("half of the motion itself" in line for line in report.unfit)


def test_limits_mirror_about_the_inputs_at_rest(duffing: ps.Episodes, arm: ps.TendonArm, d1: ps.Episodes) -> None:
    found = ps.identify(d1, arm=arm, candidates=["L-EDMDc"], progress=False)
    control = found.mpc(u_max=0.008, du_max=0.002, rate_weight=0.1)
    np.testing.assert_allclose(control.controller.u_min, 2 * arm.pretension - 0.008)
    assert not control.trials and control.controller.track == "tip"
    with pytest.raises(ValueError, match="not below u_max"):
        found.mpc(u_max=-1.0, du_max=0.1, rate_weight=0.1)


@pytest.mark.filterwarnings("default")
def test_where_a_loop_leaves_the_recordings_is_said(arm: ps.TendonArm, d1: ps.Episodes) -> None:
    """Without limits they are those of the recordings; others, and references beyond what was recorded, are named."""
    found = ps.identify(d1, arm=arm, candidates=["L-EDMDc"], progress=False)
    u, tip = d1.stacked_inputs(), d1.stacked_states()[:, list((d1.outputs or {})["tip"])]
    control = found.mpc(rate_weight=0.1)
    np.testing.assert_allclose(control.controller.u_max, u.max(axis=0))
    np.testing.assert_allclose(control.controller.u_min, u.min(axis=0))
    with pytest.warns(UserWarning, match=r"the limits let tendons\[\d\] go .* times as far as recorded"):
        found.mpc(u_max=4.0 * u.max(), du_max=0.002, rate_weight=0.1)
    half = 0.5 * np.ptp(tip[:, :2], axis=0)
    for radius, said in ((0.5 * half.min(), False), (1.5 * half.max(), True)):
        path = ps.references.circle(radius=radius, period=1.5, center=tip[:, :2].min(axis=0) + half, approach=0.3)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            log = control.run(arm, path, steps=8, progress=False)
        texts = [str(w.message) for w in caught if "leaves what was recorded" in str(w.message)]
        assert len(texts) == said and any("leaves what was recorded" in note for note in log.notes) == said
        assert all("[6] is to go" in text and "\n" not in text for text in texts)
