"""Which scene is it? A digest of its equations, so that data of one scene are not taken for those of another."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

import casadi as ca
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from pisplit.models.rod.scene.scene import Scene

#: Functions of CasADi whose content it does not know: code in libraries, and Python.
OPAQUE = ("External", "CallbackInternal")


def fingerprint(scene: Scene, stations: int | ArrayLike = 6) -> str:
    """Digest (32 hexadecimal digits) of all that decides how a scene rests, moves and is measured.

    It is taken from the equations, not from how the scene was written: the balance at rest and in motion and the fields
    at ``stations``, each serialised with every number in it, and what else a motion depends on (names and sizes of the
    inputs, nodes, strain set, tolerances, limits of the inputs). Two scenes that move differently differ, by whatever
    closure, array or class they were made; the same scene made twice, pickled, or made in another process agrees.
    Numbers count to the last bit.

    Args:
        scene: the scene; its terms may be of any class.
        stations: number of stations, or their arclengths (S,) in m, of the fields.

    Raises ValueError where a term calls a function that CasADi cannot look into (a compiled library, a callback).
    """
    xi, u, rest = scene.static_balance
    x, x_t, x_tt, v, moving = scene.dynamic_balance
    fields = scene.field_map(stations)
    parts = [
        ca.Function("rest", [xi, u], [rest.residual]),
        ca.Function("motion", [x, x_t, x_tt, v], [moving.residual]),
        ca.Function("fields", *fields.expression, {"cse": True}),
    ]
    seen = hashlib.sha256(json.dumps(_about(scene, fields.points), sort_keys=True).encode())
    for part in parts:
        seen.update(_serialised(part).encode())
    return seen.hexdigest()[:32]


def _about(scene: Scene, points: tuple[float, ...]) -> dict[str, object]:
    """What trajectories depend on beside the equations; floats are written so that they read back the same."""
    branches = {"branches": [(b.fraction, b.time) for b in scene.branches]} if scene.branches else {}
    return {
        **branches,
        "strains": scene.rod.strain_set.free,
        "balance": scene.balance_type.__name__,
        "nodes": scene.element_nodes,
        "inputs": [(i.name, i.size) for i in scene.inputs],
        "limits": {name: pull.identity for name, pull in scene.pulls.items()},
        "rates": scene.rod.natural_rates,
        "nominal": [scene.nominal_strains.tolist(), scene.nominal_residual.tolist(), scene.rest_coordinates.tolist()],
        "damped": scene.damped,
        "points": points,
    }


def _serialised(function: ca.Function) -> str:
    for inner in (function, *function.find_functions()):
        if inner.class_name() in OPAQUE:
            raise ValueError(
                f"the scene calls {inner.name()!r}, code that CasADi cannot look into, so that its data could not be "
                "told from those of other scenes; write the term in CasADi operations"
            )
    text: str = function.serialize()
    return text
