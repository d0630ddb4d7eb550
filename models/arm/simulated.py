"""Recordings of an arm as its sensors would see them, and a model of these and of a few real pairs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pisplit import Dictionary, Episodes, TwinEDMDc
from pisplit.checks import Array, check_same_step, count, non_negative, positive
from pisplit.data.actuator import Actuator, checked_actuator
from pisplit.data.episodes import Pairs
from pisplit.models.arm.base import Arm
from pisplit.models.arm.recording import check_origin, episodes_origin, make_episodes
from pisplit.models.arm.resting import turned
from pisplit.models.arm.twin import OMIT
from pisplit.models.rod.analysis.fields import N_FIELDS

#: How many simulated pairs a recorded one stands for.
WEIGHT = 8.0
#: Ridge of the regression, in parts of the mean variance of the columns.
RIDGE = 1e-5


def simulated_recordings(
    arm: Arm,
    episodes: int = 24,
    steps: int = 200,
    dt: float = 0.03,
    stations: int = 6,
    noise: Mapping[str, float] | None = None,
    noise_angle: float = 0.0,
    seed: int = 7919,
    path: str | os.PathLike[str] | None = None,
    workers: int = -1,
    progress: bool = True,
    actuator: Actuator | None = None,
) -> Episodes:
    """Recordings of an ``arm``, drawn or calibrated, from rest under random smooth commands, seen with noise.

    Inputs are positions of the tendons, what its servos make of the commands: a model of an arm that rubs has to be
    learned from moves as smooth as those that it predicts. Bilinear models of noise-free recordings trust digits that
    no sensor reads, and predict badly from what is measured.

    Args:
        arm: what moves.
        episodes, steps, dt, stations: number of recordings, steps of each, step in s, measured points.
        noise: standard deviations of measured states by unit, {"m": 1e-3, "m/s": ...}; none if not given.
        noise_angle: standard deviation in rad of measured frames.
        seed: of displacements and noise.
        path: of an HDF5 file that keeps the recordings, without noise, for the next call.
        workers: processes, -1 for one a core.
        progress: whether to show a bar.
        actuator: servos between commands and tendons; none if not given.

    Raises RuntimeError where the arm cannot be simulated, and ValueError for negative noise and for a file of another
    arm or with other settings.
    """
    servo = Actuator() if actuator is None else checked_actuator(actuator)
    told: dict[str, Any] = {"stations": stations, "seed": seed, "actuator": servo}
    if path is not None and Path(path).exists():
        found = Episodes.load(path)
        check_origin(path, found.provenance, episodes_origin(arm, steps, dt, **told))
    if path is None or not Path(path).exists() or len(found) < episodes:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "simulated.h5" if path is None else path
            found = make_episodes(arm, file, episodes, steps, dt, **told, workers=workers, progress=progress)
    found = found[:episodes].through(servo, arm.rest_inputs)
    rng = np.random.default_rng(np.random.SeedSequence(count(seed, "seed", 0), spawn_key=(21,)))
    units = np.array(found.units)
    seen = [seen_with_noise(x, units, noise or {}, noise_angle, rng) for x in found.xs]
    passed = {**(found.provenance or {}), "noise": dict(noise or {}), "noise_angle": noise_angle}
    return replace(found, xs=seen, extra=None, provenance=passed)


def seen_with_noise(
    x: Array, units: NDArray[np.str_], noise: Mapping[str, float], noise_angle: float, rng: np.random.Generator
) -> Array:
    """Fields ``x`` (T, n) of these ``units`` (n,) with noise; frames are turned, so that they stay rotations.

    ``noise`` and ``noise_angle`` as in :func:`simulated_recordings`; ``rng`` draws.

    Raises ValueError for negative noise.
    """
    std = np.array([non_negative(noise.get(unit, 0.0), f"noise of {unit!r}") for unit in units])
    y = x + std * rng.standard_normal(x.shape)
    fields = y.reshape(len(y), -1, N_FIELDS)  # a view
    if noise_angle > 0.0:
        fields[..., 3:12] = turned(fields[..., 3:12], noise_angle, rng)
    return y


def fit_simulated(
    theta: Dictionary, d1: Episodes, twin: Episodes, pairs: Pairs | None = None, weight: float = WEIGHT
) -> TwinEDMDc:
    """A model of simulated recordings and of a few real pairs, to control the arm that these are from.

    It is :class:`pisplit.TwinEDMDc` with the weight of pooled pairs, for few of them cannot choose one.

    Args:
        theta: dictionary; with ``Bilinear`` the model is bilinear.
        d1: recordings of the arm; of positions behind its servos where it has any (``d1.through(actuator)``).
        twin: :func:`simulated_recordings` with the noise of the sensors.
        pairs: pairs of ``d1`` with the delays of the dictionary; all if not given.
        weight: how many simulated pairs a recorded one stands for.

    Raises ValueError for columns or time steps that differ.
    """
    check_same_step(twin.dt, d1.dt, "the twin has", "d1")
    recorded = d1.pairs(theta.n_delays) if pairs is None else pairs
    alpha = len(twin.pairs(theta.n_delays)) / (positive(weight, "weight") * len(recorded))
    return TwinEDMDc(theta, alpha, RIDGE, omit=OMIT).fit(d1, twin, recorded, excitation=None)
