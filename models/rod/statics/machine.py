"""Equilibria of many rows by machine code, where that pays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pisplit.models.rod.output.paying import EQUILIBRIUM, Compiled, pays

if TYPE_CHECKING:
    from pisplit.models.rod.statics.statics import Statics


def by_machine(statics: Statics, compiled: Compiled, rows: float) -> Statics:
    """What solves for equilibria: ``statics``, or the same by machine code, which is made here if it is not there.

    Args:
        statics: of the virtual machine; that of a compiled scene is what it is.
        compiled: see ``pays``.
        rows: number of equilibria that one core solves for.
    """
    from pisplit.models.rod.output.compiled import CompiledScene  # slow to load, and of no use to a few

    if isinstance(statics.scene, CompiledScene):
        return statics

    def twin() -> Statics:
        if "_by_machine" not in statics.__dict__:
            statics.__dict__["_by_machine"] = CompiledScene.of(statics.scene).statics()
        found: Statics = statics.__dict__["_by_machine"]
        return found

    if not pays(compiled, EQUILIBRIUM * rows, lambda: [twin().residual_function]):
        return statics
    twin().scene.native(twin().residual_function)
    return twin()
