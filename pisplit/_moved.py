"""Import paths of version 0.1 that have moved: they lead to the new place, with a DeprecationWarning."""

from __future__ import annotations

import importlib
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

_ROOMS = {
    "pisplit.data": "episodes phase importing:recordings h5:store units",
    "pisplit.dictionary": "compiling:compiled structured:products",
    "pisplit.regression": "least_squares lasso lasso_active_set lasso_cvxpy multi_target moments recursive scaling",
    "pisplit.generator": "bilinear_half_step:product_half_step spectrum",
    "pisplit.splitting": "balanced hold two_stage split_options:options",
    "pisplit.estimators": "estimator:base edmdc bilinear pi twin streaming choice:alpha_search "
    "excitation:boundedness bounded:boundedness",
    "pisplit.lifted": "export:operators exporting:formats stability:radius modal:modes reduction sensitivity",
    "pisplit.evaluation": "evaluate:rollouts horizon comparison",
    "pisplit.models.arm": "tendon_arm equilibrium:static_table arm_physics:physics generation:recording blocks",
    "pisplit.models.calibration": "calibrated:parametrised calibration_model:model recordings resting_shapes",
    "pisplit.models.rod.kinematics": "gauss rotations strains",
    "pisplit.models.rod.section": "material body",
    "pisplit.models.rod.terms": "base buoyancy chambers damping distributed drag gravity loads points routing tendons "
    "wrench",
    "pisplit.models.rod.equations": "balance variational residuals tangent linear held:prestressed",
    "pisplit.models.rod.statics": "continuation boundary inverse",
    "pisplit.models.rod.dynamics": "stepper trajectory",
    "pisplit.models.rod.analysis": "coordinates energy modes fields cost",
    "pisplit.models.rod.output": "compiled codegen pictures",
}


def _places() -> dict[str, str]:
    """New place by old place."""
    found = {}
    for room, items in _ROOMS.items():
        parent = room.rpartition(".")[0]
        for item in items.split():
            old, _, new = item.partition(":")
            found[f"{parent}.{old}"] = f"{room}.{new or old}"
    return found


class _Moved(MetaPathFinder, Loader):
    """Finds a module under its old path and gives the one at the new path."""

    places = _places()

    def __init__(self) -> None:
        self._own: dict[str, ModuleSpec | None] = {}

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return ModuleSpec(fullname, self) if fullname in self.places else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        new = self.places[spec.name]
        warnings.warn(f"{spec.name} is now {new}", DeprecationWarning, stacklevel=2)
        module = importlib.import_module(new)
        self._own[new] = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """The module has been executed at its own place, whose spec stays its own."""
        module.__spec__ = self._own.pop(module.__name__)


def follow() -> None:
    """Make the old paths importable; they are looked up where nothing else is found."""
    if not any(isinstance(finder, _Moved) for finder in sys.meta_path):
        sys.meta_path.append(_Moved())
