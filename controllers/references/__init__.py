"""Reference trajectories of tracked outputs: curves, set-points, paths along corners and letters, reachable targets."""

from pisplit.controllers.references.curves import (
    PLANES,
    TIME_TOLERANCE,
    Reference,
    circle,
    constant,
    from_array,
    minimum_jerk,
    sequence,
    setpoint,
    waypoints,
)
from pisplit.controllers.references.lettering import lettering, svg_points
from pisplit.controllers.references.paths import along, rounded, square
from pisplit.controllers.references.targets import random_targets

__all__ = [
    "PLANES",
    "TIME_TOLERANCE",
    "Reference",
    "along",
    "circle",
    "constant",
    "from_array",
    "lettering",
    "minimum_jerk",
    "random_targets",
    "rounded",
    "sequence",
    "setpoint",
    "square",
    "svg_points",
    "waypoints",
]
