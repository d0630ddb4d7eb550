"""Parameters as scikit-learn knows them: read, changed and cloned by name."""

from __future__ import annotations

import inspect
from typing import Any, TypeVar

_P = TypeVar("_P", bound="Parameters")


class Parameters:
    """An estimator whose constructor keeps every argument, unchanged, under its name (``sklearn.base.clone`` works)."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The options the estimator was made with (``deep`` is scikit-learn's, and changes nothing here)."""
        return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

    def set_params(self: _P, **params: Any) -> _P:
        """Change options ``params``, with the checks of the constructor; what was fitted stays until the next fit."""
        known = self.get_params()
        unknown = sorted(set(params) - set(known))
        if unknown:
            raise ValueError(f"{type(self).__name__} has no option {unknown[0]!r}; it has {', '.join(known)}")
        replacement = type(self)(**{**known, **params})
        for name in known:
            setattr(self, name, getattr(replacement, name))
        return self

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn (1.6 and later) asks of estimators: no classifier, no regressor, and no target."""
        from sklearn.utils import Tags, TargetTags

        return Tags(estimator_type=None, target_tags=TargetTags(required=False))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in self.get_params().items())})"
