"""Linear models of others, from scipy.signal and python-control, as a model that roll-outs and MPC take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pisplit.checks import finite_array, positive
from pisplit.data.columns import default_names, labels
from pisplit.lifted.model import LiftedModel

Array = NDArray[np.float64]


def from_state_space(
    system: Any,
    dt: float | None = None,
    state_names: Sequence[str] | None = None,
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    state_range: ArrayLike | None = None,
) -> LiftedModel:
    """x+ = A x + B u, y = C x as a :class:`LiftedModel`: for MPC, roll-outs, modes, exports.

    Its states are x (n,) and, where C is not the identity, the outputs y (p,) after them, as the group "outputs": MPC
    tracks them by ``track="outputs"``.

    Args:
        system: ``scipy.signal.StateSpace`` (or ``lti``, ``dlti``), ``control.StateSpace``, or a tuple (A, B, C) or
            (A, B, C, D) of arrays (n, n), (n, m), (p, n), (p, m). Continuous ones are sampled, inputs held over a step.
        dt: time step in s; needed for continuous systems and for tuples, which are in discrete time.
        state_names: (n,); those of python-control, or x1, x2, ...
        input_names: (m,); those of python-control, or u1, u2, ...
        output_names: (p,); those of python-control, or y1, y2, ...
        state_range: magnitudes in use of the states and the outputs after them, (n,) or (n + p,) in their units; MPC
            weighs by them, and roll-outs that leave 1000 times these have diverged. Ones if not given.

    Raises ValueError for a system of another kind, a step that is missing or another one than the system's, inputs that
    act on outputs at once (D), and shapes that do not fit.
    """
    a, b, c, d, step, names = _parts(system)
    a, b = finite_array(a, "A", (len(a), len(a))), finite_array(b, "B", (len(a), None))
    c, d = finite_array(c, "C", (None, len(a))), finite_array(d, "D", (len(c), b.shape[1]))
    if d.any():
        raise ValueError("D is not zero: inputs that act on outputs at once are no part of these models; add a state")
    if step == 0.0:
        from scipy.signal import cont2discrete

        step = positive(dt, "dt", "s") if dt is not None else 0.0
        if step == 0.0:
            raise ValueError("the system is in continuous time; give dt, the time step in s")
        a, b = cont2discrete((a, b, c, d), step)[:2]
    elif step is None or dt is not None:
        if dt is None:
            raise ValueError("the system has no time step; give dt in s")
        if step is not None and not np.isclose(step, positive(dt, "dt", "s"), rtol=1e-9, atol=0.0):
            raise ValueError(f"dt = {dt} s, but the system has steps of {step} s")
        step = positive(dt, "dt", "s")
    n, m = b.shape
    states = labels(state_names, "state_names", names[0] or default_names("states", n))
    inputs = labels(input_names, "input_names", names[1] or default_names("inputs", m))
    outputs = labels(output_names, "output_names", names[2] or tuple(f"y{i + 1}" for i in range(len(c))))
    whole = c.shape == (n, n) and np.array_equal(c, np.eye(n))
    read = np.eye(n) if whole else np.vstack([np.eye(n), c])
    seen = tuple(states) if whole else (*states, *outputs)
    if len(set(seen)) != len(seen):
        raise ValueError(
            f"states and outputs share the name {next(s for s in seen if seen.count(s) > 1)!r}; rename one"
        )
    x, past, u = ca.SX.sym("x", len(seen), 1), ca.SX.sym("past", m, 0), ca.SX.sym("u", m)
    return LiftedModel(
        A=a,
        B=b,
        c=np.zeros(n),
        C=read,
        d=np.zeros(len(seen)),
        dt=float(step),
        lift_function=ca.Function("lift", [x, past], [x[:n, 0]]),
        input_function=ca.Function("input", [u], [u]),
        n_delays=0,
        state_names=seen,
        input_names=tuple(inputs),
        column_names=tuple(states),
        feature_names=tuple(inputs),
        input_offset=np.zeros(m),
        input_basis=np.eye(m),
        state_range=_magnitudes(state_range, len(seen)),
        outputs={} if whole else {"outputs": tuple(range(n, len(seen)))},
        provenance={"kind": "state space", "from": type(system).__module__.split(".")[0]},
    )


def _magnitudes(given: ArrayLike | None, size: int) -> Array:
    """``given`` (size,) above zero, or ones."""
    found = np.ones(size) if given is None else finite_array(given, "state_range", (size,))
    if (found <= 0.0).any():
        raise ValueError(f"state_range has {found.min():g}; expected magnitudes above zero")
    return found


def _parts(system: Any) -> tuple[Any, Any, Any, Any, float | None, tuple[Any, Any, Any]]:
    """A, B, C, D, step in s (0: continuous, None: unknown) and names of states, inputs, outputs where there are any."""
    if isinstance(system, tuple) and len(system) in (3, 4):
        a, b, c = (np.atleast_2d(np.asarray(v, dtype=np.float64)) for v in system[:3])
        d = np.atleast_2d(system[3]) if len(system) == 4 else np.zeros((len(c), b.shape[1]))
        return a, b, c, d, None, (None, None, None)
    if hasattr(system, "to_ss") and not hasattr(system, "A"):
        system = system.to_ss()
    if not all(hasattr(system, name) for name in "ABCD"):
        raise ValueError(f"system is a {type(system).__name__}; expected a StateSpace or a tuple (A, B, C)")
    named = tuple(getattr(system, f"{kind}_labels", None) for kind in ("state", "input", "output"))
    step = getattr(system, "dt", None)
    if step is True:
        step = None
    elif step is None:  # scipy's continuous systems have None, python-control's may stand for both
        step = 0.0
    return system.A, system.B, system.C, system.D, step, (named[0], named[1], named[2])
