"""Facts of grids, masks and scales: what alpha is chosen from, where h may act, what is in the unit of what."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.generator.generator import KnownOptions, _varying
from pisplit.generator.half_step import _better, _condition, _growth, _miss
from pisplit.generator.spectrum import spectrum
from pisplit.models.rod.kinematics.gauss import GaussRule
from pisplit.models.rod.kinematics.strains import STRAIN_SETS
from pisplit.models.rod.terms.routing import check_routes, nodes_before
from pisplit.models.rod.terms.tendons import Line
from pisplit.regression.moments import Moments, accumulate
from pisplit.splitting import SplitContext, balanced, hold, two_stage
from pisplit.splitting.balanced import _sizes
from pisplit.splitting.rows import check_rows

#: Name of the room, its grids, and the ends that stand for the data alone and for the physical map alone.
GRIDS = {
    "two_stage": (two_stage.GRIDS, {"ridge": (1e-12, 1e8, 100.0), "lasso": (1e-8, 1.0, 10.0)}, True),
    "balanced": (balanced.GRIDS, {"ridge": (1e-10, 10.0, 10.0), "lasso": (1e-8, 1.0, 10.0)}, False),
    "hold": (hold.GRIDS, {"ridge": (1e-8, 1e3, 10.0), "lasso": (1e-8, 1.0, 10.0)}, False),
}


@pytest.mark.parametrize("penalty", ["ridge", "lasso"])
@pytest.mark.parametrize("room", list(GRIDS))
def test_grids_are_whole_powers_between_their_ends(room: str, penalty: str) -> None:
    grids, ends, with_zero = GRIDS[room]
    low, high, factor = ends[penalty]
    grid = np.array(grids[penalty])
    if with_zero or grid[0] == 0.0:
        assert grid[0] == 0.0
        grid = grid[1:]
    assert (grid[0], grid[-1]) == pytest.approx((low, high), rel=1e-12)
    assert grid[1:] / grid[:-1] == pytest.approx(factor, rel=1e-9)


def test_rows_of_a_context_and_its_penalties_are_plain_by_default() -> None:
    fields = SplitContext.__dataclass_fields__
    assert fields["generator_alpha"].default == 0.0 and fields["rows"].default is None


@pytest.mark.parametrize("rows", [["x1", True], [True, "x1"], ["x1", 2], [1, 0], [None]])
def test_rows_are_all_names_or_all_truth_values(rows: list[object]) -> None:
    with pytest.raises(ValueError, match=r"expected None, 'inputs', a list of names, or a boolean mask"):
        check_rows(rows)  # type: ignore[arg-type]


def test_sizes_are_root_mean_squares() -> None:
    columns = np.array([[3.0, 0.0, -2.0], [4.0, 0.0, 2.0]])
    assert _sizes(columns) == pytest.approx([np.sqrt(12.5), 1.0, 2.0])
    assert _sizes(7.0 * columns)[[0, 2]] == pytest.approx(7.0 * _sizes(columns)[[0, 2]])


@pytest.mark.parametrize(
    ("growth", "flow_growth", "generator", "flow", "taken"),
    [
        (1.0, 1.0, 0.6, 0.29, "flow"),  # misses less than half
        (1.0, 1.0, 0.6, 0.31, "generator"),  # more than half
        (1.0, 1.0, 0.4, 0.1, "generator"),  # the generator misses little
        (1.0, 1.5, 0.6, 0.1, "generator"),  # the flow map grows
        (1.2, 1.15, 0.1, 0.1, "flow"),  # the generator grows spuriously
        (1.2, 1.3, 0.9, 0.1, "generator"),  # both do, the flow more
    ],
)
def test_the_half_step_that_serves(
    growth: float, flow_growth: float, generator: float, flow: float, taken: str
) -> None:
    assert _better(growth, flow_growth, {"generator": generator, "flow": flow})[0] == taken


def test_strain_sets_free_what_their_names_say() -> None:
    """Bending about 1 and 2, torsion 3, shear along 1 and 2, stretch along 3."""
    assert {name: s.free for name, s in STRAIN_SETS.items()} == {
        "cosserat": (0, 1, 2, 3, 4, 5),
        "kirchhoff": (0, 1, 2),
        "extensible": (0, 1, 2, 5),
        "planar": (1,),
        "planar-cosserat": (1, 3, 5),
    }
    assert [s.planar for s in STRAIN_SETS.values()] == [False, False, False, True, True]


def test_tendons_end_where_elements_end_and_nowhere_else() -> None:
    rule = GaussRule(0.5, 4)
    assert nodes_before(None, rule, "Tendons") == nodes_before(0.5, rule, "Tendons") == 4
    for end in (0.0, 0.25, 0.6):
        with pytest.raises(ValueError, match=f"Tendons end = {end:g} m; expected the end of an element"):
            nodes_before(end, rule, "Tendons")


def test_a_line_is_as_long_as_it_runs_or_longer() -> None:
    rule = GaussRule(0.5, 4)
    for length in (0.5, 0.5 * (1 - 1e-12), 0.7):
        check_routes([Line((0.01, 0.0), (0.005, 0.0), length)], rule, 4, 0.5, "Tendons")
    with pytest.raises(ValueError, match=r"run to s = 0.5 m on a Line of length 0.49 m"):
        check_routes([Line((0.01, 0.0), (0.005, 0.0), 0.49)], rule, 4, 0.5, "Tendons")


def flow(now: np.ndarray, after: np.ndarray) -> Moments:
    return accumulate([np.hstack([now, after])])


def test_a_half_step_misses_what_it_misses_of_the_mean_too() -> None:
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=0)
    now = np.random.default_rng(0).normal(size=(50, 1))
    assert _miss(theta, np.eye(1), flow(now, now + 0.1), KnownOptions()) == pytest.approx(1.0, abs=1e-9)
    assert _miss(theta, np.array([[0.5]]), flow(now, 0.5 * now), KnownOptions()) == pytest.approx(0.0, abs=1e-12)


def test_columns_that_a_half_step_leaves_alone_count_in_its_condition_and_growth() -> None:
    late = Dictionary(ob.Identity(), ob.Delays(states=1), n_states=1, n_inputs=0)
    now = Dictionary(ob.Identity(), n_states=1, n_inputs=0)
    matrix = np.diag([0.5, 1.0])
    assert _condition(late, matrix, KnownOptions()) == pytest.approx(2.0)
    assert _growth(late, matrix, KnownOptions()) == 1.0
    assert _condition(now, matrix[:1, :1], KnownOptions()) == pytest.approx(1.0)
    assert _growth(now, matrix[:1, :1], KnownOptions()) == pytest.approx(0.5)


def test_inputs_that_do_not_vary_are_no_regressors_and_states_are() -> None:
    theta = Dictionary(ob.Identity(), n_states=1, n_inputs=2)
    data = np.column_stack([np.full(30, 2.0), np.full(30, 3.0), np.arange(30.0)])
    assert _varying(theta, accumulate([data]), np.arange(3)).tolist() == [True, False, True]


def test_five_doubtful_eigenfunctions_are_named() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 2))
    theta = Dictionary(ob.Polynomials(4), n_states=2, n_inputs=1)
    d2 = PhaseSamples(x, rng.normal(size=(60, 1)), np.column_stack([x[:, 1], -np.sin(3.0 * x[:, 0])]))
    run = np.vstack([np.zeros(2), np.cumsum(0.1 * rng.normal(size=(40, 2)), axis=0)])
    model = PIEDMDc(theta, 1.0, penalty="ridge").fit(Episodes([run], [rng.normal(size=(40, 1))], 0.1), d2)
    assert len(model.fit_.details["spurious"]) == 5


def test_the_residual_of_a_slow_eigenvalue_is_in_parts_of_its_own_rate() -> None:
    """Theta' = Theta L with an error that moves as fast as the slow function itself: it is believed in half at most."""
    theta = np.linalg.qr(np.random.default_rng(0).normal(size=(40, 3)))[0]
    generator = np.diag([-1.0, -1e4])
    lie = theta[:, :2] @ generator
    lie[:, 0] += theta[:, 2]
    found = spectrum(generator, theta[:, :2], lie, np.ones(2), ["slow", "fast"], 40)
    slow = int(np.argmin(np.abs(found.values)))
    assert found.residuals[slow] == pytest.approx(1.0 / (np.sqrt(2.0) + 1.0), rel=1e-6)
