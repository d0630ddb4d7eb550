"""The paper's methods on data of a known linear system, and the cells of a run."""

from __future__ import annotations

import importlib
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.linalg

from pisplit import Episodes, PhaseSamples
from pisplit.models.arm import recording
from pisplit.models.arm.tendon_arm import TendonArm

SCRIPTS = Path(__file__).parent.parent / "scripts"
DT, STATES = 0.1, 9


@pytest.fixture(scope="module")
def modules() -> Any:
    sys.path.insert(0, str(SCRIPTS))
    try:
        rooms = {"paper": ("methods", "tables", "reproduce_paper"), "common": ("protocol", "runs", "data")}
        return SimpleNamespace(
            **{name: importlib.import_module(f"{room}.{name}") for room, names in rooms.items() for name in names}
        )
    finally:
        sys.path.remove(str(SCRIPTS))


@pytest.fixture(scope="module")
def generator() -> np.ndarray:
    """A stable f: every eigenvalue has a negative real part."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(STATES, STATES))
    return a - (np.abs(np.linalg.eigvals(a)).max() + 0.2) * np.eye(STATES)


@pytest.fixture(scope="module")
def data(modules: Any, generator: np.ndarray) -> Any:
    """x' = f(x) + b u: the known part is linear, the unknown one acts on the last three states."""
    rng = np.random.default_rng(1)
    b = np.zeros((STATES, 2))
    b[6:] = rng.normal(size=(3, 2))
    augmented = np.block([[generator, b], [np.zeros((2, STATES + 2))]])
    step = scipy.linalg.expm(DT * augmented)[:STATES]
    xs, us = [], []
    for _ in range(12):
        u, x = rng.normal(size=(24, 2)), [rng.normal(size=STATES)]
        for move in u:
            x.append(step @ np.concatenate([x[-1], move]))
        xs.append(np.array(x) + 5.0)  # an origin of its own
        us.append(u)
    quantities = ["p"] * 6 + ["q"] * 3
    episodes = Episodes(xs, us, dt=DT, quantities=quantities, outputs={"shape": range(6), "tip_velocity": range(6, 9)})
    samples = rng.normal(size=(300, STATES))
    half = samples @ scipy.linalg.expm(0.5 * DT * generator).T
    d2 = PhaseSamples(samples + 5.0, rng.normal(size=(300, 2)), samples @ generator.T, half + 5.0, DT)
    return modules.data.PaperData("any", episodes[:9], episodes[9:], d2)


def draw(modules: Any, data: Any, size: int) -> Any:
    rows = modules.protocol.random_pairs(data.training, size, 0)
    return modules.protocol.Draw("any", data.training, rows, data.d2, 0)


def test_units_have_no_mean_and_unit_deviation_and_constants_stay(modules: Any, data: Any) -> None:
    xs = [np.hstack([x, np.full((len(x), 1), 3.0) + 1e-9 * x[:, :1]]) for x in data.training.xs]
    quantities = ["p"] * 6 + ["q"] * 3 + ["v"]
    given = Episodes(xs, data.training.us, DT, quantities=quantities)
    for scaling in ("column", "quantity"):
        found = modules.methods.Units.of(given, scaling).episodes(given).stacked_states()
        np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=1e-12)
        assert found[:, 9].std() < 1e-7
    np.testing.assert_allclose(
        modules.methods.Units.of(given, "column").episodes(given).stacked_states()[:, :9].std(axis=0), 1.0
    )
    assert modules.methods.Units.of(given, "none").episodes(given).xs[0] is not None


