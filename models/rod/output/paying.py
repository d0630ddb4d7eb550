"""When machine code pays for a run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import casadi as ca
import numpy as np

#: What ``compiled`` arguments may be.
Compiled = bool | Literal["auto"]
#: Evaluations of a Jacobian by the virtual machine in the time that compiling it takes, with its residual: 18,000 to
#: 32,000 for planar, Kirchhoff and Cosserat scenes of 6 to 24 strains (``benchmark_scenes.py --compiled``), on any
#: machine about. Machine code then takes a twentieth of the time.
COMPILING = 30_000
#: The same in the time that it takes to look whether the machine code is there already.
LOOKING = 5_000
#: Evaluations of a Jacobian, or what costs as much, by a large checked step, by IDAS over one, and by an equilibrium.
STEP, IDAS_STEP, EQUILIBRIUM = 4.0, 15.0, 6.0
#: The same of a large checked step where friction turns round, which many smaller ones follow: 7 s of CPU for 200 steps
#: of an arm with eight disks by the virtual machine, 0.6 s by machine code, 67 s to make that.
RUBBING_STEP = 14.0


def checked_compiled(compiled: Compiled) -> Compiled:
    """``compiled`` if it is what it may be, whether or not anything depends on it.

    Args:
        compiled: True, False or "auto".

    Raises ValueError for anything else.
    """
    if isinstance(compiled, str) and compiled == "auto":
        return "auto"
    if not isinstance(compiled, bool | np.bool_):
        raise ValueError(f"compiled = {compiled!r:.60}; expected True, False or 'auto'")
    return bool(compiled)


def pays(compiled: Compiled, jacobians: float, functions: Callable[[], Sequence[ca.Function]]) -> bool:
    """Whether a run is faster with machine code, what it takes to make it included.

    Args:
        compiled: True or False decide; with "auto" it does where the run is long, or where the machine code is there
            and the run not very short; never without a compiler.
        jacobians: evaluations of a Jacobian that one core makes in the run, about.
        functions: what would be compiled.

    Raises ValueError for another ``compiled``.
    """
    wanted = checked_compiled(compiled)
    if wanted != "auto":
        return wanted
    if jacobians < LOOKING:
        return False
    from pisplit.models.rod.output.compiled import NoMachineCode, compiler, kept  # slow to load

    try:
        compiler()
        return jacobians >= COMPILING or kept(functions())
    except NoMachineCode:
        return False
