"""The adapter by which Exudyn moves the rods of the benchmark."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

from benchmarks.rod_exudyn import Newton, _assembled, _cubic, _linear, run_exudyn
from benchmarks.rod_peers import STEEL, error, run_large


@pytest.mark.parametrize("shares", [_cubic, _linear])
def test_the_drag_takes_the_power_of_rigid_motions(shares: object) -> None:
    """The integral of the squared velocity is L for a rod that moves by 1, L^3/3 for one that turns about its end."""
    length, elements = 2.0, 4
    part = shares(length / elements)  # type: ignore[operator]
    whole, of_node = _assembled(part, elements), part[2]
    moves, turns = np.zeros(len(whole)), np.zeros(len(whole))
    moves[1::of_node], turns[1::of_node] = 1.0, np.linspace(0.0, length, elements + 1)
    if part[1] == 2:
        turns[3::of_node] = 1.0
    assert moves @ whole @ moves == pytest.approx(length) and turns @ whole @ turns == pytest.approx(length**3 / 3.0)


def test_exudyn_and_large_steps_move_alike() -> None:
    pytest.importorskip("exudyn")
    own = run_large(STEEL, "planar", 5, 3, 1)
    for element in ("beam", "cable"):
        theirs = run_exudyn(STEEL, element, 12, 4, Newton(1e-4, every_step=True))
        assert error(theirs, own) < 1e-3
