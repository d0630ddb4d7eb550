"""Data at the paper's scale: 700 + 50 episodes of 200 steps and 140,000 static phase-space samples, by input law."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pisplit import Episodes, PhaseSamples
from pisplit.checks import Array
from pisplit.models import rod
from pisplit.models.arm.phase_samples import make_phase_samples, phase_origin, strain_rates
from pisplit.models.arm.recording import check_origin, episodes_origin, make_episodes
from pisplit.models.arm.tendon_arm import TendonArm

DT = 0.03


@dataclass(frozen=True)
class Scale:
    """How much data: training and test episodes of ``steps`` steps, and phase-space samples."""

    training: int = 700
    test: int = 50
    steps: int = 200
    samples: int = 140_000

    def __str__(self) -> str:
        return f"{self.training}+{self.test}x{self.steps}"


@dataclass(frozen=True)
class PaperData:
    """Data of one input law. The test episodes are the last ones simulated; no choice may look at them.

    d2 holds f and its flow over half a step, at static shapes with Gaussian velocities.
    """

    law: str
    training: Episodes
    test: Episodes
    d2: PhaseSamples


@dataclass(frozen=True)
class Source:
    """Where data of one input law come from: files in ``folder``, made where they are not there."""

    arm: TendonArm
    law: str
    folder: Path
    scale: Scale
    seed: int = 0
    workers: int = -1
    progress: bool = True

    def load_or_make(self) -> PaperData:
        """The data; a killed run continues. Raises ValueError for files of other settings or another arm."""
        episodes = self._episodes()
        training = episodes[: self.scale.training]
        d2 = self._samples(f"d2-{self.law}-{self.scale}", strain_rates(self.arm, training), self.scale.samples)
        return PaperData(self.law, training, episodes[self.scale.training :], d2)

    def variant(self, training: Episodes, name: str, known: rod.Scene, count: int) -> PhaseSamples:
        """Phase-space samples of another known part, called ``name``."""
        rates = strain_rates(self.arm, training)
        return self._samples(f"d2-{self.law}-{self.scale}-{name}", rates, count, known)

    def _episodes(self) -> Episodes:
        path = self.folder / f"d1-{self.law}-{self.scale}-seed{self.seed}.h5"
        steps, count = self.scale.steps, self.scale.training + self.scale.test
        if path.exists():
            found = Episodes.load(path)
            check_origin(path, found.provenance, episodes_origin(self.arm, steps, DT, seed=self.seed, law=self.law))
            return found
        return make_episodes(self.arm, path, count, steps, DT, **self._options())

    def _samples(self, name: str, rates: Array, count: int, known: rod.Scene | None = None) -> PhaseSamples:
        path = self.folder / f"{name}-{count}-seed{self.seed}.h5"
        if path.exists():
            found = PhaseSamples.load(path)
            origin = phase_origin(self.arm, rates, seed=self.seed, law=self.law, known=known, dt=DT)
            check_origin(path, found.provenance, origin)
            return found
        return make_phase_samples(self.arm, path, count, rates, known=known, dt=DT, **self._options())

    def _options(self) -> dict[str, Any]:
        return {"seed": self.seed, "workers": self.workers, "progress": self.progress, "law": self.law}
