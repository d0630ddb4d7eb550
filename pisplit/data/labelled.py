"""Recordings as xarray datasets, and back: labelled axes, units as attributes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.data.episodes import Episodes

if TYPE_CHECKING:
    from xarray import Dataset

#: Steps of times that differ by more, in parts of a step, are no steps of one length.
UNEVEN = 1e-6


def to_xarray(episodes: Episodes) -> list[Dataset]:
    """One ``xarray.Dataset`` for each of the ``episodes``, whose lengths differ.

    x (time, state) at T+1 times in s from the start, u (step, input) held over the T steps from times ``step`` on;
    units and quantities are coordinates of states and inputs. Raises ValueError if xarray is not installed.
    """
    xarray = _xarray()
    times = [episodes.dt * np.arange(len(x)) for x in episodes.xs]
    return [
        xarray.Dataset(
            {"x": (("time", "state"), np.array(x)), "u": (("step", "input"), np.array(u))},
            coords={
                "time": ("time", t, {"units": "s"}),
                "step": ("step", t[:-1], {"units": "s"}),
                "state": list(episodes.state_names or ()),
                "input": list(episodes.input_names or ()),
                "state_unit": ("state", list(episodes.units or ())),
                "input_unit": ("input", list(episodes.input_units or ())),
                "quantity": ("state", list(episodes.quantities or ())),
            },
            attrs={"dt": episodes.dt, "provenance": json.dumps(dict(episodes.provenance or {}))},
        )
        for t, x, u in zip(times, episodes.xs, episodes.us, strict=True)
    ]


def from_xarray(datasets: Dataset | Sequence[Dataset]) -> Episodes:
    """Episodes of ``xarray`` datasets as ``to_xarray`` makes them: x (time, state) and u (step, input) with labels.

    ``dt`` is the attribute, or the spacing of ``time`` in s. Axes may be in any order; units, quantities and provenance
    may be missing. Raises ValueError, in one line, for variables or axes that are missing, times that are not evenly
    spaced, and datasets of different columns or steps.
    """
    xarray = _xarray()
    given = [datasets] if isinstance(datasets, xarray.Dataset) else list(datasets)
    if not given or not all(isinstance(one, xarray.Dataset) for one in given):
        raise ValueError("expected an xarray.Dataset, or a list of them")
    found = [_episode(one, i) for i, one in enumerate(given)]
    first = found[0]
    for i, other in enumerate(found[1:], start=1):
        if abs(other["dt"] - first["dt"]) > UNEVEN * first["dt"]:
            raise ValueError(f"dataset {i} has steps of {other['dt']} s, the first of {first['dt']} s")
        for name in ("state_names", "input_names", "units", "input_units"):
            if other[name] != first[name]:
                raise ValueError(f"dataset {i} has other {name} than the first: {other[name]}, {first[name]}")
    return Episodes(**{**first, "xs": [f["xs"] for f in found], "us": [f["us"] for f in found]})


def _episode(data: Any, i: int) -> dict[str, Any]:
    for name, axes in (("x", ("time", "state")), ("u", ("step", "input"))):
        if name not in data or set(data[name].dims) != set(axes):
            raise ValueError(f"dataset {i} has no variable {name!r} with the axes {axes}; to_xarray shows the form")
    x, u = data["x"].transpose("time", "state"), data["u"].transpose("step", "input")
    if "dt" in data.attrs:
        dt = float(data.attrs["dt"])
    else:
        steps = np.diff(np.asarray(data["time"], dtype=np.float64))
        if len(steps) == 0 or np.ptp(steps) > UNEVEN * abs(steps.mean()):
            raise ValueError(f"dataset {i}: its times are not evenly spaced; interpolate, or give the attribute dt")
        dt = float(steps.mean())
    return {
        "xs": np.asarray(x, dtype=np.float64),
        "us": np.asarray(u, dtype=np.float64),
        "dt": dt,
        "state_names": _texts(data, "state"),
        "input_names": _texts(data, "input"),
        "units": _texts(data, "state_unit"),
        "input_units": _texts(data, "input_unit"),
        "quantities": _texts(data, "quantity"),
        "provenance": json.loads(data.attrs.get("provenance", "{}")),
    }


def _texts(data: Any, name: str) -> list[str] | None:
    return [str(v) for v in data.coords[name].values] if name in data.coords else None


def _xarray() -> Any:
    try:
        import xarray
    except ImportError:
        raise ValueError("xarray is not installed; run: pip install xarray") from None
    return xarray
