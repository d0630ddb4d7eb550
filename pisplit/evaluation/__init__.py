"""How good a model is: roll-out errors, errors by horizon, predicted errors, comparisons and learning curves.

Errors are those of open-loop roll-outs on recordings the model has not seen.
"""

from pisplit.evaluation.comparison import Comparison, LearningCurve, compare, learning_curve
from pisplit.evaluation.eigenpairs import ModelSpectrum, model_spectrum
from pisplit.evaluation.horizon import HorizonErrors, horizon_errors
from pisplit.evaluation.predicted import PredictedError, predicted_error
from pisplit.evaluation.rollouts import RolloutErrors, rollout_errors
from pisplit.evaluation.scorer import RolloutScore
from pisplit.evaluation.splits import EpisodeSplit

__all__ = [
    "Comparison",
    "EpisodeSplit",
    "HorizonErrors",
    "LearningCurve",
    "ModelSpectrum",
    "PredictedError",
    "RolloutErrors",
    "RolloutScore",
    "compare",
    "horizon_errors",
    "learning_curve",
    "model_spectrum",
    "predicted_error",
    "rollout_errors",
]
