"""Scenes are told apart by their equations: by every number in them, and by nothing else."""

from __future__ import annotations

import functools
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.blocks import run_blocks
from pisplit.models.arm.phase_samples import make_phase_samples, phase_origin
from pisplit.models.arm.recording import EpisodeTask, check_origin, episodes_origin, make_episodes
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.scene import fingerprint

STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
GRAVITY = rod.Gravity((-9.81, 0.0, 0.0))
LENGTH = 0.4


def body(**options: Any) -> rod.Rod:
    return rod.Rod(**{"length": LENGTH, "section": rod.Circle(1e-3), "material": STEEL, **options})


def routed(twist: float) -> rod.Scene:
    """Tendons on a route that is a closure."""
    route = lambda s: (0.01 * np.cos(twist * s), 0.01 * np.sin(twist * s))  # noqa: E731
    return rod.Scene(body(), GRAVITY, rod.Tendons([route], rod.Displacement(1e-4)), nodes=3)


class PlainDrag:
    """A user's term without equality and without a text that shows its number."""

    inputs = ()

    def __init__(self, coefficient: float) -> None:
        self.coefficient = coefficient

    def apply(self, motion: Any, loads: Any) -> None:
        loads.force -= self.coefficient * motion.velocity

    def describe(self, scene_rod: Any) -> str:
        return "drag"


@dataclass(frozen=True)
class ManyNumbers:
    """Its repr leaves most of its numbers out."""

    force: Any
    inputs = ()

    def apply(self, motion: Any, loads: Any) -> None:
        loads.tip_force += ca.SX(ca.DM([0.0, 0.0, float(np.sum(self.force * np.cos(np.arange(len(self.force)))))]))

    def describe(self, scene_rod: Any) -> str:
        return "many numbers"


def many(last: float) -> rod.Scene:
    numbers = np.zeros(5000)
    numbers[2500] = last
    assert repr(numbers) == repr(np.zeros(5000))
    return rod.Scene(body(), ManyNumbers(numbers), nodes=3)


def plain(*terms: Any, **options: Any) -> rod.Scene:
    return rod.Scene(body(**options), GRAVITY, *terms, nodes=3)


def torsion_free(shear: float) -> rod.Scene:
    """Shear stiffness of a rod that does not shear: in the fields v alone."""
    i = rod.Circle(1e-3).second_moments
    material = rod.Stiffness((207e9 * i[0], 207e9 * i[1]), 8e10 * i[2], (shear, shear), 6e5, 8000.0)
    return plain(material=material)


PAIRS: dict[str, Callable[[], tuple[rod.Scene, rod.Scene]]] = {
    "closures": lambda: (routed(0.0), routed(3.0)),
    "plain classes": lambda: (plain(PlainDrag(1e-3)), plain(PlainDrag(2e-3))),
    "long arrays": lambda: (many(1.0), many(2.0)),
    "partial": lambda: (
        plain(rod.DistributedWrench(force=functools.partial(lambda k, s: (k * s, 0.0, 0.0), 1.0))),
        plain(rod.DistributedWrench(force=functools.partial(lambda k, s: (k * s, 0.0, 0.0), 2.0))),
    ),
    "last digits": lambda: (plain(length=LENGTH), plain(length=LENGTH * (1.0 + 1e-12))),
    "signs": lambda: (
        plain(rod.TipWrench((0.0, 1e-3, 0.0))),
        plain(rod.TipWrench((0.0, -1e-3, 0.0))),
    ),
    "fields": lambda: (torsion_free(1e5), torsion_free(2e5)),
    "nodes": lambda: (plain(), plain().with_nodes(4)),
    "strains": lambda: (plain(), plain(strains="extensible")),
    "names of inputs": lambda: (
        plain(rod.TipWrench(rod.Input("f", 3))),
        plain(rod.TipWrench(rod.Input("g", 3))),
    ),
    "equations": lambda: (plain(), plain().variational()),
    "laws": lambda: (
        plain(rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4))),
        plain(rod.Tendons([[0.01, 0.0]], rod.Tension())),
    ),
    "smoothing of slack": lambda: (
        plain(rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4))),
        plain(rod.Tendons([[0.01, 0.0]], rod.Displacement(1e-4, slack_smoothing=0.11))),
    ),
}


@pytest.mark.parametrize("kind", PAIRS)
def test_scenes_with_other_equations_have_another_fingerprint(kind: str) -> None:
    one, other = PAIRS[kind]()
    again, _ = PAIRS[kind]()
    assert fingerprint(one) == fingerprint(again)
    assert fingerprint(one) != fingerprint(other)
    assert one == again
    assert hash(one) == hash(again)
    assert one != other


