"""Strategies of hypothesis for random scenes, and a fixed number of them drawn with a seed."""

from __future__ import annotations

import json
from typing import Any, TypeGuard

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from stress.random_scenes import Description

#: Terms that bend a rod.
LOADS = ("gravity", "tip force", "driven tip force", "distributed force", "tendons", "chambers")
STRAINS = ("planar", "planar-cosserat", "kirchhoff", "extensible", "cosserat")


def logarithmic(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of three digits, spread evenly over their logarithm; shrinks to ``low``."""
    steps = 1000
    return st.integers(0, steps).map(lambda k: float(f"{low * (high / low) ** (k / steps):.3g}"))


def number(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of three digits, spread evenly; shrinks to ``low``."""
    return st.integers(0, 1000).map(lambda k: float(f"{low + (high - low) * k / 1000:.3g}"))


def _term(name: str, **values: st.SearchStrategy[Any]) -> st.SearchStrategy[Description]:
    return st.fixed_dictionaries({"term": st.just(name), **values})


def terms() -> st.SearchStrategy[list[Description]]:
    """A list of terms of different kinds, in the order of this list."""
    angle = st.sampled_from((0.0, 45.0, 90.0, 200.0))
    tendons = _term(
        "tendons",
        drive=st.sampled_from(("displacement", "tension")),
        size=logarithmic(0.05, 2.0),
        offset=logarithmic(0.005, 0.05),
        compliance=logarithmic(0.003, 0.3),
        route=st.sampled_from(("parallel", "helical")),
        half=st.booleans(),
        friction=st.sampled_from((0.0, 0.0, 0.2)),
    )
    kinds: list[st.SearchStrategy[Description]] = [
        _term("gravity"),
        st.one_of(
            _term("damping", ratio=logarithmic(0.03, 3.0)),
            _term("damping", ratio=logarithmic(0.03, 3.0)),
            _term("damping", ratio=logarithmic(1e-3, 10.0)),
            _term("bending damping", ratio=logarithmic(1e-3, 3.0)),
        ),
        _term("linear drag", size=logarithmic(1e-3, 1.0)),
        _term("quadratic drag", size=logarithmic(1e-3, 10.0)),
        st.one_of(
            _term("tip force", size=logarithmic(0.01, 10.0), angle_deg=angle, follower=st.booleans()),
            _term("driven tip force", size=logarithmic(0.01, 5.0), angle_deg=angle),
        ),
        _term("distributed force", size=logarithmic(0.01, 5.0), angle_deg=angle),
        _term("point mass", size=logarithmic(0.01, 3.0), at=number(0.1, 1.0)),
        st.one_of(
            tendons,
            tendons,
            _term("chambers", size=logarithmic(0.05, 2.0), offset=logarithmic(0.01, 0.05)),
        ),
    ]
    optional = [st.one_of(st.none(), kind, kind) for kind in kinds]
    return st.tuples(*optional).map(lambda found: [t for t in found if t is not None])


def _bends(described: Description) -> TypeGuard[Description]:
    return any(t["term"] in LOADS for t in described["terms"])


def scenes() -> st.SearchStrategy[Description]:
    """Any rod, terms and inputs within reason, something of which bends the rod."""
    return st.fixed_dictionaries(
        {
            "strains": st.sampled_from(STRAINS),
            "nodes": st.sampled_from((5, 6, 7, 8, 4, 3, 2)),
            "elements": st.sampled_from((1, 1, 1, 2)),
            "section": st.sampled_from(("circle", "circle", "tube", "tapered")),
            "length": logarithmic(0.02, 3.0),
            "slenderness": logarithmic(1e-3, 0.05),
            "young": logarithmic(1e5, 4e11),
            "density": logarithmic(500.0, 9000.0),
            "rest_curvature": st.sampled_from((0.0, 0.0, 0.5, 2.0)),
            "terms": terms(),
            "interval": logarithmic(0.01, 0.5),
            "steps": st.just(5),
            "pattern": st.sampled_from(("random", "ramp", "switch")),
            "inputs": st.integers(0, 999),
        }
    ).filter(_bends)


def drawn(number_of: int, seed: int) -> list[Description]:
    """So many different scenes, the same for the same seed."""
    found: dict[str, Description] = {}  # one of a kind: variations of a scene judge little

    @seeded(seed)
    @settings(
        max_examples=3 * number_of,
        phases=(Phase.generate,),
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(scenes())
    def collect(described: Description) -> None:
        kind = [described[part] for part in ("strains", "nodes", "elements", "pattern")]
        found.setdefault(json.dumps([*kind, *(t["term"] for t in described["terms"])]), described)

    collect()
    # Hypothesis begins with simple scenes and repeats itself: of all that it gave, some from everywhere.
    chosen = np.random.default_rng(seed).permutation(len(found))[:number_of]
    every = list(found.values())
    return [every[k] for k in chosen]
