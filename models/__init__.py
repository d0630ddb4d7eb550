"""Physical models: control systems with a known and an unknown part, rods, arms."""

from pisplit.models.control_system import ControlSystem

__all__ = [
    "ControlSystem",
]
