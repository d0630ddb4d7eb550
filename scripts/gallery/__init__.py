"""Pictures of the gallery, each a function whose docstring is the caption (scripts/make_gallery.py draws them)."""

from __future__ import annotations

from collections.abc import Callable
from inspect import getdoc
from typing import Any

#: Figures by name, in the order of the page.
Picture = Callable[[], Any]


def pictures() -> dict[str, Picture]:
    """All pictures by name; their modules are imported here, so that a caption costs little."""
    from gallery import arms, loops, models, rods

    found: dict[str, Picture] = {}
    for room in (rods, arms, models, loops):
        for name, made in vars(room).items():
            if callable(made) and not name.startswith("_") and getattr(made, "__module__", "") == room.__name__:
                found[name] = made
    return found


def caption(picture: Picture) -> str:
    """The caption of a picture in one line."""
    return " ".join((getdoc(picture) or "").split())
