"""Several recordings as one: the same columns, units and step, each episode with its own past."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pisplit.checks import check_same_step
from pisplit.data.warning import warn

if TYPE_CHECKING:
    from pisplit.data.episodes import Episodes


#: Facts that belong to one recording and not to several.
OWN = ("episodes", "samples", "incomplete_samples", "lost_samples", "pieces", "jitter", "starts", "runs", "screened")


def not_episodes(value: Any, name: str, expected: str = "Episodes") -> str:
    """What is wrong with a ``value`` called ``name`` that is not what is ``expected``, and how several become one."""
    several = isinstance(value, list | tuple) and len(value) > 0 and all(hasattr(part, "xs") for part in value)
    hint = "; several recordings become one by d1 + d2, or sum(list)" if several else ""
    return f"{name} is a {type(value).__name__}; expected {expected}{hint}"


def together(value: Any, name: str) -> Episodes:
    """Episodes ``value``, or one of several in a list, which are brought to the columns of the first.

    Raises ValueError, in one line, for anything else; errors call it ``name``.
    """
    from pisplit.data.episodes import Episodes  # which knows this file

    if isinstance(value, Episodes):
        return value
    if not isinstance(value, list | tuple) or not value or not all(isinstance(part, Episodes) for part in value):
        raise ValueError(not_episodes(value, name))
    half = len(value) // 2  # by halves: one after another would copy the first ones again and again
    return value[0] if half == 0 else together(value[:half], name) + together(value[half:], name)


def joined(first: Episodes, second: Episodes) -> dict[str, Any]:
    """Fields of the episodes of ``first`` and then of ``second``, by name.

    Columns of the second are brought to the order and units of the first, by name. Facts of the origin that both share
    stay; "parts" holds all of each, with its number of episodes. Arrays that only one saved along are left out, with a
    warning. Raises ValueError, in one line, for other columns, units, steps, quantities and output groups.
    """
    check_same_step(second.dt, first.dt, "the second recording has", "the first")
    names = first.state_names, first.input_names, first.units, first.input_units
    second = second.arranged(*names, owner="the first recording")
    told = {}
    for name in ("units", "input_units"):
        told[name] = [a or b for a, b in zip(getattr(first, name), getattr(second, name), strict=True)]
    if first.quantities != second.quantities:
        raise ValueError(f"quantities are {first.quantities} and {second.quantities}; give both the same")
    groups = dict(first.outputs or {})
    for name, group in (second.outputs or {}).items():
        if groups.setdefault(name, group) != group:
            raise ValueError(f"outputs[{name!r}] are the states {groups[name]} and {group}; give both the same")
    mine, other = first.extra or {}, second.extra or {}
    if lost := sorted(set(mine) ^ set(other)):
        warn(f"extra {', '.join(map(repr, lost))} is in one of the recordings only and left out")
    return {
        **told,
        "state_names": first.state_names,
        "input_names": first.input_names,
        "quantities": first.quantities,
        "dt": first.dt,
        "xs": [*first.xs, *second.xs],
        "us": [*first.us, *second.us],
        "outputs": groups,
        "extra": {name: [*mine[name], *other[name]] for name in mine if name in other},
        "provenance": _origin([first, second]),
    }


def _origin(recordings: Sequence[Episodes]) -> dict[str, Any]:
    parts: list[Mapping[str, Any]] = []
    for each in recordings:
        known = dict(each.provenance or {})
        parts += known["parts"] if "parts" in known else [{"episodes": len(each), **known}]
    shared = {
        key: value
        for key, value in parts[0].items()
        if key not in OWN and all(key in part and part[key] == value for part in parts)
    }
    return {**shared, "parts": [dict(part) for part in parts]}
