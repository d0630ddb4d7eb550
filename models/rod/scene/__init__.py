"""The scene: what it consists of, its equations, what can be had of it, and by what it is told from others."""

from pisplit.models.rod.scene.identity import fingerprint
from pisplit.models.rod.scene.scene import Scene

__all__ = ["Scene", "fingerprint"]
