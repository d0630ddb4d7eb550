"""The rod against published closed forms and reference values; ``validation.json`` holds numbers, units, sources."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pisplit.models import rod

CASES = json.loads(Path(__file__).with_name("validation.json").read_text())["cases"]


def given(case: str) -> tuple[dict[str, Any], list[dict[str, Any]], float]:
    """Inputs (values only), rows and tolerance of a case."""
    found = CASES[case]
    return {k: v["value"] for k, v in found["inputs"].items()}, found["rows"], found["tolerance"]["value"]


def beam(strains: str = "kirchhoff", axial: float = 1e7, length: float = 1.0) -> rod.Rod:
    """A rod with EI = 1 N m^2, the axial stiffness in N, equal shear stiffness and 1 kg/m."""
    radius = 2.0 / np.sqrt(axial)
    area = np.pi * radius**2
    return rod.Rod(length, rod.Circle(radius), rod.Elastic(axial / area, axial / area, 1.0 / area), strains)


def steel(strains: str = "kirchhoff") -> rod.Rod:
    """The slender rod of the vibration cases."""
    p, _, _ = given("bending_frequencies")
    return rod.Rod(
        p["length"], rod.Circle(p["radius"]), rod.Elastic(p["young"], p["young"] / 2.6, p["density"]), strains
    )


def robot(strains: str) -> rod.Rod:
    """The backbone of the tendon cases."""
    p, _, _ = given("tendons_by_tension")
    return rod.Rod(p["length"], rod.Circle(p["radius"]), rod.Elastic(p["young"], p["shear"], 8000.0), strains)


@pytest.mark.parametrize("strains", ["kirchhoff", "planar"])
def test_elastica_under_a_dead_force(strains: str) -> None:
    _, rows, tolerance = given("elastica_dead")
    statics = rod.Scene(beam(strains), rod.TipWrench(force=rod.Input("f", 3)), nodes=8).statics()
    for row in rows:
        equilibrium = statics.solve([row["force"], 0.0, 0.0])
        p, R = equilibrium.pose(1.0)
        assert equilibrium.success
        assert np.abs(p - [row["tip_x"], 0.0, row["tip_z"]]).max() <= tolerance
        assert np.arctan2(R[0, 2], R[2, 2]) == pytest.approx(row["tip_angle"], abs=tolerance)


def test_elastica_under_a_follower_force() -> None:
    _, rows, tolerance = given("elastica_follower")
    load = rod.TipWrench(force=rod.Input("f", 3), follower=True)
    statics = rod.Scene(beam(), load, nodes=12).statics()
    for row in rows:
        equilibrium = statics.solve([row["force"], 0.0, 0.0])
        p, R = equilibrium.pose(1.0)
        assert equilibrium.residual < 1e-8  # in balance; an undamped rod flutters from 22.4 EI/L^2 on
        assert np.abs(p - [row["tip_x"], 0.0, row["tip_z"]]).max() <= tolerance
        assert abs(np.arctan2(R[0, 2], R[2, 2])) == pytest.approx(row["tip_angle"], abs=tolerance)


@pytest.mark.parametrize("strains", ["cosserat", "planar"])
def test_a_tip_moment_rolls_the_rod_into_a_circle(strains: str) -> None:
    _, rows, tolerance = given("roll_up")
    statics = rod.Scene(beam(strains), rod.TipWrench(moment=rod.Input("m", 3)), nodes=10).statics()
    for row in rows:
        p, R = statics.solve([0.0, 2.0 * np.pi * row["turns"], 0.0]).pose(1.0)
        angle = 2.0 * np.pi * row["turns"]
        c, s = np.cos(angle), np.sin(angle)
        assert np.abs(p - row["tip"]).max() <= tolerance
        assert pytest.approx(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), abs=1e-10) == R


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat"])
def test_heavy_elastica(strains: str) -> None:
    """The extension that Kirchhoff strains leave out is w L / (2 EA) = 3e-6 L at most here."""
    _, rows, tolerance = given("heavy_elastica")
    scene = rod.Scene(beam(strains), rod.Gravity(rod.Input("g", 3)), nodes=12)
    for row in rows[:2]:
        tip = scene.statics().solve([row["weight"], 0.0, 0.0]).tip
        assert np.abs(tip - row["tip"]).max() <= tolerance


def test_heavy_elastica_hangs_where_slow_loading_takes_it() -> None:
    """At 60 N/m Newton's method falls from straight to a curled, unstable root: not what the rod does."""
    _, rows, tolerance = given("heavy_elastica")
    load, scene = [rows[2]["weight"], 0.0, 0.0], rod.Scene(beam("planar"), rod.Gravity(rod.Input("g", 3)), nodes=20)
    found = scene.statics().solve(load)
    assert found.success and found.stable and found.branch == "followed" and found.margin > 0.5
    assert np.abs(found.tip - rows[2]["tip"]).max() <= tolerance


def test_short_rod_that_shears() -> None:
    p, rows, tolerance = given("timoshenko")
    section = rod.Circle(p["radius"], shear_factor=p["shear_factor"])
    body = rod.Rod(p["length"], section, rod.Elastic(p["young"], p["shear"], 1000.0), "cosserat")
    tip = rod.Scene(body, rod.TipWrench(force=p["force"])).statics().solve().tip
    assert np.abs(tip - [rows[0]["tip_x"], 0.0, rows[0]["tip_z"]]).max() <= tolerance
    assert -tip[0] == pytest.approx(CASES["timoshenko"]["linear_deflection"]["value"], rel=5e-3)


