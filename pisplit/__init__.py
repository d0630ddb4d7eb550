"""Physics-informed split Koopman identification and control of tendon-driven soft arms."""

from pathlib import Path as _Path

from pisplit import observables
from pisplit.bilinear import BilinearEDMDc
from pisplit.comparison import Comparison, LearningCurve, compare, learning_curve
from pisplit.dictionary import Dictionary
from pisplit.edmdc import LinearEDMDc
from pisplit.episodes import Episodes, Pairs
from pisplit.evaluate import RolloutErrors, rollout_errors
from pisplit.exporting import to_c_header, to_control, to_numpy, to_state_space
from pisplit.generator import HalfStep, generator_edmd, generator_spectrum, half_step
from pisplit.horizon import HorizonErrors, horizon_errors
from pisplit.lifted import LiftedModel, Rollout
from pisplit.modal import Modes, modes
from pisplit.phase import PhaseSamples
from pisplit.pi import PIEDMDc
from pisplit.recursive import RecursiveRegression
from pisplit.reduction import Reduction, balanced_truncation
from pisplit.sensitivity import input_jacobian, rollout_jacobian
from pisplit.spectrum import Spectrum
from pisplit.stability import stabilised
from pisplit.streaming import StreamingEDMDc
from pisplit.twin import TwinEDMDc

__all__ = [
    "BilinearEDMDc",
    "Comparison",
    "Dictionary",
    "Episodes",
    "HalfStep",
    "HorizonErrors",
    "LearningCurve",
    "LiftedModel",
    "LinearEDMDc",
    "Modes",
    "PIEDMDc",
    "Pairs",
    "PhaseSamples",
    "RecursiveRegression",
    "Reduction",
    "Rollout",
    "RolloutErrors",
    "Spectrum",
    "StreamingEDMDc",
    "TwinEDMDc",
    "balanced_truncation",
    "compare",
    "generator_edmd",
    "generator_spectrum",
    "half_step",
    "horizon_errors",
    "input_jacobian",
    "learning_curve",
    "modes",
    "observables",
    "rollout_errors",
    "rollout_jacobian",
    "stabilised",
    "to_c_header",
    "to_control",
    "to_numpy",
    "to_state_space",
]

_root = _Path(__file__).resolve().parent.parent
if (_root / "models" / "__init__.py").exists() and (_root / "pyproject.toml").exists():
    __path__.append(str(_root))  # in a source tree `models` and `controllers` stand beside this folder
