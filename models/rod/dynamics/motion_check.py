"""Motions are checked: on request on a finer grid in space and time, the first ones of a scene in time alone."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pisplit.models.rod.dynamics.extent import Checked, Extent
from pisplit.models.rod.dynamics.motion_error import MotionError, motion_error
from pisplit.models.rod.dynamics.trajectory import Trajectory

if TYPE_CHECKING:
    from pisplit.models.rod.dynamics.propagation import Propagation

#: Error of a motion, in parts of its travel, that is told of, and the least one in parts of L.
ALLOWED, LEAST = 1e-3, 1e-7
#: By how much smaller the errors in time are of the motion by which one is checked without being asked, and what part
#: of its error the distance of both shows at least (errors fall with the tolerance to the power 2/3 or faster).
SHARPER = 0.2
SEEN = 1.0 - SHARPER ** (2.0 / 3.0)


def is_new(plant: Propagation, found: Trajectory) -> bool:
    """Whether no motion like ``found`` of ``plant`` was checked before, on its scene with its setting."""
    scene = plant.equations
    known: dict[tuple[object, ...], Checked] = scene.__dict__.setdefault("_checked_motions", {})
    rates = np.tile([scene.rod.natural_rates[c] for c in scene.rod.strain_set.free], scene.nodes)
    nominal = np.concatenate([scene.nominal_strains, scene.nominal_strains * rates])
    return known.setdefault(plant.setting, Checked()).is_new(Extent.of(found, nominal))


def checked_in_time(plant: Propagation, found: Trajectory) -> str:
    """What is wrong with the motion ``found`` of ``plant`` in time, empty where nothing is.

    The same commands once more with smaller steps on the same nodes, as far as ``plant.checked_steps`` internal steps
    went; where that takes more than one call it is given up.
    """
    steps = int(np.ceil(len(found.u) * min(1.0, plant.checked_steps / max(1, found.stats["nsteps"]))))
    part = replace(found, t=found.t[: steps + 1], x=found.x[: steps + 1], u=found.u[:steps])
    try:
        states, _ = plant.sharper.integrate(part.x[0], part.u)
    except RuntimeError as failure:
        return f"the motion cannot be checked: {plant.scheme} gives up with smaller steps: {reason(failure)}"
    error = motion_error(part, replace(part, x=np.vstack([part.x[0], np.hstack([states, part.u])])))
    return told(plant, replace(error, distance=error.distance / SEEN), plant.remedy)


def checked(plant: Propagation, found: Trajectory) -> tuple[MotionError | None, str]:
    """Error of the motion ``found`` of ``plant`` beside that on a finer grid, and what is wrong with it."""
    if not len(found.u):
        return None, "the motion cannot be checked: it has no steps"
    finer = plant.finer.run(found.u, plant.resolution.on_finer(found.x[0]), check=False)
    if not finer.success:
        return None, f"the motion cannot be checked: the finer motion ends: {finer.message}"
    error = motion_error(found, finer)
    return error, told(plant, error, f"{plant.remedy}, or more nodes than {plant.scene.nodes}")


def told(plant: Propagation, error: MotionError, remedy: str) -> str:
    """What to say of an error of a motion of ``plant``, empty where it is small; ``remedy`` is what to do."""
    step = error.first_above(ALLOWED, LEAST * plant.scene.rod.length)
    if step is None:
        return ""
    return (
        f"the motion is off by {error.of_travel:.1g} of its travel, by more than {ALLOWED:g} from step {step} "
        f"(t = {step * plant.dt:g} s) on; {remedy}"
    )


def reason(error: Exception) -> str:
    """The part of CasADi's message in ``error`` that names the failure."""
    text = str(error)
    start = text.find("returned")
    return text[start:].split(".")[0] if start >= 0 else text.strip().splitlines()[-1]
