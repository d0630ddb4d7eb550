"""A dictionary as a transformer of scikit-learn: columns of Theta as features of any other regression."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array
from pisplit.data.episodes import Episodes
from pisplit.dictionary.dictionary import Dictionary
from pisplit.estimators.parameters import Parameters

Array = NDArray[np.float64]


class DictionaryFeatures(Parameters):
    """Columns of a dictionary for pipelines and searches of scikit-learn, as ``PolynomialFeatures`` has powers.

    theta  dictionary

    Rows of X are states and inputs side by side (N, n + m); where the dictionary has delays, the past is taken to be
    the present. Episodes give the rows of all their snapshot pairs, with their own history. Nothing is learned.
    Raises ValueError where theta is no Dictionary.
    """

    def __init__(self, theta: Dictionary) -> None:
        if not isinstance(theta, Dictionary):
            raise ValueError(f"theta is a {type(theta).__name__}; expected a Dictionary")
        self.theta = theta

    def fit(self, X: ArrayLike | Episodes, y: Any = None) -> DictionaryFeatures:
        """Check the columns of ``X`` (N, n + m), or Episodes; ``y`` is scikit-learn's, and not used.

        Raises ValueError for other columns and for entries that are not finite.
        """
        self.transform(X)
        return self

    def transform(self, X: ArrayLike | Episodes) -> Array:
        """Theta (N, M) at rows ``X`` (N, n + m) of states and inputs, or at all pairs of Episodes.

        Raises ValueError for other columns and for entries that are not finite.
        """
        theta = self.theta
        if isinstance(X, Episodes):
            data = X.arranged(*theta.wanted_names, owner="the dictionary")
            return theta.named_after(data).evaluate(data.pairs(theta.n_delays))
        rows = finite_array(X, "X", (None, theta.n_states + theta.n_inputs))
        return theta.evaluate_static(rows[:, : theta.n_states], rows[:, theta.n_states :])

    def fit_transform(self, X: ArrayLike | Episodes, y: Any = None) -> Array:
        """``fit`` and ``transform`` of ``X`` (N, n + m); ``y`` is scikit-learn's, and not used.

        Raises ValueError as they do.
        """
        return self.transform(X)

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[np.object_]:
        """Names (M,) of the columns; ``input_features`` is scikit-learn's, and not used."""
        return np.asarray(self.theta.column_names, dtype=object)