@pytest.mark.parametrize("name", ["L-EDMDc", "B-EDMDc", "PI-EDMDc"])
def test_every_regression_is_the_lasso_that_the_paper_prints(modules: Any, data: Any, name: str) -> None:
    """0.01 N |.|_1 with N the samples of that regression, by optimality: the subgradient of the fit holds zero."""
    methods, given = modules.methods, draw(modules, data, 60)
    model, units = methods.Printed(name, methods.Choices(alpha=0.01, half_step="generator")).fitted(given)
    assert model.fit_.alpha == pytest.approx(0.01 * 60)
    theta, episodes = model.theta_, units.episodes(data.training)
    pairs = modules.protocol.pairs_at(episodes, given.rows, theta.n_delays)
    psi, target = theta.evaluate(pairs), theta.next_learned(pairs)
    k = model.K_
    if name == "PI-EDMDc":
        samples = units.samples(data.d2)
        static = np.hstack([samples.x, samples.u])
        generator, alpha = np.zeros((len(psi[0]), len(psi[0]))), 0.01 * len(samples)
        used = np.r_[:STATES, len(psi[0]) - 2 : len(psi[0])]
        generator[np.ix_(range(STATES), used)] = rows = lasso_by_cvxpy(static, samples.xdot, alpha)
        assert optimal(static, samples.xdot, rows, alpha, 1e-5)
        half = scipy.linalg.expm(0.5 * DT * generator)
        inverse = np.linalg.inv(half)  # K_f^+ Theta' with all of Theta' = [x'; delays and inputs as they are]
        target = (np.hstack([target, psi[:, STATES:]]) @ inverse.T)[:, :STATES]
        psi = psi @ half.T
        k = (inverse[:STATES] @ np.vstack([model.K_, np.eye(len(half))[STATES:]])) @ inverse
    assert optimal(psi, target, k, 0.6, 1e-4)


def lasso_by_cvxpy(a: np.ndarray, y: np.ndarray, alpha: float) -> np.ndarray:
    k = cp.Variable((y.shape[1], a.shape[1]))
    objective = cp.sum_squares(a @ k.T - y) + alpha * cp.sum(cp.abs(k))
    cp.Problem(cp.Minimize(objective)).solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11)
    return np.asarray(k.value)


def optimal(a: np.ndarray, y: np.ndarray, k: np.ndarray, alpha: float, tolerance: float) -> bool:
    """Is zero in the subdifferential of |A K^T - Y|^2 + alpha |K|_1?"""
    slope = 2.0 * (a @ k.T - y).T @ a
    small = np.abs(k) < 1e-7
    at_zero = np.abs(slope[small]).max(initial=0.0) <= alpha * (1.0 + tolerance)
    return bool(at_zero and np.abs(slope + alpha * np.sign(k))[~small].max(initial=0.0) <= tolerance * alpha)


@pytest.mark.parametrize("half_step", ["generator", "first-order", "flow"])
def test_half_step_of_a_linear_f_is_its_exponential(
    modules: Any, data: Any, generator: np.ndarray, half_step: str
) -> None:
    methods = modules.methods
    units = methods.Units.of(data.training, "none")
    centred = PhaseSamples(data.d2.x - 5.0, data.d2.u, data.d2.xdot, data.d2.x_half - 5.0, DT)
    choices = methods.Choices(half_step=half_step, known="least squares", scaling="none")
    model = methods.estimator("PI-EDMDc", data.training, choices)
    problem = model._problem(data.training, None, None, None)
    k_f = model._splitting(problem, units.samples(centred)).known()
    exact = scipy.linalg.expm(0.5 * DT * generator)
    if half_step == "first-order":
        exact = np.eye(STATES) + 0.5 * DT * generator
    np.testing.assert_allclose(k_f.K[:STATES, :STATES], exact, atol=1e-10)
    np.testing.assert_array_equal(k_f.K[STATES:, STATES:], np.eye(len(k_f.K) - STATES))
    assert k_f.kind == half_step


def test_without_penalty_the_split_is_direct_regression_and_both_predict_exactly(modules: Any, data: Any) -> None:
    """K_f cancels in K_f K_h K_f when it is invertible."""
    methods, protocol = modules.methods, modules.protocol
    choices = methods.Choices(alpha=1e-13, known="least squares")
    given = draw(modules, data, 90)
    for name in ("L-EDMDc", "PI-EDMDc"):
        errors = protocol.evaluate(methods.Printed(name, choices)(given), data.test)
        assert errors.diverged == 0.0 and errors.shape.max() < 1e-8


def test_bilinear_columns_are_those_of_the_paper(modules: Any, data: Any) -> None:
    theta = modules.methods.dictionary(data.training)
    assert theta.n_columns == 5 * STATES + 2
    assert theta.bilinear().n_columns == 5 * STATES * 3 + 2


