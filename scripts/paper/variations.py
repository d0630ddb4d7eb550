"""What the paper leaves open, changed one at a time: the effect on its three methods."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from common.data import PaperData, Scale, Source
from common.protocol import Draw, Method, Predictor
from common.runs import Cell, run_cells
from paper.methods import Choices, Printed
from paper.tables import Row, table
from pisplit import PhaseSamples
from pisplit.models import rod
from pisplit.models.arm.recording import EQUATIONS

#: |D1| and draws; phase samples.
SIZES = {64: 1, 1024: 1}
SAMPLES = 4096
#: Phase samples of other known parts: the flow of an undamped backbone takes some twenty times as long.
PART_SAMPLES = 512

#: Other settings of a choice; the defaults (:class:`Choices`) run beside them.
VARIATIONS: dict[str, tuple[dict[str, object], ...]] = {
    "scaling": ({"scaling": "quantity"}, {"scaling": "none"}),
    "alpha": ({"alpha": 0.1}, {"alpha": 0.001}, {"alpha": 0.0001}),
    "delays": ({"past": "equal"},),
    "half-step": ({"half_step": "generator"}, {"half_step": "first-order"}, {"known": "least squares"}),
    "rows": ({"rows": "velocities"},),
    "parts": ({"parts": "backbone"}, {"parts": "backbone, damping"}),
}
#: Choices that L- and B-EDMDc take too; the others are of the split alone.
SHARED = ("scaling", "alpha")
#: Terms of the arm that a known part leaves out beside the tendons.
LEFT_OUT: dict[str, tuple[type, ...]] = {
    "backbone": (rod.Gravity, rod.KelvinVoigt, rod.QuadraticDrag),
    "backbone, damping": (rod.Gravity, rod.QuadraticDrag),
}


class OtherSamples:
    """A method that sees the phase samples of another known part."""

    def __init__(self, fit: Printed, by_law: Mapping[str, PhaseSamples], name: str) -> None:
        self.fit, self.by_law, self.name = fit, by_law, name

    def __call__(self, draw: Draw) -> Predictor:
        """Fit with as many samples as the draw has."""
        return self.fit(replace(draw, d2=self.by_law[draw.law]))

    def __repr__(self) -> str:
        return f"OtherSamples({self.fit!r}, {self.name})"


def vary(
    names: Sequence[str],
    sources: Mapping[str, Source],
    data: Mapping[str, PaperData],
    folder: Path,
    scale: Scale,
    workers: int = -1,
) -> list[Row]:
    """Errors of all settings of the choices ``names`` at a few sizes."""
    methods = [m for name in names for m in _methods(name, sources, data)]
    methods = list({method.name: method for method in methods}.values())
    n2 = min(SAMPLES, scale.samples)
    most = scale.training * scale.steps // 4
    sizes = {n1: draws for n1, draws in SIZES.items() if n1 < most} or {most // 2: 1}
    cells = [
        Cell(law, method.name, n1, n2, seed)
        for law in sources
        for method in methods
        for n1, draws in sizes.items()
        for seed in range(draws)
    ]
    first = next(iter(sources.values()))
    settings = {"scale": asdict(scale), "seed": first.seed, "samples": n2, "equations": EQUATIONS}
    return table(run_cells(sources, methods, cells, folder / "variations", settings, workers))


def _methods(name: str, sources: Mapping[str, Source], data: Mapping[str, PaperData]) -> Iterator[Method]:
    for setting in ({}, *VARIATIONS[name]):
        label = ", ".join(f"{key} {value}" for key, value in setting.items()) or "default"
        parts = setting.get("parts")
        choices = Choices(**{k: v for k, v in setting.items() if k != "parts"})  # type: ignore[arg-type]
        if name in SHARED or not setting:
            yield Method(f"L-EDMDc, {label}", Printed("L-EDMDc", choices))
            yield Method(f"B-EDMDc, {label}", Printed("B-EDMDc", choices))
        if parts is None:
            yield Method(f"PI-EDMDc, {label}", Printed("PI-EDMDc", choices))
            continue
        known = {law: source.arm.passive for law, source in sources.items()}
        for term in LEFT_OUT[str(parts)]:
            known = {law: scene.without(term) for law, scene in known.items()}
        short = str(parts).replace(", ", "-")
        samples = {
            law: source.variant(data[law].training, short, known[law], min(PART_SAMPLES, source.scale.samples))
            for law, source in sources.items()
        }
        yield Method(f"PI-EDMDc, {label}", OtherSamples(Printed("PI-EDMDc", choices), samples, short))
