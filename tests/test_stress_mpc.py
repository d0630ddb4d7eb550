"""A few runs of the stress script: limits hold, logs survive, fallbacks have names, and a breach would be seen."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))

from stress.stress_mpc import judged, one


@pytest.mark.parametrize("seed", range(2_000_000, 2_000_006))
def test_a_run_under_stress_has_no_breach(seed: int) -> None:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        log, _, wrong = one(seed)
    assert log is not None and not wrong


def test_a_breach_is_seen() -> None:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        log = one(2_000_000)[0]
    assert log is not None and len(log.u) > 2
    m = log.u.shape[1]
    wide, narrow = np.full(m, 2.0), np.full(m, 1e-9)
    assert judged(log, -wide, wide, wide) == []
    assert "applied inputs outside their box" in judged(log, -narrow, narrow, wide)
    assert "applied inputs faster than their limit" in judged(log, -wide, wide, narrow)
    assert "a fallback without a name" in judged(replace(log, fallback=~log.fallback), -wide, wide, wide)
