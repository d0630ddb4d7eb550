"""Recordings of an arm as sensors would see them, and models of these and of a few real pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pisplit as ps
from pisplit import BilinearEDMDc, Dictionary, Episodes
from pisplit import observables as ob
from pisplit.models import rod
from pisplit.models.arm import TendonArm, fit_simulated, simulated_recordings

QUIET = {"workers": 1, "progress": False}
NOISE = {"m": 1e-3, "m/s": 5e-3}


@pytest.fixture(scope="module")
def arm() -> TendonArm:
    """As it is thought to be."""
    return ps.TendonArm(length=0.45, radius=0.7e-3, material="steel", offset=0.01, angles_deg=(0, 120, 240), nodes=3)


@pytest.fixture(scope="module")
def twin(arm: TendonArm, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Episodes]:
    file = tmp_path_factory.mktemp("twin") / "twin.h5"
    return file, simulated_recordings(arm, 8, 60, stations=3, noise=NOISE, noise_angle=0.01, path=file, **QUIET)


def test_sensors_add_what_they_are_told_to(arm: TendonArm, twin: tuple[Path, Episodes]) -> None:
    file, seen = twin
    moved, units = Episodes.load(file), np.array(seen.units)
    noise = seen.stacked_states() - moved.stacked_states()
    for unit, std in {**NOISE, "rad/s": 0.0}.items():
        free = noise[:, units == unit].std()
        assert free == pytest.approx(std, rel=0.1)
    frames = seen.stacked_states().reshape(-1, 3, 24)[..., 3:12].reshape(-1, 3, 3)
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    again = simulated_recordings(arm, 6, 60, stations=3, noise=NOISE, noise_angle=0.01, path=file, **QUIET)
    np.testing.assert_array_equal(again.xs[5], seen.xs[5])  # the file is read, noise is drawn alike
    with pytest.raises(ValueError, match="seed"):
        simulated_recordings(arm, 6, 60, stations=3, seed=1, path=file, **QUIET)


def test_a_few_pairs_and_a_twin_predict_better_than_either(arm: TendonArm, twin: tuple[Path, Episodes]) -> None:
    """The real arm is 10 % stiffer; 16 of its pairs alone say next to nothing of 72 fields."""
    material = arm.scene.rod.material
    assert isinstance(material, rod.Elastic)
    stiff = replace(material, young=1.1 * material.young, shear=1.1 * material.shear)
    scene = rod.Scene(replace(arm.scene.rod, material=stiff), *arm.scene.terms, nodes=arm.scene.nodes)
    stiffer = replace(arm, scene=scene)
    real = simulated_recordings(stiffer, 6, 60, stations=3, noise=NOISE, noise_angle=0.01, seed=3, **QUIET)
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Bilinear(), n_states=72, n_inputs=3)
    pairs = real[:4].pairs(0).sample(16, 0)
    found = fit_simulated(theta, real[:4], twin[1], pairs)
    assert found.alpha_ == pytest.approx(8 * 60 / (8.0 * 16))
    alone = BilinearEDMDc(theta, "cv", penalty="ridge").fit(real[:4], pairs)
    errors = [ps.horizon_errors(model, real[4:], [16], "shape").normalised[0] for model in (found, alone)]
    assert errors[0] < 0.5 * errors[1]
    with pytest.raises(ValueError, match="weight"):
        fit_simulated(theta, real, twin[1], weight=0.0)
