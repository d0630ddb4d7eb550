"""Physics-informed split Koopman identification and control of tendon-driven soft arms."""

from pathlib import Path as _Path

from pisplit import _moved, observables
from pisplit.data.actuator import Actuator
from pisplit.data.episodes import Episodes, Pairs
from pisplit.data.phase import PhaseSamples
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.bilinear import BilinearEDMDc
from pisplit.estimators.edmdc import LinearEDMDc
from pisplit.estimators.pi import PIEDMDc
from pisplit.estimators.streaming import StreamingEDMDc
from pisplit.estimators.twin import TwinEDMDc
from pisplit.evaluation.comparison import Comparison, LearningCurve, compare, learning_curve
from pisplit.evaluation.horizon import HorizonErrors, horizon_errors
from pisplit.evaluation.rollouts import RolloutErrors, rollout_errors
from pisplit.generator import HalfStep, Spectrum, generator_edmd, generator_spectrum, half_step
from pisplit.lifted.formats import to_c_header, to_control, to_numpy, to_state_space
from pisplit.lifted.model import LiftedModel, Rollout
from pisplit.lifted.modes import Modes, modes
from pisplit.lifted.radius import stabilised
from pisplit.lifted.reduction import Reduction, balanced_truncation
from pisplit.lifted.sensitivity import input_jacobian, rollout_jacobian
from pisplit.regression.recursive import RecursiveRegression

__all__ = [
    "Actuator",
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
_moved.follow()
