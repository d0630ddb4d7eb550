"""Data at the paper's scale: 700 + 50 episodes of 200 steps and 140,000 static phase-space samples, by input law."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array
from pisplit.models import rod
from pisplit.models.generation import (
    check_origin,
    episodes_origin,
    make_episodes,
    make_phase_samples,
    phase_origin,
    strain_rates,
)
from pisplit.models.tendon_arm import TendonArm

DT = 0.03


@dataclass(frozen=True)
class Scale:
    """How much data: training and test episodes of ``steps`` steps, phase-space samples, and how many with a flow."""

    training: int = 700
    test: int = 50
    steps: int = 200
    samples: int = 140_000
    flow_samples: int = 4_000

    def __str__(self) -> str:
        return f"{self.training}+{self.test}x{self.steps}"


@dataclass(frozen=True)
class PaperData:
    """Data of one input law. The test episodes are the last ones simulated; no choice may look at them.

    d2 holds f at static shapes with Gaussian velocities; d2_flow fewer of them, with the flow of f over half a step.
    """

    law: str
    training: Episodes
    test: Episodes
    d2: PhaseSamples
    d2_flow: PhaseSamples


def load_or_make(
    arm: TendonArm, law: str, folder: Path, scale: Scale, seed: int = 0, workers: int = -1, progress: bool = True
) -> PaperData:
    """The data from ``folder`` where they are there, else simulated and stored there; killed runs continue."""
    episodes = _episodes(arm, law, folder, scale, seed, workers, progress)
    training = episodes[: scale.training]
    samples = {
        kind: _samples(arm, law, folder, scale, seed, workers, progress, training, count, dt)
        for kind, count, dt in (("d2", scale.samples, None), ("d2_flow", scale.flow_samples, DT))
    }
    return PaperData(law, training, episodes[scale.training :], **samples)


def variant_samples(
    arm: TendonArm, data: PaperData, folder: Path, name: str, known: rod.Scene, count: int, seed: int, workers: int = -1
) -> PhaseSamples:
    """Phase-space samples of another known part, with the velocities and the input law of ``data``."""
    path = folder / f"d2-{data.law}-{name}-{count}-seed{seed}.h5"
    rates = strain_rates(arm, data.training)
    if path.exists():
        return _checked(arm, path, PhaseSamples.load(path), rates, seed, data.law)
    return make_phase_samples(
        arm, path, count, rates, seed=seed, workers=workers, law=data.law, known=known, progress=False
    )


def _episodes(
    arm: TendonArm, law: str, folder: Path, scale: Scale, seed: int, workers: int, progress: bool
) -> Episodes:
    path = folder / f"d1-{law}-{scale}-seed{seed}.h5"
    if path.exists():
        found = Episodes.load(path)
        check_origin(path, found.provenance, episodes_origin(arm, scale.steps, DT, seed=seed, law=law))
        return found
    count = scale.training + scale.test
    return make_episodes(arm, path, count, scale.steps, DT, seed=seed, workers=workers, progress=progress, law=law)


def _samples(
    arm: TendonArm,
    law: str,
    folder: Path,
    scale: Scale,
    seed: int,
    workers: int,
    progress: bool,
    training: Episodes,
    count: int,
    dt: float | None,
) -> PhaseSamples:
    path = folder / f"d2-{law}-{scale}-{count}{'-flow' if dt else ''}-seed{seed}.h5"
    rates = strain_rates(arm, training)
    if path.exists():
        return _checked(arm, path, PhaseSamples.load(path), rates, seed, law)
    return make_phase_samples(arm, path, count, rates, seed=seed, workers=workers, progress=progress, law=law, dt=dt)


def _checked(arm: TendonArm, path: Path, found: PhaseSamples, rates: Array, seed: int, law: str) -> PhaseSamples:
    check_origin(path, found.provenance, phase_origin(arm, rates, seed=seed, law=law))
    return found
