"""Numbers of a controller that need no hand: horizon, weight and gain from model and data, in closed loops."""

from pisplit.controllers.tuning.tune import Tuned, tune

__all__ = ["Tuned", "tune"]