def test_inputs_of_another_size_are_another_scene() -> None:
    class Push(PlainDrag):
        def __init__(self, size: int) -> None:
            self.inputs = (rod.Input("push", size),)  # type: ignore[assignment]

        def apply(self, motion: Any, loads: Any) -> None:
            loads.tip_force += ca.vertcat(loads.inputs["push"][0], 0, 0)

    assert fingerprint(plain(Push(1))) != fingerprint(plain(Push(2)))


def test_other_stations_are_other_data() -> None:
    scene = plain()
    assert scene.fingerprint(6) != scene.fingerprint(7)
    assert scene.fingerprint(2) == scene.fingerprint([0.5 * LENGTH, LENGTH])


def test_a_fingerprint_survives_pickling_and_other_processes() -> None:
    scene = plain(rod.Tendons.helical(0.01, 0.3, (0, 90), rod.Displacement(1e-4), friction=0.1))
    assert pickle.loads(pickle.dumps(scene)).fingerprint() == scene.fingerprint()
    ca.SX.sym("x", 100)  # other symbols of this process do not count
    code = "import sys, pickle; scene = pickle.load(sys.stdin.buffer); print(scene.fingerprint())"
    done = subprocess.run([sys.executable, "-c", code], input=pickle.dumps(scene), capture_output=True, check=True)
    assert done.stdout.decode().strip() == scene.fingerprint()


def test_what_casadi_cannot_look_into_is_refused_in_one_line() -> None:
    class Twice(ca.Callback):  # type: ignore[misc]
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.construct("twice", {})

        def eval(self, given: Any) -> Any:
            return [2.0 * given[0]]

    twice = Twice()

    class Hidden(PlainDrag):
        def apply(self, motion: Any, loads: Any) -> None:
            loads.tip_force += ca.vertcat(twice(motion.tip[0]), 0, 0)

    scene, same = plain(Hidden(1.0)), plain(Hidden(1.0))
    with pytest.raises(ValueError, match="cannot look into") as error:
        scene.fingerprint()
    assert "\n" not in str(error.value)
    assert scene == scene and scene != same  # nobody can tell


def test_a_scene_with_arrays_in_its_terms_can_be_compared_hashed_and_taken_apart() -> None:
    scene = many(1.0)
    assert len({scene, many(1.0), many(2.0)}) == 2
    term = scene.terms[0]
    assert (scene + GRAVITY - term).terms == (GRAVITY,)
    with pytest.raises(ValueError, match="does not contain"):
        _ = scene - ManyNumbers(np.zeros(3))


# Data ----------------------------------------------------------------------------------------------------------------


def dragged(coefficient: float) -> TendonArm:
    arm = TendonArm.paper(nodes=3)
    return replace(arm, scene=arm.scene + PlainDrag(coefficient))


def test_data_of_another_arm_are_refused(tmp_path: Path) -> None:
    mine, other = dragged(1e-3), dragged(10.0)
    small: dict[str, Any] = {"stations": 3, "workers": 1, "progress": False}
    episodes = make_episodes(mine, tmp_path / "d1.h5", 1, 4, **small)
    check_origin("d1.h5", episodes.provenance, episodes_origin(dragged(1e-3), 4, stations=3))
    with pytest.raises(ValueError, match="made for another arm"):
        check_origin("d1.h5", episodes.provenance, episodes_origin(other, 4, stations=3))
    parts = tmp_path / "parts"
    for arm, refused in ((mine, False), (dragged(1e-3), False), (other, True)):
        task = EpisodeTask(arm, 4, 0.03, 1e-4, 3, 0)
        if refused:
            with pytest.raises(ValueError, match="other settings"):
                run_blocks(task, 1, parts, episodes_origin(arm, 4, stations=3), 1, progress=False)
        else:
            run_blocks(task, 1, parts, episodes_origin(arm, 4, stations=3), 1, progress=False)


def test_phase_samples_of_another_known_part_are_refused(tmp_path: Path) -> None:
    arm = TendonArm.paper(nodes=3)
    rates = np.random.default_rng(0).normal(size=(20, arm.scene.n_strains))
    light = arm.passive.without(rod.QuadraticDrag)
    d2 = make_phase_samples(arm, tmp_path / "d2.h5", 4, rates, stations=3, workers=1, progress=False, known=light)
    check_origin("d2.h5", d2.provenance, phase_origin(arm, rates, stations=3, known=light))
    for change in ({}, {"known": light, "dt": 0.03}, {"known": light, "deviations": rates}, {"known": arm.passive}):
        with pytest.raises(ValueError, match="holds data made"):
            check_origin("d2.h5", d2.provenance, phase_origin(arm, rates, stations=3, **change))
    with pytest.raises(ValueError, match="known has 9 strains and 3 inputs"):
        phase_origin(arm, rates, known=arm.scene)
