"""Physics-informed split Koopman identification and control of tendon-driven soft arms.

Names are loaded when they are first used: ``import pisplit`` itself costs next to nothing.
"""

import importlib as _importlib
from pathlib import Path as _Path
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from pisplit import _moved

__version__ = "0.2.0"

if _TYPE_CHECKING:
    from pisplit import observables as observables
    from pisplit.controllers import references as references
    from pisplit.controllers.plants import Markers as Markers
    from pisplit.data.actuator import Actuator as Actuator
    from pisplit.data.episodes import Episodes as Episodes
    from pisplit.data.episodes import Pairs as Pairs
    from pisplit.data.labelled import from_xarray as from_xarray
    from pisplit.data.labelled import to_xarray as to_xarray
    from pisplit.data.phase import PhaseSamples as PhaseSamples
    from pisplit.dictionary.dictionary import Dictionary as Dictionary
    from pisplit.estimators.actuator_choice import ActuatorChoice as ActuatorChoice
    from pisplit.estimators.actuator_choice import choose_actuator as choose_actuator
    from pisplit.estimators.actuator_scan import FoundActuator as FoundActuator
    from pisplit.estimators.actuator_scan import find_actuator as find_actuator
    from pisplit.estimators.bilinear import BilinearEDMDc as BilinearEDMDc
    from pisplit.estimators.choosing import Chosen as Chosen
    from pisplit.estimators.choosing import choose as choose
    from pisplit.estimators.edmdc import LinearEDMDc as LinearEDMDc
    from pisplit.estimators.features import DictionaryFeatures as DictionaryFeatures
    from pisplit.estimators.pi import PIEDMDc as PIEDMDc
    from pisplit.estimators.relifted import ReliftedEDMDc as ReliftedEDMDc
    from pisplit.estimators.streaming import StreamingEDMDc as StreamingEDMDc
    from pisplit.estimators.twin import TwinEDMDc as TwinEDMDc
    from pisplit.evaluation.comparison import Comparison as Comparison
    from pisplit.evaluation.comparison import LearningCurve as LearningCurve
    from pisplit.evaluation.comparison import compare as compare
    from pisplit.evaluation.comparison import learning_curve as learning_curve
    from pisplit.evaluation.eigenpairs import ModelSpectrum as ModelSpectrum
    from pisplit.evaluation.eigenpairs import model_spectrum as model_spectrum
    from pisplit.evaluation.horizon import HorizonErrors as HorizonErrors
    from pisplit.evaluation.horizon import horizon_errors as horizon_errors
    from pisplit.evaluation.predicted import PredictedError as PredictedError
    from pisplit.evaluation.predicted import predicted_error as predicted_error
    from pisplit.evaluation.rollouts import RolloutErrors as RolloutErrors
    from pisplit.evaluation.rollouts import rollout_errors as rollout_errors
    from pisplit.front import ArmIdentifier as ArmIdentifier
    from pisplit.front import Identified as Identified
    from pisplit.front import identify as identify
    from pisplit.generator import HalfStep as HalfStep
    from pisplit.generator import Spectrum as Spectrum
    from pisplit.generator import generator_edmd as generator_edmd
    from pisplit.generator import generator_spectrum as generator_spectrum
    from pisplit.generator import half_step as half_step
    from pisplit.lifted.foreign import from_state_space as from_state_space
    from pisplit.lifted.formats import to_c_header as to_c_header
    from pisplit.lifted.formats import to_control as to_control
    from pisplit.lifted.formats import to_numpy as to_numpy
    from pisplit.lifted.formats import to_state_space as to_state_space
    from pisplit.lifted.model import LiftedModel as LiftedModel
    from pisplit.lifted.modes import Modes as Modes
    from pisplit.lifted.modes import modes as modes
    from pisplit.lifted.radius import stabilised as stabilised
    from pisplit.lifted.reduction import Reduction as Reduction
    from pisplit.lifted.reduction import balanced_truncation as balanced_truncation
    from pisplit.lifted.rollout import Rollout as Rollout
    from pisplit.lifted.sensitivity import input_jacobian as input_jacobian
    from pisplit.lifted.sensitivity import rollout_jacobian as rollout_jacobian
    from pisplit.models.arm import RestShapes as RestShapes
    from pisplit.models.arm import TendonArm as TendonArm
    from pisplit.regression.recursive import RecursiveRegression as RecursiveRegression

