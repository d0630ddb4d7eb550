"""Arms of several sections, each bent by a group of tendons of its own."""

from __future__ import annotations

from dataclasses import dataclass

from pisplit.checks import count
from pisplit.models import rod
from pisplit.models.arm.base import Arm, paper_scene


@dataclass(frozen=True, init=False)
class MultiSectionArm(Arm):
    """An elastic backbone with several groups of tendons, each of which ends with its section.

    ``MultiSectionArm(sections=2, tendons=3)`` is ready: the backbone of the paper's arm cut into equal sections, each
    group turned against the one before it (:func:`pisplit.models.arm.base.paper_scene`); one section is the paper's
    arm itself. A ``scene`` of one's own has ``rod.Tendons(..., name=..., end=...)`` for every section, base to tip,
    and an element border at every end.

    Args:
        sections: number of sections, 2 when not given.
        tendons: of each of them, 3 when not given; at least 3, which bend a section any way.
        nodes: Gauss nodes of every section, 5 when not given.
        scene: backbone, environment and tendons in place of the ready ones; it tells its sections itself.
        pretension: common displacement in m of all tendons at rest; it keeps them taut.
        amplitude: usual size in m of displacements that bend one section.

    Raises ValueError where the scene has no tendons or other inputs, where ends of groups do not increase, where
    pretension or amplitude are no lengths, and where a scene comes with numbers of the ready one.
    """

    def __init__(
        self,
        sections: int | None = None,
        tendons: int | None = None,
        nodes: int | None = None,
        *,
        scene: rod.Scene | None = None,
        pretension: float = 1e-3,
        amplitude: float = 10e-3,
    ) -> None:
        given = {"sections": sections, "tendons": tendons, "nodes": nodes}
        extra = [name for name, value in given.items() if value is not None]
        if scene is None:
            scene = paper_scene(
                count(2 if sections is None else sections, "MultiSectionArm sections"),
                count(3 if tendons is None else tendons, "MultiSectionArm tendons", 3),
                count(5 if nodes is None else nodes, "MultiSectionArm nodes"),
            )
        elif extra:
            raise ValueError(f"MultiSectionArm has a scene, which tells its sections; leave {', '.join(extra)} out")
        super().__init__(scene, pretension, amplitude)
