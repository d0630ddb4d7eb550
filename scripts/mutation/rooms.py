"""The formulas that are mutated, by room: patterns of files in the source tree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

#: Folders of the source tree that make the package.
PACKAGE = ("pisplit", "models", "controllers")

ROOMS: Mapping[str, Sequence[str]] = {
    "splitting": ("pisplit/splitting/*.py",),
    "generator": ("pisplit/generator/*.py",),
    "regression": ("pisplit/regression/*.py",),
    "lifted model": ("pisplit/lifted/*.py",),
    "condensed QP": ("controllers/mpc/*.py",),
    "estimator": ("controllers/estimation/*.py",),
    "rod balance": ("models/rod/equations/*.py",),
    "kinematics": ("models/rod/kinematics/*.py",),
    "tendons": ("models/rod/terms/tendons*.py", "models/rod/terms/routing.py"),
    "data import": ("pisplit/data/*.py",),
}


def files(root: Path, rooms: Mapping[str, Sequence[str]] = ROOMS) -> dict[str, list[str]]:
    """Files (relative to ``root``) of every room that has any, without those that only hand names on."""
    found = {
        room: sorted(
            path.relative_to(root).as_posix()
            for pattern in patterns
            for path in root.glob(pattern)
            if path.name != "__init__.py"
        )
        for room, patterns in rooms.items()
    }
    return {room: names for room, names in found.items() if names}
