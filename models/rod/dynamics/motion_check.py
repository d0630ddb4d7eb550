"""Motions are checked: on request by moving on a finer grid in space and time, the first ones of a scene by less."""

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
#: of its error the distance of both shows at least (errors fall with the tolerance to the power 2/3 or faster). Errors
#: in space are held to be seen in the same part.
SHARPER = 0.2
SEEN = 1.0 - SHARPER ** (2.0 / 3.0)
#: Commands at the start of a run over which it is checked in space.
LONGEST = 500


def is_new(plant: Propagation, found: Trajectory) -> bool:
    """Whether no motion like ``found`` of ``plant`` was checked before, on its scene with its setting."""
    scene = plant.equations
    known: dict[tuple[object, ...], Checked] = scene.__dict__.setdefault("_checked_motions", {})
    nominal = np.concatenate([scene.nominal_strains, scene.nominal_strains * scene.nominal_rates])
    return known.setdefault(plant.setting, Checked()).is_new(Extent.of(found, nominal))


def checked_first(plant: Propagation, found: Trajectory) -> tuple[MotionError | None, str]:
    """Estimated error of the motion ``found`` of ``plant``, and what is wrong with it, empty where nothing is.

    In time: the same commands once more with smaller steps on the same nodes, as far as ``plant.checked_steps``
    internal steps went; given up where that takes more than one call. In space: see ``SpaceError``, over 500 commands.
    It takes accelerations of waves for errors of the grid: what it finds too large is moved once more on the finer
    grid, with the smaller steps. Schemes that keep waves which they do not resolve are looked at as far as in time.
    The error is that of both together; None where it is not known over the whole motion.
    """
    steps = int(np.ceil(len(found.u) * min(1.0, plant.checked_steps / max(1, found.stats["nsteps"]))))
    part, more = _first(found, steps), f"give more nodes than {plant.scene.nodes}"
    long = _first(found, LONGEST) if plant.damps_waves else part
    in_space: MotionError | None = _grown(plant.space_error.of(long))
    wrong = ["" if in_space is None else told(plant, in_space, more)]
    try:
        states, _ = plant.sharper.integrate(part.x[0], part.u)
    except RuntimeError as failure:
        if not plant.damps_waves:
            wrong.clear()
        wrong.insert(0, f"the motion cannot be checked: {plant.scheme} gives up with smaller steps: {reason(failure)}")
        return None, "; ".join(w for w in wrong if w)
    sharp = replace(part, x=np.vstack([part.x[0], np.hstack([states, part.u])]))
    in_time = motion_error(part, sharp)
    if wrong[0] and len(part.t) == len(long.t):
        truly, why = _on_finer(plant, sharp)
        if truly is not None or not plant.damps_waves:
            in_space, wrong = truly, [why if truly is None else told(plant, truly, more)]
    wrong.insert(0, told(plant, _grown(in_time), plant.remedy))
    error = None
    if in_space is not None and len(part.t) == len(long.t) == len(found.t):
        distance, drift = in_space.distance + in_time.distance / SEEN, in_space.drift + in_time.drift / SEEN
        error = replace(in_space, distance=distance, drift=drift)
    return error, "; ".join(w for w in wrong if w)


def _on_finer(plant: Propagation, sharp: Trajectory) -> tuple[MotionError | None, str]:
    """Error in space of the motion ``sharp``, by the finer grid with steps as small, or None and why it has none."""
    try:
        finer = plant.finer.run(sharp.u, plant.resolution.on_finer(sharp.x[0]), check=False)
    except ValueError as failure:  # a tip that is held elsewhere there
        return None, f"the motion cannot be checked on more nodes: {failure}"
    if not finer.success:
        return None, f"the motion cannot be checked on more nodes: {finer.message}"
    return motion_error(sharp, finer), ""


def _first(found: Trajectory, steps: int) -> Trajectory:
    return replace(found, t=found.t[: steps + 1], x=found.x[: steps + 1], u=found.u[:steps])


def _grown(error: MotionError) -> MotionError:
    """An error of which the part ``SEEN`` is seen; what the start is off by is."""
    distance = error.distance[0] + (error.distance - error.distance[0]) / SEEN
    return replace(error, distance=distance, drift=error.drift / SEEN)


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
    far = f"{error.of_travel:.1g} of its travel" if error.of_travel < 1.0 else "as much as it travels"
    return (
        f"the motion is off by {far}, by more than {ALLOWED:g} from step {step} "
        f"(t = {step * plant.dt:g} s) on; {remedy}"
    )


def reason(error: Exception) -> str:
    """The part of CasADi's message in ``error`` that names the failure."""
    text = str(error)
    start = text.find("returned")
    return text[start:].split(".")[0] if start >= 0 else text.strip().splitlines()[-1]
