"""Damping from a free decay: the ratio of the drawing."""

import numpy as np
import pytest

from pisplit import Episodes
from pisplit.models import rod
from pisplit.models.arm import MotionCapture, TendonArm
from pisplit.models.arm.marker_sight import MarkerSight
from pisplit.models.calibration import calibrate_damping

DT, NOISE, RATIO = 0.02, 2e-4, 0.03
pytestmark = pytest.mark.filterwarnings("ignore::pisplit.models.rod.Unresolved")


def drawn(ratio: float) -> TendonArm:
    words = {"length": 0.4, "radius": 0.7e-3, "offset": 0.01, "tip_mass": 0.012, "nodes": 3}
    return TendonArm(material="nitinol", damping_ratio=ratio, **words)  # type: ignore[arg-type]


def test_the_ratio_of_a_ring_down_is_that_of_the_drawing() -> None:
    """Small motion in the slowest mode decays by exp(-zeta omega t); the guess is three times too large."""
    arm, steps = drawn(RATIO), 80
    scene, rest = arm.scene, arm.rest_inputs
    start = scene.statics().solve(rest).state
    mode = scene.modes(start, 1)
    start[: scene.n_strains] += 0.03 * mode.strains[0].real
    u = np.tile(rest, (steps, 1))
    motion = scene.fast_stepper(DT).run(u, start, check=False)
    capture = MotionCapture((0.5, 1.0), NOISE, stations_in="L")
    sight = MarkerSight(scene, capture)
    y = np.stack([sight.look(x[: 2 * scene.n_strains])[0] for x in motion.x])
    seen = y + NOISE * np.random.default_rng(0).standard_normal(y.shape)
    recording = Episodes([seen], [u], DT, state_names=capture.names, units=["m"] * 6)
    found = calibrate_damping(drawn(3.0 * RATIO), recording, capture, windows=3, steps=16)
    true = sum(t.bending for t in arm.passive.terms if isinstance(t, rod.KelvinVoigt))
    assert abs(found.bending - true) < 3.0 * found.error < 0.3 * true
    assert found.ratio == pytest.approx(RATIO, abs=3.0 * RATIO * found.error / true)
    assert found.frequency == pytest.approx(float(mode.frequency[0]), rel=1e-3)
    (axis,) = found.plot().axes
    assert f"{found.frequency:.3g} Hz" in axis.get_legend().texts[1].get_text()
    with pytest.raises(ValueError, match=r"inputs move by 0\.001 m; a ring-down holds them"):
        moved = u + 1e-3 * (np.arange(steps) > 5)[:, None]
        calibrate_damping(arm, Episodes([seen], [moved], DT, state_names=capture.names), capture)
