"""Units of the inputs that terms read."""

from __future__ import annotations

from pisplit.models.rod.terms.chambers import Chambers
from pisplit.models.rod.terms.distributed import DistributedWrench
from pisplit.models.rod.terms.loads import Input, Term
from pisplit.models.rod.terms.pull import TendonTerm
from pisplit.models.rod.terms.tendons import Tendons, Tension

_UNITS = {
    "force": "N",
    "moment": "N m",
    "position": "m",
    "rotation": "rad",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "spin": "rad/s",
    "spin_rate": "rad/s^2",
}
_PER_LENGTH = {"force": "N/m", "moment": "N"}


def unit_of(term: Term, item: Input) -> str:
    """Unit of ``item``, an input of ``term``; empty for terms that do not tell."""
    if isinstance(term, TendonTerm) and item.name == term.name:
        return "N" if isinstance(term, Tendons) and isinstance(term.drive, Tension) else "m"
    if isinstance(term, Chambers):
        return "Pa"
    units = _UNITS | _PER_LENGTH if isinstance(term, DistributedWrench) else _UNITS
    return next((unit for name, unit in units.items() if getattr(term, name, None) == item), "")
