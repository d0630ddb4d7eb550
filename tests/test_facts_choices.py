"""Facts of grids, masks and scales: what alpha is chosen from, where h may act, what is in the unit of what."""

from __future__ import annotations

import numpy as np
import pytest

from pisplit.generator.half_step import _better
from pisplit.models.rod.kinematics.gauss import GaussRule
from pisplit.models.rod.kinematics.strains import STRAIN_SETS
from pisplit.models.rod.terms.routing import check_routes, nodes_before
from pisplit.models.rod.terms.tendons import Line
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
