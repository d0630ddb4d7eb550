"""What acts on nothing: zero leaves nothing in the equations, and what cannot act where it is is said."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.rod import NoEffect

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
LENGTH = 0.4
GRAVITY = rod.Gravity((-9.81, 0.0, 1.0))


def body(strains: str = "kirchhoff", **options: Any) -> rod.Rod:
    return rod.Rod(LENGTH, rod.Circle(1e-3), STEEL, strains, **options)


def counts(scene: rod.Scene) -> list[int]:
    """Instructions and entries of the residuals at rest and in motion."""
    xi, u, rest = scene.static_balance
    x, x_t, x_tt, v, moving = scene.dynamic_balance
    functions = [
        ca.Function("rest", [xi, u], [rest.residual], {"cse": True}),
        ca.Function("motion", [x, x_t, x_tt, v], [moving.residual], {"cse": True}),
    ]
    sizes = [int(f.n_instructions()) for f in functions]
    return [*sizes, *(int(p.nnz()) for p in (moving.loads.force, moving.loads.stress_w, moving.loads.tip_force))]


ZEROS: dict[str, Callable[[float], Any]] = {
    "gravity": lambda k: rod.Gravity((k, 0.0, k)),
    "buoyancy": rod.Buoyancy,
    "linear drag": rod.LinearDrag,
    "quadratic drag": rod.QuadraticDrag,
    "anisotropic drag": lambda k: rod.AnisotropicDrag(k, k, k, k),
    "damping": lambda k: rod.KelvinVoigt(k, k, k, k),
    "retardation": rod.Retardation,
    "tip wrench": lambda k: rod.TipWrench((k, 0.0, k), (0.0, k, 0.0)),
    "follower": lambda k: rod.TipWrench((k, 0.0, k), (0.0, k, 0.0), follower=True),
    "point wrench": lambda k: rod.PointWrench(0.2, (k, 0.0, k), (0.0, k, 0.0), follower=True),
    "distributed": lambda k: rod.DistributedWrench((k, 0.0, k), (0.0, k, 0.0), follower=True),
    "function": lambda k: rod.DistributedWrench(lambda s: (k * s, 0.0, 0.0)),
    "spring": lambda k: rod.Spring((0.1, 0.0, 0.3), k, rest_length=0.1),
    "mass": lambda k: rod.PointMass(0.2, k, offset=(0.01, 0.0, 0.0)),
    "inertia": lambda k: rod.PointMass(0.2, 0.0, inertia=(k, k, k)),
    "disc": lambda k: rod.PointMass.disc(LENGTH, k, radius=k, thickness=k),
    "base": lambda k: rod.Base((k, 0.0, k), velocity=(k, 0.0, 0.0), spin_rate=(0.0, k, 0.0)),
}


@pytest.mark.parametrize("strains", ["kirchhoff", "cosserat", "planar"])
@pytest.mark.parametrize("kind", ZEROS)
def test_a_sweep_to_zero_ends_in_the_scene_without_the_term(kind: str, strains: str) -> None:
    plain = rod.Scene(body(strains), GRAVITY, nodes=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        without = plain + ZEROS[kind](0.0)
        assert counts(without) == counts(plain)
        assert without.fingerprint(2) == plain.fingerprint(2)
    if kind != "base":  # a resting base of another place is no load
        warnings.simplefilter("ignore", NoEffect)
        assert (plain + ZEROS[kind](1e-3)).fingerprint(2) != plain.fingerprint(2)


@pytest.mark.parametrize("kind", ["damping", "anisotropic drag"])
def test_a_part_that_is_zero_leaves_no_node_either(kind: str) -> None:
    plain = rod.Scene(body("cosserat"), nodes=2)
    part = {"damping": rod.KelvinVoigt(stretch=1.0), "anisotropic drag": rod.AnisotropicDrag(tangential=1.0)}[kind]
    assert sum(counts(plain + part)) < sum(counts(plain + ZEROS[kind](1.0)))


def said(build: Callable[[], rod.Scene], text: str) -> rod.Scene:
    with pytest.warns(NoEffect, match=text):
        scene = build()
    assert any(text in note for note in scene.notes)
    assert text in str(scene)
    return scene


FLAT = body("planar")
IDLE: dict[str, tuple[rod.Rod, Any]] = {
    "without gravity": (body(), rod.Buoyancy(1000.0)),
    "torsion: no effect": (FLAT, rod.KelvinVoigt(bending=1e-4, torsion=1e-4)),
    "shear and stretch: no effect": (body(), rod.KelvinVoigt(bending=1e-4, shear=1.0, stretch=1.0)),
    "Gravity is across the plane": (FLAT, rod.Gravity((0.0, 9.81, 0.0))),
    "TipWrench is across the plane": (FLAT, rod.TipWrench((0.0, 1.0, 0.0), (1.0, 0.0, 1.0))),
    "PointWrench is across the plane": (FLAT, rod.PointWrench(0.2, (0.0, 1.0, 0.0))),
    "DistributedWrench is across the plane": (FLAT, rod.DistributedWrench(moment=(1.0, 0.0, 0.0))),
    "Tendons on the axis": (body(), rod.Tendons([[0.0, 0.0], [0.01, 0.0]])),
    "Chambers on the axis": (body(), rod.Chambers(1e-6, [[0.0, 0.0]])),
}


@pytest.mark.parametrize("text", IDLE)
def test_what_cannot_act_is_said_and_changes_nothing(text: str) -> None:
    backbone, term = IDLE[text]
    scene = said(lambda: rod.Scene(backbone, term, nodes=2), text)
    said(lambda: rod.Scene(backbone, nodes=2) + term, text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert (scene + rod.LinearDrag(1.0)).notes == scene.notes  # said once
        assert (scene - term).notes == ()


@pytest.mark.parametrize(
    "terms",
    [
        (rod.Buoyancy(1000.0), GRAVITY),
        (GRAVITY, rod.KelvinVoigt(bending=1e-4), rod.Retardation(1e-3)),
        (rod.Gravity((1.0, 9.81, 0.0)), rod.TipWrench((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))),
        (rod.Gravity((0.0, 9.81, 0.0)), rod.Base(rotation=(0.0, 0.0, np.pi / 2.0))),
        (rod.TipWrench(rod.Input("f", 3)), rod.Tendons([[0.01, 0.0]], end=LENGTH)),
    ],
)
def test_what_acts_is_not_remarked_upon(terms: tuple[Any, ...]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert rod.Scene(FLAT, *terms).notes == ()


def test_an_input_that_no_term_reads_is_said() -> None:
    class Deaf:
        inputs = (rod.Input("volume", 2),)

        def apply(self, motion: Any, loads: Any) -> None:
            """Reads nothing."""

        def describe(self, scene_rod: Any) -> str:
            return "deaf"

    with pytest.warns(NoEffect, match="input 'volume' acts on nothing"):
        _ = rod.Scene(body(), Deaf(), nodes=2).dynamic_balance
    with pytest.warns(NoEffect, match="input 'pressures' acts on nothing"):
        _ = rod.Scene(body(), rod.Chambers(1e-6, [[0.0, 0.0]]), nodes=2).dynamic_balance


def test_of_two_equal_terms_one_is_taken() -> None:
    mass = rod.PointMass(0.25, 1e-3)
    scene = rod.Scene(body(), mass, GRAVITY, mass, nodes=2)
    assert (scene - mass).terms == (mass, GRAVITY)
    assert (scene - mass - mass).terms == (GRAVITY,)
    assert scene + mass - mass == scene
    assert scene.cost().rod == rod.Scene(body(), nodes=2).cost().total


def test_without_takes_types() -> None:
    with pytest.raises(ValueError, match=r"no type of terms; give one such as rod\.Gravity"):
        rod.Scene(body(), GRAVITY).without(GRAVITY)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="Scene term"):
        rod.Scene(body(), rod.Gravity)  # type: ignore[arg-type]


# Inputs --------------------------------------------------------------------------------------------------------------


def test_tendons_do_not_push() -> None:
    scene = rod.Scene(body(), rod.TipWrench(rod.Input("f", 3)), rod.Tendons.parallel(0.01, (0, 180), rod.Tension()))
    for call in (
        lambda: scene.statics().solve([0.0, 0.0, 0.0, 1.0, -2.0]),
        lambda: scene.statics().solve_many([[0.0, 0.0, 0.0, 1.0, -2.0]]),
        lambda: scene.simulator(0.03).run([[0.0, 0.0, 0.0, 1.0, -2.0]], check=False),
    ):
        with pytest.raises(ValueError, match="pushes a tendon with 2 N; tendons only pull") as error:
            call()
        assert "\n" not in str(error.value)
    assert scene.statics().solve([-1e-3, 0.0, 0.0, 3.0, -1e-9]).success  # rounding of an optimiser
    low, high = scene.input_limits
    assert low.tolist() == [-np.inf] * 3 + [0.0, 0.0] and np.all(high == np.inf)


def test_inverse_statics_keeps_to_tensions_that_pull() -> None:
    scene = rod.Scene(body(), rod.Tendons.parallel(0.01, (0, 120, 240), rod.Tension()), nodes=3)
    wanted = scene.statics().solve([2.0, 0.5, 0.0]).tip
    found = scene.inverse([wanted[0], wanted[1], np.nan])
    assert found.success and found.u.min() >= 0.0


@pytest.mark.parametrize(
    ("term", "part"),
    [
        (rod.Tendons([rod.Line((0.01, 0.0), (0.005, 0.0), 0.3)]), "run to s = 0.4 m on a Line of length 0.3 m"),
        (rod.Tendons.converging(0.01, 0.005, 0.3, (0,), rod.Tension()), "Line of length 0.3 m"),
        (rod.Tendons.parallel(15.0, (0, 90), rod.Tension()), "offset 15 m on a rod of 0.4 m"),
        (rod.Tendons([lambda s: (15.0, 0.0)]), "offset 15 m"),
        (rod.Chambers(1e-6, [[8.0, 0.0]]), "offset 8 m"),
        (rod.PointWrench(0.41, (1.0, 0.0, 0.0)), "0.41"),
        (rod.Spring((0.0, 0.0, 0.0), 0.0, s=0.41), "0.41"),
    ],
)
def test_what_leaves_the_rod_is_refused_in_one_line(term: Any, part: str) -> None:
    with pytest.raises(ValueError, match=part) as error:
        rod.Scene(body(), term)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "added", "part"),
    [
        ("tip_force", ca.SX([0.0, np.nan, 0.0]), "loads.tip_force NaN or infinite"),
        ("force", ca.SX.ones(3, 3), "does not fit the loads"),
        ("tip_moment", ca.SX.ones(2), "does not fit the loads"),
    ],
)
def test_what_a_users_term_adds_is_checked(name: str, added: ca.SX, part: str) -> None:
    class Own:
        inputs = ()

        def apply(self, motion: Any, loads: Any) -> None:
            setattr(loads, name, getattr(loads, name) + added)

        def describe(self, scene_rod: Any) -> str:
            return "own"

    with pytest.raises(ValueError, match=part) as error:
        _ = rod.Scene(body(), Own()).static_balance[-1].residual
    assert "\n" not in str(error.value) and "Own.apply" in str(error.value)


def test_a_line_may_go_on_beyond_the_tendon() -> None:
    backbone = body(elements=(0.2, 0.2))
    rod.Scene(backbone, rod.Tendons([rod.Line((0.01, 0.0), (0.005, 0.0), 0.2)], end=0.2))
    rod.Scene(backbone, rod.Tendons([rod.Line((0.01, 0.0), (0.005, 0.0), 1.0)]))