class Counting:
    """A fit that counts its calls, and refuses draws of 8 pairs."""

    calls = 0

    def __init__(self, modules: Any) -> None:
        self.protocol = modules.protocol

    def __call__(self, given: Any) -> Any:
        Counting.calls += 1
        if len(given) == 8:
            raise ValueError("too few")
        return lambda test, start: self.protocol.Prediction(
            np.stack([x[start + 1 :, :6] + 1.0 / len(given) for x in test.xs]),
            np.stack([x[start + 1 :, 6:] for x in test.xs]),
            np.full(len(test), -1),
        )


def test_cells_are_resumed_refusals_counted_and_said_and_other_settings_refused(
    modules: Any, data: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = modules.runs
    source = SimpleSource(data)
    method = modules.protocol.Method("counting", Counting(modules))
    cells = list(runs.curve_cells(["any"], ["counting"], {8: 1, 16: 2}, 300))
    arguments = ({"any": source}, [method], cells, tmp_path)
    Counting.calls = 0
    first = runs.run_cells(*arguments, {"seed": 0}, workers=1, progress=False)
    assert Counting.calls == 3
    assert "any, counting, 8 pairs, draw 0: no fit, counted as divergence: " in capsys.readouterr().out
    (tmp_path / "any" / "counting" / "16-300-1.h5").write_bytes(b"truncated")
    again = runs.run_cells(*arguments, {"seed": 0}, workers=1, progress=False)
    assert Counting.calls == 4
    shutil.copy(tmp_path / "any" / "counting" / "16-300-0.h5", tmp_path / "any" / "counting" / "16-300-1.h5")
    again = runs.run_cells(*arguments, {"seed": 0}, workers=1, progress=False)
    assert Counting.calls == 5  # the result of another draw does not count
    for cell in cells:
        np.testing.assert_array_equal(first[cell].errors.shape, again[cell].errors.shape)
    rows = modules.tables.table(again)
    assert [(row["n1"], row["draws"], row["diverged"], row["refused fits"]) for row in rows] == [
        (8, 1, 1.0, 1),
        (16, 2, 0.0, 0),
    ]
    assert rows[1]["shape median [m^2]"] == pytest.approx(6.0 / 16**2, rel=1e-6)
    assert np.isinf(rows[0]["shape median [m^2]"])
    assert modules.tables.finite(rows)[0]["shape median [m^2]"] is None
    with pytest.raises(ValueError, match="other settings"):
        runs.run_cells(*arguments, {"seed": 1}, workers=1, progress=False)


class SimpleSource:
    """Data that are there already."""

    def __init__(self, data: Any) -> None:
        self.data = data

    def load_or_make(self) -> Any:
        """The data."""
        return self.data


def test_plan_takes_all_pairs_for_zero_and_leaves_out_what_a_law_has_not(modules: Any, data: Any) -> None:
    protocol = modules.reproduce_paper.Protocol(
        "a title",
        tuple(modules.protocol.Method(name, Counting(modules)) for name in ("one", "two", "drawn")),
        "drawn",
        sizes={8: 2, 10_000: 1, 0: 1},
        grid={8: 1},
        n2=(50, 300),
        left_out={"second": ("two",)},
    )
    cells = modules.reproduce_paper.plan_cells(protocol, {"first": data, "second": data})
    every = modules.runs.largest(data)
    assert len(set(cells)) == len(cells)
    for law, names in (("first", {"one", "two", "drawn"}), ("second", {"one", "drawn"})):
        mine = [cell for cell in cells if cell.law == law]
        curves = {(c.method, c.n1, c.seed) for c in mine if c.n2 == 300}
        assert curves == {(name, n1, seed) for name in names for n1, seed in ((8, 0), (8, 1), (every, 0))}
        assert [(c.method, c.n1, c.seed) for c in mine if c.n2 == 50] == [("drawn", 8, 0)]


def test_data_of_older_equations_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = TendonArm.paper()
    made = recording.episodes_origin(arm)
    recording.check_origin("d1.h5", made, recording.episodes_origin(arm))
    monkeypatch.setattr(recording, "EQUATIONS", recording.EQUATIONS + 1)
    with pytest.raises(ValueError, match=r"d1\.h5 holds data made with equations = \d+, not \d+"):
        recording.check_origin("d1.h5", made, recording.episodes_origin(arm))
