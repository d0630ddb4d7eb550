"""Texts of dataclasses."""

from __future__ import annotations

from dataclasses import Field, fields
from typing import Any

#: Metadata of a field that ``brief`` leaves out at its default.
OPTION = {"option": True}


def brief(item: Any) -> str:
    """``repr`` of a dataclass without the options that are at their defaults: a new option changes no old text.

    ``item`` is the dataclass.
    """

    def silent(f: Field[Any]) -> bool:
        return bool(f.metadata.get("option")) and getattr(item, f.name) == f.default

    kept = [f"{f.name}={getattr(item, f.name)!r}" for f in fields(item) if not silent(f)]
    return f"{type(item).__name__}({', '.join(kept)})"
