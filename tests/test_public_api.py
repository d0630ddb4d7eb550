"""The code of the design document, block by block, with names as printed there and shorter loops."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest


@pytest.fixture(scope="module")
def built() -> SimpleNamespace:
    """The first lines of the document: an arm, its statics, a run, its fields."""
    from pisplit.models import rod

    arm = rod.Scene(
        rod.Rod(
            length=0.7144,
            section=rod.Circle(radius=0.675e-3),
            material=rod.Elastic(young=207e9, shear=207e9 / 2.6, density=33249.0),
            strains="kirchhoff",
        ),
        rod.Gravity((-9.81, 0.0, 0.0)),
        rod.KelvinVoigt(bending=5e-4, torsion=5e-4),
        rod.QuadraticDrag(1e-4),
        rod.Tendons.parallel(offset=15.06e-3, angles_deg=(0, 120, 240), drive=rod.Displacement(compliance=1e-4)),
    )
    statics = arm.statics()
    eq = statics.solve(u=[0.010, -0.005, -0.005])
    sim = arm.simulator(dt=0.03, rtol=3e-5)
    turns = np.random.default_rng(0).uniform(0, 2 * np.pi, 4)
    angles = np.deg2rad([0, 120, 240])
    inputs = [
        0.001 + 0.006 * np.sin(np.linspace(0, 3, 40))[:, None] * np.cos(angles - turn) for turn in turns
    ]  # 40 steps each
    return SimpleNamespace(rod=rod, arm=arm, statics=statics, eq=eq, sim=sim, inputs=inputs)


def test_statics(built: SimpleNamespace) -> None:
    arm, eq, statics = built.arm, built.eq, built.statics
    assert eq.success and eq.state.shape == (arm.n_states,)
    assert eq.tensions.shape == eq.slack.shape == (3,) and eq.residual <= 1e-8
    assert eq.iterations is None or eq.iterations >= 0
    p, R = eq.pose(0.7144)
    assert p.shape == (3,)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-10)
    U = np.tile([0.010, -0.005, -0.005], (5, 1)) * np.linspace(0, 1, 5)[:, None]
    batch = statics.solve_many(U)
    assert batch.success.all()
    np.testing.assert_allclose(batch.states[-1], eq.state, atol=1e-7)


def test_dynamics_and_fields(built: SimpleNamespace) -> None:
    arm, sim, eq = built.arm, built.sim, built.eq
    U = np.tile([0.010, -0.005, -0.005], (4, 1))
    traj = sim.run(u=U, x0=eq.state)
    assert traj.success
    assert traj.t.shape == (5,) and traj.x.shape == (5, arm.n_states) and traj.u.shape == (4, 3)
    y = arm.fields(traj.x, stations=6)
    assert y.shape == (5, 6, 24)
    np.testing.assert_array_equal(traj.fields(6), y)
    np.testing.assert_allclose(y[-1, -1, :3], eq.tip, atol=1e-5)  # it rests


def test_scenes_are_edited_by_their_terms(built: SimpleNamespace) -> None:
    rod, arm = built.rod, built.arm
    load = rod.TipWrench(force=(0, 0, -1), moment=(0, 0, 0))
    loaded = arm + load
    assert loaded.n_inputs == arm.n_inputs and (loaded - load) == arm
    driven = arm + rod.TipWrench(force=rod.Input("f", 3))
    assert driven.input_names[-3:] == ("f[0]", "f[1]", "f[2]") and driven.n_inputs == arm.n_inputs + 3
    assert "9.81" in str(arm) and arm.replace(rod.Gravity((0.0, 0.0, -9.81))) != arm


def test_identification_and_control(built: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
    from pisplit import observables as ob
    from pisplit.controllers import MPC, ClosedLoop, references

    arm, sim = built.arm, built.sim
    rest = arm.statics().solve(np.full(3, 1e-3)).state
    found = arm.field_map(6)
    runs = [sim.run(u, rest) for u in built.inputs]
    labels = {"state_names": found.names, "quantities": found.quantities, "outputs": found.outputs}
    Episodes(
        [run.fields(6).reshape(41, -1) for run in runs], built.inputs, dt=0.03, input_names=arm.input_names, **labels
    ).save(tmp_path / "d1.h5")
    states = np.concatenate([run.x for run in runs])[::2]
    x = arm.fields(states, 6).reshape(len(states), -1)
    PhaseSamples(x, states[:, -3:], np.zeros_like(x)).save(tmp_path / "d2.h5")
    monkeypatch.chdir(tmp_path)

    d1 = Episodes.load("d1.h5")
    d2 = PhaseSamples.load("d2.h5")
    theta = Dictionary(
        ob.Identity(), ob.Delays(states=4, inputs=1), ob.Slack(), n_states=d1.n_states, n_inputs=d1.n_inputs
    )
    test_episodes = d1[3:]
    start = d1.start(3, theta.n_delays)
    history, U = (start.x_history, start.u_history), start.inputs
    lean = Dictionary(ob.Constant(), ob.Identity(), ob.Delays(inputs=1), n_states=d1.n_states, n_inputs=d1.n_inputs)
    for model in (
        PIEDMDc(theta, alpha=1e-3, toward="identity", penalty="ridge").fit(d1[:3], d2),
        LinearEDMDc(lean, alpha="cv").fit(d1),
    ):
        lifted = model.lifted
        if model.theta_.n_delays == 4:
            assert model.predict(history, U).shape == (len(U) + 1, d1.n_states)
        assert np.isfinite(model.score(test_episodes).median)
        assert lifted.A.shape == (lifted.n_lifted, lifted.n_lifted)
        assert lifted.B.shape == (lifted.n_lifted, lifted.n_features) and lifted.C.shape == (144, lifted.n_lifted)
        lifted.save("model.h5")
        np.testing.assert_array_equal(type(lifted).load("model.h5").A, lifted.A)

    mpc = MPC(lifted, horizon=20, u_min=-0.02, u_max=0.02, du_max=0.005, track="tip")
    log = ClosedLoop(plant=sim, controller=mpc).run(references.circle(radius=0.05, period=6.0), steps=12)
    assert not log.stopped, log.message
    assert log.u.shape == (12, 3) and log.limit_violations == 0


def test_small_systems() -> None:
    from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc
    from pisplit import observables as ob
    from pisplit.models import systems

    sm = systems.slow_manifold(mu=-0.1, lam=-1.0, delta=10.0)
    rng = np.random.default_rng(0)
    u = 0.1 * rng.normal(size=(200, 1))
    x = sm.simulate([0.3, 0.7], u, 1e-3)
    X2, U2 = rng.uniform(-1, 1, (100, 2)), np.zeros((100, 1))
    d1 = Episodes([x], [u], dt=1e-3)
    d2 = PhaseSamples.from_system(sm, X2, U2)
    theta = Dictionary(
        ob.Constant(), ob.Identity(), ob.Expression(lambda x, u: x[0] ** 2, name="x1^2"), n_states=2, n_inputs=1
    )
    model = PIEDMDc(theta, alpha=0.0, half_step="generator", rows="inputs").fit(d1, d2)
    X_hat = model.predict(x[0], u)
    assert X_hat.shape == x.shape and np.abs(X_hat - x).max() < 1e-3


def test_every_public_name_is_there() -> None:
    import pisplit
    from pisplit import controllers
    from pisplit.models import ControlSystem, rod

    for package in (pisplit, controllers, rod):
        for name in package.__all__:
            assert getattr(package, name).__doc__, f"{package.__name__}.{name} says nothing"
    assert ControlSystem.__doc__


def test_every_exported_name_exists_and_none_hides_a_module() -> None:
    import pisplit

    assert sorted(pisplit.__all__) == sorted(set(pisplit.__all__))
    folder = Path(pisplit.__file__).parent
    for name in pisplit.__all__:
        assert hasattr(pisplit, name)
        assert name in ("observables", "references") or not (folder / f"{name}.py").exists()


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = ("casadi", "cvxpy", "matplotlib", "joblib", "numpy", "scipy", "h5py", "osqp", "pisplit.models")
    code = f"import sys, pisplit; print([m for m in {heavy} if m in sys.modules])"
    tree = str(Path(__file__).resolve().parent.parent)
    found = subprocess.run([sys.executable, "-c", code], cwd=tree, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_lazy_names_are_those_that_type_checkers_see() -> None:
    import ast

    import pisplit

    tree = ast.parse(Path(pisplit.__file__).read_text())
    (typed,) = [n for n in tree.body if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)]
    seen = {a.asname: n.module for n in typed.body if isinstance(n, ast.ImportFrom) for a in n.names}
    assert sorted(seen) == pisplit.__all__ == sorted({*pisplit._HOME, *pisplit._MODULES})
    assert {name: seen[name] for name in pisplit._HOME} == pisplit._HOME
    assert set(pisplit.__all__) <= set(dir(pisplit))
    with pytest.raises(AttributeError, match="has no attribute 'LinearEDMD'"):
        pisplit.LinearEDMD  # noqa: B018


def test_the_version_stands_in_one_place() -> None:
    import re

    import tomllib

    import pisplit

    project = tomllib.loads((Path(__file__).resolve().parent.parent / "pyproject.toml").read_text())
    assert project["project"]["dynamic"] == ["version"] and "version" not in project["project"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "pisplit.__version__"}
    assert re.fullmatch(r"0\.2\.0", pisplit.__version__)


def test_changelog_and_citation_know_the_version() -> None:
    import pisplit

    root = Path(__file__).resolve().parent.parent
    assert f"\n## {pisplit.__version__}\n" in (root / "CHANGELOG.md").read_text()
    assert f"\nversion: {pisplit.__version__}\n" in (root / "CITATION.cff").read_text()


def test_the_first_equilibrium_of_a_process_loads_nothing_that_it_does_not_use() -> None:
    code = (
        "import sys\n"
        "from pisplit.models.arm.tendon_arm import TendonArm\n"
        "assert TendonArm.paper().scene.statics().solve([0.01, -0.005, -0.005]).success\n"
        "unused = ('scipy.interpolate', 'scipy.optimize', 'scipy.spatial', 'cvxpy', 'matplotlib', 'osqp', 'PIL')\n"
        "print([m for m in unused if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
