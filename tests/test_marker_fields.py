"""All fields of an arm from recordings of a few markers: as good as its equations, refused where these are not its."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pisplit import Episodes, identify
from pisplit.models.arm import MotionCapture, TendonArm, fields_from_markers
from pisplit.models.arm.marker_sight import MarkerSight

NOISE = 3e-4
pytestmark = pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    return TendonArm.paper(nodes=3)


@pytest.fixture(scope="module")
def capture() -> MotionCapture:
    return MotionCapture((0.3, 0.7, 1.0), NOISE, stations_in="L")


@pytest.fixture(scope="module")
def motions(arm: TendonArm) -> Episodes:
    return arm.record(2, seed=3, steps=50, workers=1, progress=False)


@pytest.fixture(scope="module")
def seen(arm: TendonArm, motions: Episodes, capture: MotionCapture) -> Episodes:
    """What the markers see of ``motions``, with noise."""
    sight, n, rng = MarkerSight(arm.scene, capture), arm.scene.n_strains, np.random.default_rng(0)
    xs = [np.stack([sight.look(row[: 2 * n])[0] for row in rows]) for rows in (motions.extra or {})["state"]]
    noisy = [x + NOISE * rng.standard_normal(x.shape) for x in xs]
    return Episodes(noisy, motions.us, motions.dt, state_names=capture.names, units=["m"] * capture.n_columns)


@pytest.fixture(scope="module")
def found(arm: TendonArm, seen: Episodes, capture: MotionCapture) -> Episodes:
    return fields_from_markers(arm, seen, capture)


def test_positions_are_better_than_those_of_the_markers_and_bends_and_velocities_follow(
    arm: TendonArm, motions: Episodes, found: Episodes
) -> None:
    assert found.state_names == motions.state_names and found.outputs == motions.outputs

    def off(quantity: str) -> tuple[float, float]:
        at = [i for i, q in enumerate(motions.quantities or ()) if q == quantity]
        miss = np.concatenate([a[:, at] - b[:, at] for a, b in zip(found.xs, motions.xs, strict=True)])
        return float(np.sqrt((miss**2).mean())), float(np.concatenate(motions.xs)[:, at].std())

    assert off("p")[0] < 0.5 * NOISE
    for quantity in ("R", "w", "q"):
        miss, spread = off(quantity)
        assert miss < 0.02 * spread, quantity
    assert (found.provenance or {})["markers"]["residual"] == pytest.approx(1.0, abs=0.1)


def test_markers_that_the_arm_does_not_explain_and_poses_that_nobody_knows_are_refused(
    seen: Episodes, capture: MotionCapture, arm: TendonArm
) -> None:
    with pytest.raises(ValueError, match="the pose of the base is unknown"):
        fields_from_markers(arm, seen, replace(capture, pose="estimated"))
    with pytest.raises(ValueError, match=r"misses the markers by \d"):
        fields_from_markers(arm, seen[:1], replace(capture, noise=0.1 * NOISE))
    with pytest.raises(ValueError, match="give arm="):
        identify(seen, capture=capture)


def test_the_front_takes_markers(arm: TendonArm, seen: Episodes, capture: MotionCapture) -> None:
    """All fields are learned, and the physics of the rod is at hand."""
    model = identify(seen, arm=arm, capture=capture, candidates=["L-EDMDc"], progress=False)
    assert model.lifted.n_states == 144 and not model.case.no_rod()
