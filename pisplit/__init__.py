"""Physics-informed split Koopman identification and control of tendon-driven soft arms."""

from pathlib import Path as _Path

from pisplit import observables
from pisplit.bilinear import BilinearEDMDc
from pisplit.dictionary import Dictionary
from pisplit.edmdc import LinearEDMDc
from pisplit.episodes import Episodes
from pisplit.lifted import LiftedModel
from pisplit.phase import PhaseSamples
from pisplit.pi import PIEDMDc

__all__ = [
    "BilinearEDMDc",
    "Dictionary",
    "Episodes",
    "LiftedModel",
    "LinearEDMDc",
    "PIEDMDc",
    "PhaseSamples",
    "observables",
]

_root = _Path(__file__).resolve().parent.parent
if (_root / "models" / "__init__.py").exists() and (_root / "pyproject.toml").exists():
    __path__.append(str(_root))  # in a source tree `models` and `controllers` stand beside this folder