def test_pull_and_torque() -> None:
    p, rows, tolerance = given("axial_and_torsion")
    section = rod.Circle(0.01)
    young, shear = p["axial_stiffness"] / section.area, p["torsional_stiffness"] / section.second_moments[2]
    body = rod.Rod(p["length"], section, rod.Elastic(young, shear, 1000.0), "cosserat")
    pulled = rod.Scene(body, rod.TipWrench(force=(0.0, 0.0, p["force"]))).statics().solve()
    twisted = rod.Scene(body, rod.TipWrench(moment=(0.0, 0.0, p["torque"]))).statics().solve()
    R = twisted.pose(p["length"])[1]
    assert pulled.tip[2] == pytest.approx(rows[0]["tip_z"], abs=tolerance)
    assert np.arctan2(R[1, 0], R[0, 0]) == pytest.approx(rows[0]["twist"], abs=tolerance)


def test_tendons_driven_by_tension() -> None:
    p, rows, tolerance = given("tendons_by_tension")
    tendons = rod.Tendons.parallel(p["offset"], p["angles"], rod.Tension())
    scene = rod.Scene(robot("cosserat"), tendons)
    for row in rows:
        equilibrium = scene.statics().solve(row["tensions"])
        assert np.abs(equilibrium.tip - row["tip"]).max() <= tolerance
        assert equilibrium.tensions == pytest.approx(row["tensions"])
        assert not equilibrium.slack.any()


def test_inextensible_rod_leaves_out_only_the_shortening_by_tendons() -> None:
    """Kirchhoff strains miss sum tau / EA = 4e-5 of stretch."""
    p, rows, _ = given("tendons_by_tension")
    tendons = rod.Tendons.parallel(p["offset"], p["angles"], rod.Tension())
    scene = rod.Scene(robot("kirchhoff"), tendons)
    for row in rows:
        shortening = p["length"] * sum(row["tensions"]) / robot("kirchhoff").stiffness[5]
        assert np.abs(scene.statics().solve(row["tensions"]).tip - row["tip"]).max() <= 1.01 * shortening


def test_tendons_driven_by_displacement_and_slack() -> None:
    p, rows, tolerance = given("tendons_by_displacement")
    tendons = rod.Tendons.parallel(p["offset"], p["angles"], rod.Displacement(p["compliance"]))
    statics = rod.Scene(robot("cosserat"), tendons).statics()
    for row in rows:
        equilibrium = statics.solve(row["displacements"])
        assert np.abs(equilibrium.tip - row["tip"]).max() <= tolerance
        assert np.abs(equilibrium.tensions - row["tensions"]).max() <= tolerance
        assert np.abs(equilibrium.slack - row["slack"]).max() <= tolerance


@pytest.mark.parametrize("strains", ["cosserat", "kirchhoff", "planar"])
def test_bending_frequencies(strains: str) -> None:
    _, rows, tolerance = given("bending_frequencies")
    scene = rod.Scene(steel(strains), nodes=8)
    values = scene.linearise(scene.statics().solve().state).eigenvalues
    assert np.abs(values.real).max() <= 1e-6 * np.abs(values.imag).max()
    for row in rows:
        assert np.abs(np.abs(values.imag) / row["angular_frequency"] - 1.0).min() <= tolerance


def test_decay_rates() -> None:
    p, rows, tolerance = given("damping_rates")
    free = rod.Scene(steel(), nodes=6)
    k = free.rod.stiffness
    material = free + rod.KelvinVoigt(bending=p["beta"] * k[0], torsion=p["beta"] * k[2])
    drag = free + rod.LinearDrag(p["drag"])
    rate = {}
    for name, scene in (("kelvin_voigt", material), ("drag", drag)):
        rate[name] = scene.linearise(scene.statics().solve().state).eigenvalues[0]
        assert -rate[name].real == pytest.approx(rows[0][name], rel=tolerance)
    assert abs(rate["kelvin_voigt"].imag) == pytest.approx(rows[0]["damped_angular_frequency"], rel=tolerance)


def test_soft_rod_under_a_ramped_tip_load() -> None:
    """Undamped waves of a rod that shears and stretches; the ramp enters as linear pieces of 10 ms."""
    p, rows, tolerance = given("ramped_tip_load")
    section = rod.Circle(p["radius"], shear_factor=p["shear_factor"])
    body = rod.Rod(p["length"], section, rod.Elastic(p["young"], p["shear"], p["density"]), "cosserat")
    scene = rod.Scene(body, rod.TipWrench(force=rod.Input("f", 3)), nodes=5)
    dt = 0.01
    t = dt * np.arange(1, 101)

    def ramp(x: np.ndarray) -> np.ndarray:
        x = np.minimum(x, 1.0)
        return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)

    rise = p["ramp_time"]
    forces = p["force"] * np.stack([ramp(t / rise), 0.5 * ramp(t / (2.0 * rise)), 0.0 * t], axis=1)
    trajectory = scene.simulator(dt, rtol=1e-5).run(forces, check=False)
    assert trajectory.success
    tip = trajectory.fields([p["length"]])[:, 0, :3]
    reference = np.array([row["tip"] for row in rows])
    found = tip[np.round(np.array([row["t"] for row in rows]) / dt).astype(int)]
    assert np.abs(found - reference).max() <= tolerance * np.ptp(reference, axis=0).max()
