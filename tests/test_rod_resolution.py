"""Are the nodes enough? Estimates beside closed forms and finer grids, warnings, and nodes that are chosen."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.section.jumps import cut, jumps
from pisplit.models.rod.statics import refinement
from pisplit.models.rod.statics.equilibrium import Equilibrium

EI = 1e6 * np.pi * 0.01**4 / 4
STEEL = rod.Elastic(1e6, 4e5, 1000.0)


def body(strains: str = "kirchhoff", section: rod.Circle | rod.Tapered = rod.Circle(0.01)) -> rod.Rod:  # noqa: B008
    return rod.Rod(1.0, section, STEEL, strains)


def roll(nodes: int) -> rod.Scene:
    """A moment about y rolls a plane rod to a circle."""
    return rod.Scene(body("planar"), rod.TipWrench(moment=rod.Input("m", 3)), nodes=nodes)


def moment(turns: float) -> np.ndarray:
    return np.array([0.0, 2.0 * np.pi * turns * EI, 0.0])


def arc(turns: float, s: np.ndarray) -> np.ndarray:
    w = 2.0 * np.pi * turns
    return np.stack([(1.0 - np.cos(w * s)) / w, 0.0 * s, np.sin(w * s) / w], axis=1)


def solved(scene: rod.Scene, u: np.ndarray | None = None) -> Equilibrium:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rod.Unresolved)
        return scene.statics().solve(u)


@pytest.mark.parametrize("nodes", [4, 6, 8])
@pytest.mark.parametrize("turns", [0.5, 1.0, 2.0])
def test_the_error_of_a_roll_is_its_distance_from_the_circle(turns: float, nodes: int) -> None:
    found = solved(roll(nodes), moment(turns))
    stations = np.linspace(0.05, 1.0, 20)
    shape = found.scene.fields(found.state, stations)[:, :3]
    true = np.linalg.norm(shape - arc(turns, stations), axis=1).max()
    assert 0.75 * true <= found.error <= 1.1 * true


def helix(nodes: int) -> tuple[rod.Scene, np.ndarray | None]:
    return rod.Scene(body(), rod.Tendons.helical(0.008, 1.0, (0,), rod.Tension()), nodes=nodes), np.array(
        [4 * EI / 0.008]
    )


def taper(nodes: int) -> tuple[rod.Scene, np.ndarray | None]:
    thin = rod.Tapered(rod.Circle(0.01), rod.Circle(0.001))
    return rod.Scene(body(section=thin), rod.Gravity((0.3, 0.0, 0.0)), nodes=nodes), None


def tip(nodes: int) -> tuple[rod.Scene, np.ndarray | None]:
    force = rod.TipWrench(force=(8.0 * EI, 3.0 * EI, -4.0 * EI))
    return rod.Scene(body("cosserat"), force, nodes=nodes), None


@pytest.mark.parametrize("made", [helix, taper, tip])
def test_errors_are_those_against_a_fine_grid(made: Callable[[int], tuple[rod.Scene, np.ndarray | None]]) -> None:
    finest, u = made(12)
    exact = finest.fields(solved(finest, u).state, 20)[:, :3]
    for nodes in (4, 6):
        scene, u = made(nodes)
        found = solved(scene, u)
        true = np.linalg.norm(scene.fields(found.state, 20)[:, :3] - exact, axis=1).max()
        assert 0.6 * true <= found.error <= 1.3 * true


def test_elements_are_resolved_each_on_its_own() -> None:
    cut = rod.Rod(1.0, rod.Circle(0.01), STEEL, "planar", elements=(0.3, 0.7))
    scene = rod.Scene(cut, rod.TipWrench(moment=rod.Input("m", 3)), nodes=(3, 6))
    found = solved(scene, moment(1.0))
    stations = np.linspace(0.05, 1.0, 20)
    true = np.linalg.norm(scene.fields(found.state, stations)[:, :3] - arc(1.0, stations), axis=1).max()
    assert 0.75 * true <= found.error <= 1.2 * true


def test_a_shape_that_the_nodes_do_not_resolve_is_said_once_and_again_where_loads_grow() -> None:
    statics = roll(6).statics()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        statics.solve(moment(0.5))
    with pytest.warns(rod.Unresolved, match=r"6 nodes do not resolve this shape: off by 0.002 .*; nodes=8 would do"):
        statics.solve(moment(1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        statics.solve(moment(1.05))
    with pytest.warns(rod.Unresolved, match="nodes=12 would do"):
        statics.solve(moment(2.0))


@pytest.mark.parametrize("method", ["solve_many", "sweep"])
def test_of_many_shapes_the_most_bent_is_checked(method: str) -> None:
    rows = np.array([moment(turns) for turns in (0.1, 0.5, 1.0, 0.3)])
    with pytest.warns(rod.Unresolved, match="off by 0.002"):
        getattr(roll(6).statics(), method)(rows)


def test_the_warning_points_to_the_line_that_asked() -> None:
    with pytest.warns(rod.Unresolved) as said:
        roll(4).statics().solve(moment(1.0))
    assert said[0].filename == __file__


def test_the_paper_arm_is_resolved() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = TendonArm.paper().scene.statics().solve([0.01, -0.005, -0.005])
    assert 1e-5 < found.error < 1e-3


def test_nodes_that_are_named_or_chosen_do() -> None:
    exact = arc(2.0, np.linspace(0.05, 1.0, 20))
    scene = roll(4).resolved(moment(2.0))
    found = scene.statics().solve(moment(2.0))
    assert scene.element_nodes == (12,) and found.error <= 1e-4
    assert np.linalg.norm(scene.fields(found.state, 20)[:, :3] - exact, axis=1).max() <= 1.3e-4
    assert roll(4).resolved(moment(2.0), tolerance=1e-2).element_nodes == (8,)
    assert roll(14).resolved(moment(2.0)).element_nodes == (14,)
    assert roll(4).resolved().element_nodes == (4,)
    tapered, _ = taper(4)
    chosen = rod.Scene(tapered.rod, *tapered.terms, nodes="auto")
    assert chosen == tapered.with_nodes(6) and chosen.statics().solve().error <= 1e-4


def stepped(s: float) -> rod.Circle:
    return rod.Circle(0.01 if s < 0.37 else 0.005)


def hinge(s: float) -> rod.Elastic:
    return rod.Elastic(1e5 if 0.3 < s < 0.45 else 1e6, 4e5, 1000.0)


def curved(s: float) -> tuple[float, float, float]:
    return (0.0, 3.0 if s < 0.61 else -3.0, 0.0)


def patch(s: float) -> tuple[float, float, float]:
    return (10.0 * EI if 0.2 < s < 0.33 else 0.0, 0.0, 0.0)


ROUND = rod.Circle(0.01)
SAG = rod.Gravity((0.3, 0.0, 0.0))
JUMPS = {
    "section": (rod.Rod(1.0, stepped, STEEL, "planar"), (SAG,), [0.37]),
    "material": (rod.Rod(1.0, ROUND, hinge, "planar"), (rod.TipWrench(force=(EI, 0.0, 0.0)),), [0.3, 0.45]),
    "rest curvature": (rod.Rod(1.0, ROUND, STEEL, "planar", rest_curvature=curved), (SAG,), [0.61]),
    "force": (body("planar"), (rod.PointWrench(0.43, force=(10.0 * EI, 0.0, 0.0)),), [0.43]),
    "moment": (body("planar"), (rod.PointWrench(0.43, moment=(0.0, 3.0 * EI, 0.0)),), [0.43]),
    "mass": (body("planar"), (rod.Gravity((2.0, 0.0, 0.0)), rod.PointMass(0.57, 0.02)), [0.57]),
    "load per length": (body("planar"), (rod.DistributedWrench(force=patch),), [0.2, 0.33]),
}


def shape(scene: rod.Scene) -> np.ndarray:
    found = solved(scene)
    points = found.scene.statics().resolution.shapes[0](found.state[: scene.n_strains], np.zeros(scene.n_inputs))
    return np.asarray(points).T


@pytest.mark.parametrize("name", JUMPS)
def test_elements_end_where_something_jumps(name: str) -> None:
    """Within 1e-4 L by themselves; on four nodes as far off as it is said, with the places that would do."""
    made, terms, places = JUMPS[name]
    cut = replace(made, elements=tuple(np.diff([0.0, *places, 1.0])))
    exact = shape(rod.Scene(cut, *terms, nodes=7))
    chosen = rod.Scene(made, *terms, nodes="auto")
    assert chosen.rule.borders[1:-1] == pytest.approx(places, abs=1e-9)
    assert np.linalg.norm(shape(chosen) - exact, axis=1).max() <= 1.3e-4
    smeared = rod.Scene(made, *terms)
    off = np.linalg.norm(shape(smeared) - exact, axis=1).max()
    assert off > 1e-3 and solved(smeared).error == pytest.approx(off, rel=0.25)
    with pytest.warns(rod.Unresolved, match=f"elements that end at s = {', '.join(map(str, places))} m too"):
        rod.Scene(made, *terms).statics().solve()


def test_a_tendon_may_end_anywhere_where_nodes_are_chosen() -> None:
    pull = rod.Tendons.parallel(8e-3, (0, 180), rod.Tension(), end=0.43)
    scene = rod.Scene(body("planar"), pull, nodes="auto")
    bent = scene.statics().solve([3.0 * EI / 8e-3, 0.0])
    assert scene.rule.borders == (0.0, 0.43, 1.0) and bent.error < 1e-4
    assert scene.fields(bent.state, [0.43, 1.0])[:, 16] == pytest.approx([3.0, 0.0])  # 1/m


def test_a_strong_taper_is_cut_where_more_nodes_help_little() -> None:
    """100:1 with a load that curls its last centimetre, beside six elements."""
    needle = rod.Rod(1.0, rod.Tapered(rod.Circle(0.01), rod.Circle(1e-4)), STEEL, "planar")
    load = rod.TipWrench(force=(3e4 * EI * 1e-8, 0.0, 0.0))
    fine = replace(needle, elements=(0.4, 0.3, 0.18, 0.08, 0.03, 0.01))
    reference = rod.Scene(fine, load, nodes=5)
    chosen = rod.Scene(needle, load, nodes="auto")
    assert len(chosen.element_nodes) > 3
    assert np.linalg.norm(shape(chosen) - shape(reference), axis=1).max() < 1e-4


def test_jumps_are_found_where_they_are() -> None:
    assert jumps(lambda s: [np.sin(30.0 * s), 1.0 if s > 1.0 / 3.0 else 0.0], 0.0, 1.0) == pytest.approx([1.0 / 3.0])
    assert jumps(lambda s: np.log(1.0 - 0.99 * s), 0.0, 1.0) == []
    halves = rod.Rod(1.0, (ROUND, rod.Circle(0.02)), STEEL, elements=(0.5, 0.5))
    again, owner = cut(halves, [0.5, 0.7, 0.7 + 1e-12])
    assert owner == [0, 1, 1] and again.elements == pytest.approx((0.5, 0.2, 0.3))
    assert [again.section_at(s).area for s in (0.4, 0.6, 0.9)] == [halves.section_at(s).area for s in (0.4, 0.6, 0.9)]


def test_what_no_number_of_nodes_resolves_is_refused() -> None:
    coil = rod.Rod(1.0, rod.Circle(0.01), STEEL, "planar", rest_curvature=(0.0, 40.0 * np.pi, 0.0))
    with pytest.warns(rod.Unresolved, match="not even 24 would do"):
        rod.Scene(coil, nodes=8).statics().solve()
    with pytest.raises(ValueError, match="more than 24 nodes an element"):
        rod.Scene(coil, nodes="auto")
    with pytest.raises(ValueError, match="nodes = 'many'"):
        rod.Scene(coil, nodes="many")
    with pytest.raises(ValueError, match="tolerance"):
        roll(4).resolved(moment(1.0), tolerance=0.0)


def test_more_nodes_are_tried_where_few_find_no_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    """In space four nodes lose a rod that is rolled twice, which ten hold; if no more may be tried it is said."""
    rolled = rod.Scene(body(), rod.TipWrench(moment=rod.Input("m", 3)))
    assert not rolled.statics().solve(moment(2.0)).success
    assert rolled.resolved(moment(2.0)).element_nodes == (12,)
    monkeypatch.setattr(refinement, "MOST", 5)
    with pytest.raises(ValueError, match=r"no equilibrium under .* to choose nodes by: .*; give other inputs"):
        rolled.resolved(moment(2.0))


def test_a_search_that_failed_has_no_error_to_trust() -> None:
    found = rod.Scene(body(), rod.TipWrench(moment=rod.Input("m", 3))).statics().solve(moment(2.0))
    assert not found.success and found.error == np.inf


def test_a_bent_rod_at_rest_names_its_nodes() -> None:
    """Strains of an unloaded rod are exact on any grid, and its shape is not."""
    body = rod.Rod(1.0, rod.Circle(0.01), rod.Elastic(1e6, 4e5, 1000.0), "planar", rest_curvature=(0.0, 3.0, 0.0))
    with pytest.warns(rod.Unresolved, match="2 nodes do not resolve .* nodes=6 would do"):
        rod.Scene(body, nodes=2).statics().solve()