#: Public names by the module that has them.
_PLACES = {
    "pisplit.controllers.plants": "Markers",
    "pisplit.data.actuator": "Actuator",
    "pisplit.data.episodes": "Episodes Pairs",
    "pisplit.data.labelled": "from_xarray to_xarray",
    "pisplit.data.phase": "PhaseSamples",
    "pisplit.dictionary.dictionary": "Dictionary",
    "pisplit.estimators.actuator_choice": "ActuatorChoice choose_actuator",
    "pisplit.estimators.actuator_scan": "FoundActuator find_actuator",
    "pisplit.estimators.bilinear": "BilinearEDMDc",
    "pisplit.estimators.choosing": "Chosen choose",
    "pisplit.estimators.edmdc": "LinearEDMDc",
    "pisplit.estimators.features": "DictionaryFeatures",
    "pisplit.estimators.pi": "PIEDMDc",
    "pisplit.estimators.relifted": "ReliftedEDMDc",
    "pisplit.estimators.streaming": "StreamingEDMDc",
    "pisplit.estimators.twin": "TwinEDMDc",
    "pisplit.evaluation.comparison": "Comparison LearningCurve compare learning_curve",
    "pisplit.evaluation.horizon": "HorizonErrors horizon_errors",
    "pisplit.evaluation.eigenpairs": "ModelSpectrum model_spectrum",
    "pisplit.evaluation.predicted": "PredictedError predicted_error",
    "pisplit.evaluation.rollouts": "RolloutErrors rollout_errors",
    "pisplit.front": "ArmIdentifier Identified identify",
    "pisplit.generator": "HalfStep Spectrum generator_edmd generator_spectrum half_step",
    "pisplit.lifted.foreign": "from_state_space",
    "pisplit.lifted.formats": "to_c_header to_control to_numpy to_state_space",
    "pisplit.lifted.model": "LiftedModel",
    "pisplit.lifted.rollout": "Rollout",
    "pisplit.lifted.modes": "Modes modes",
    "pisplit.lifted.radius": "stabilised",
    "pisplit.lifted.reduction": "Reduction balanced_truncation",
    "pisplit.lifted.sensitivity": "input_jacobian rollout_jacobian",
    "pisplit.models.arm": "RestShapes TendonArm",
    "pisplit.regression.recursive": "RecursiveRegression",
}
_HOME = {name: module for module, names in _PLACES.items() for name in names.split()}
#: Modules that are public under a name of their own.
_MODULES = {"observables": "pisplit.observables", "references": "pisplit.controllers.references"}

__all__ = [
    "Actuator",
    "ActuatorChoice",
    "ArmIdentifier",
    "BilinearEDMDc",
    "Chosen",
    "Comparison",
    "Dictionary",
    "DictionaryFeatures",
    "Episodes",
    "FoundActuator",
    "HalfStep",
    "HorizonErrors",
    "Identified",
    "LearningCurve",
    "LiftedModel",
    "LinearEDMDc",
    "Markers",
    "ModelSpectrum",
    "Modes",
    "PIEDMDc",
    "Pairs",
    "PhaseSamples",
    "PredictedError",
    "RecursiveRegression",
    "Reduction",
    "ReliftedEDMDc",
    "RestShapes",
    "Rollout",
    "RolloutErrors",
    "Spectrum",
    "StreamingEDMDc",
    "TendonArm",
    "TwinEDMDc",
    "balanced_truncation",
    "choose",
    "choose_actuator",
    "compare",
    "find_actuator",
    "from_state_space",
    "from_xarray",
    "generator_edmd",
    "generator_spectrum",
    "half_step",
    "horizon_errors",
    "identify",
    "input_jacobian",
    "learning_curve",
    "model_spectrum",
    "modes",
    "observables",
    "predicted_error",
    "references",
    "rollout_errors",
    "rollout_jacobian",
    "stabilised",
    "to_c_header",
    "to_control",
    "to_numpy",
    "to_state_space",
    "to_xarray",
]


def __getattr__(name: str) -> _Any:
    if name in _MODULES:
        found = _importlib.import_module(_MODULES[name])
    elif name in _HOME:
        found = getattr(_importlib.import_module(_HOME[name]), name)
    else:
        raise AttributeError(f"module 'pisplit' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


_root = _Path(__file__).resolve().parent.parent
if (_root / "models" / "__init__.py").exists() and (_root / "pyproject.toml").exists():
    __path__.append(str(_root))  # in a source tree `models` and `controllers` stand beside this folder
_moved.follow()
