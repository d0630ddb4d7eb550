"""A scene as one C file for a controller board: residual, Jacobian, fields and a step of fixed cost."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from textwrap import dedent, indent
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pisplit.checks import count, positive
from pisplit.files import write_text
from pisplit.models.rod.analysis.fields import LAYOUT, UNITS

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Diagonal of the two-stage, second-order, L-stable SDIRK scheme (Alexander, SIAM J. Numer. Anal. 1977).
GAMMA = 1.0 - np.sqrt(0.5)
#: Newton iterations of every stage: the balance is linear in the accelerations, and nearly so over a short step.
NEWTON_ITERATIONS = 2


@dataclass(frozen=True)
class Exported:
    """The two files of an export: C source and its header."""

    source: Path
    header: Path


@dataclass(frozen=True)
class _Argument:
    name: str
    size: int
    meaning: str


@dataclass(frozen=True)
class _Entry:
    """One exported function: what it computes, its CasADi function, and its arguments with units."""

    name: str
    summary: str
    function: ca.Function
    inputs: tuple[_Argument, ...]
    outputs: tuple[_Argument, ...]

    def prototype(self, prefix: str) -> str:
        given = [f"const double {a.name}[{a.size}]" for a in self.inputs if a.size]
        written = [f"double {a.name}[{a.size}]" for a in self.outputs]
        return f"int {prefix}_{self.name}({', '.join(given + written)})"

    def declaration(self, prefix: str) -> str:
        """Comment and prototype for the header."""
        lines = [self.summary, ""]
        for heading, arguments in (("in", self.inputs), ("out", self.outputs)):
            lines += [f"  {heading:<4}{a.name}[{a.size}]  {a.meaning}" for a in arguments if a.size]
        body = "\n".join(f" * {line}".rstrip() for line in lines)
        return f"/*\n{body}\n */\n{self.prototype(prefix)};\n"

    def definition(self, prefix: str) -> str:
        """Plain C function around the generated one, with its own static workspace."""
        f = self.function
        arg = ", ".join(a.name if a.size else "0" for a in self.inputs)
        res = ", ".join(a.name for a in self.outputs)
        return dedent(f"""\
            {self.prototype(prefix)} {{
              static casadi_int iw[{max(1, f.sz_iw())}];
              static casadi_real w[{max(1, f.sz_w())}];
              const casadi_real* arg[{f.sz_arg()}] = {{{arg}}};
              casadi_real* res[{f.sz_res()}] = {{{res}}};
              return {f.name()}(arg, res, iw, w, 0);
            }}
            """)


def board_step(scene: Scene, dt: float, substeps: int) -> ca.Function:
    """``(x, u) -> (x_next, residual)`` of ``scene`` over ``dt`` in s by ``substeps`` L-stable second-order steps.

    Inputs move linearly from those in ``x`` to ``u``. Every stage takes the same number of Newton iterations, so that a
    step always costs the same; ``residual`` is the largest one left in any stage, in parts of EI/L.
    """
    n, m, h = scene.n_strains, scene.n_inputs, dt / substeps
    balance, layout = scene.motion_residual, scene.layout
    jacobian, e = balance.jacobian(), layout.n_overstress
    sizes = {"xi": n, "rate": n, "hidden": e, "guess": n, "u": m}
    xi, rate, hidden, guess, u = (ca.MX.sym(name, size) for name, size in sizes.items())
    fractions, relaxing = (ca.DM(values) for values in scene.relaxation)

    # One stage: strains xi + gamma h v, rates v = rate + gamma h a and overstress that balance with accelerations a.
    def overstress(v: ca.MX) -> ca.MX:
        return (hidden + GAMMA * h * fractions * ca.repmat(v[: layout.n_free], layout.n_branches, 1)) / (
            1.0 + GAMMA * h * relaxing
        )

    a = guess
    for _ in range(NEWTON_ITERATIONS):
        v = rate + GAMMA * h * a
        point = (xi + GAMMA * h * v, v, a, ca.vertcat(overstress(v), u))
        d_xi, d_rate, d_a, d_acting = jacobian(*point, ca.DM(n, 1))
        for k in range(layout.n_branches):
            of_rates = GAMMA * h * scene.branches[k].fraction / (1.0 + GAMMA * h / scene.branches[k].time)
            free = layout.n_free
            through = ca.horzcat(d_acting[:, k * free : (k + 1) * free], ca.DM(n, layout.n_joint))
            d_rate = d_rate + of_rates * through
        matrix = ca.densify((GAMMA * h) ** 2 * d_xi + GAMMA * h * d_rate + d_a)
        a = a - ca.solve(matrix, balance(*point), "qr", {"eps": 1e-30})
    v = rate + GAMMA * h * a
    shape, sigma = xi + GAMMA * h * v, overstress(v)
    left = ca.norm_inf(balance(shape, v, a, ca.vertcat(sigma, u)))
    stage = ca.Function("stage", [xi, rate, hidden, guess, u], [shape, v, sigma, a, left], {"never_inline": True})

    x, command = ca.MX.sym("x", scene.n_states), ca.MX.sym("u", m)
    strains, rates, sigma, start = layout.split(x)
    a, worst = ca.MX.zeros(n), ca.MX(0.0)
    for k in range(substeps):
        at = [start + (command - start) * (k + c) / substeps for c in (GAMMA, 1.0)]
        _, v_1, s_1, a_1, left_1 = stage(strains, rates, sigma, a, at[0])
        strains = strains + (1.0 - GAMMA) * h * v_1
        sigma = sigma + (1.0 - GAMMA) * h * scene.overstress_rates(v_1, s_1)
        strains, rates, sigma, a, left_2 = stage(strains, rates + (1.0 - GAMMA) * h * a_1, sigma, a_1, at[1])
        worst = ca.fmax(worst, ca.fmax(left_1, left_2))
    x_next = ca.vertcat(strains, rates, sigma, command)
    return ca.Function("step", [x, command], [x_next, worst], ["x", "u"], ["x_next", "residual"])


def codegen(scene: Scene, path: str | Path, dt: float, substeps: int = 8, stations: int = 6) -> Exported:
    """Write a scene as C99 that needs nothing but ``math.h``: ``path`` and a documented header beside it.

    Args:
        scene: what to export.
        path: file name ending in ``.c``; its stem prefixes every symbol.
        dt: control interval in s of the exported step.
        substeps: steps of the fixed-cost scheme in one interval.
        stations: stations of the exported fields.

    The scheme is of second order: on the paper's arm, 30 ms in 4 / 8 / 16 substeps are within 8e-4 / 2e-4 / 7e-5 L.

    Raises ValueError when the name is no C identifier or an argument is out of range, RuntimeError when the scene has
    no rest position.
    """
    source = Path(path)
    prefix = source.stem
    if source.suffix != ".c" or not (prefix.isidentifier() and prefix.isascii()):
        raise ValueError(f"codegen path = {source.name!r}; expected a C identifier with the ending .c, such as 'arm.c'")
    positive(dt, "codegen dt", "s")
    count(substeps, "codegen substeps")
    entries = _entries(scene, prefix, dt, substeps, stations)
    generator = ca.CodeGenerator(prefix)
    for entry in entries:
        generator.add(entry.function)
    header = source.with_suffix(".h")
    body = "\n".join(entry.definition(prefix) for entry in entries)
    write_text(
        source, f'{generator.dump()}\n#include "{header.name}"\n\n{_rest(scene, prefix)}\n{body}', make_folders=True
    )
    write_text(header, _header(scene, prefix, entries, dt, substeps), make_folders=True)
    return Exported(source, header)


def _entries(scene: Scene, prefix: str, dt: float, substeps: int, stations: int) -> list[_Entry]:
    n, m = scene.n_strains, scene.n_inputs
    hidden = scene.layout.n_overstress
    state = _Argument("x", scene.n_states, "state [xi, xi_t, sigma, u]" if hidden else "state [xi, xi_t, u]")
    command = _Argument("u", m, f"inputs: {', '.join(scene.input_names) or 'none'}")
    motion = (
        _Argument("xi", n, "strains: 1/m for bending and torsion, 1 for shear and stretch; node by node"),
        _Argument("xi_t", n, "their rates per s"),
        _Argument("xi_tt", n, "their accelerations per s^2"),
        *([_Argument("sigma", hidden, "overstress of the Maxwell branches, each as xi")] if hidden else []),
        command,
    )
    residual = _Argument("residual", n, "balance of every strain in parts of EI/L (forces: EI/L^2)")
    blocks = tuple(
        _Argument(f"d_{a.name}", n * a.size, f"d residual / d {a.name}, {n} x {a.size}, column by column")
        for a in motion[:3]
    )
    symbols = [ca.MX.sym(a.name, a.size) for a in motion]
    point = [*symbols[:3], ca.vertcat(*symbols[3:])]
    balance, fields = scene.motion_residual, scene.field_map(stations)
    layout = ", ".join(f"{name} ({size}, {UNITS[name]})" for name, size in LAYOUT)

    def made(name: str, inputs: list[ca.MX], outputs: list[ca.MX]) -> ca.Function:
        return ca.Function(f"{prefix}_generated_{name}", inputs, [ca.densify(y) for y in outputs])

    x, u = ca.MX.sym("x", scene.n_states), ca.MX.sym("u", m)
    return [
        _Entry(
            "step",
            f"The state {dt:g} s later; the inputs move linearly to u. {substeps} steps, each of two implicit stages.",
            made("step", [x, u], list(board_step(scene, dt, substeps)(x, u))),
            (state, command),
            (
                _Argument("x_next", scene.n_states, "state after the step; must not be x itself"),
                _Argument("left", 1, "largest residual left in a stage (EI/L); above 0.01 take more substeps"),
            ),
        ),
        _Entry(
            "residual",
            "Balance of forces and moments.",
            made("residual", symbols, [balance(*point)]),
            motion,
            (residual,),
        ),
        _Entry(
            "jacobian",
            "Derivatives of the residual; inertia forces count as dead loads in d_xi and d_xi_t.",
            made("jacobian", symbols, list(balance.jacobian()(*point, ca.DM(n, 1)))[:3]),
            motion,
            blocks,
        ),
        _Entry(
            "fields",
            f"Fields at {len(fields.points)} stations: " + ", ".join(f"{s:.6g}" for s in fields.points) + " m.",
            made("fields", [x], [fields.function(x)]),
            (state,),
            (
                _Argument(
                    "y", len(fields.names), f"station by station: {layout}; R row by row, v w q omega in body axes"
                ),
            ),
        ),
    ]


def _rest(scene: Scene, prefix: str) -> str:
    """The state at rest under zero inputs as a constant: where a controller starts."""
    equilibrium = scene.statics().solve()
    if not equilibrium.success:
        raise RuntimeError(f"no rest position to export: {equilibrium.message}")
    values = ",\n".join(f"  {value!r}" for value in equilibrium.state.tolist())
    return f"const double {prefix}_rest[{scene.n_states}] = {{\n{values}\n}};\n"


def _header(scene: Scene, prefix: str, entries: list[_Entry], dt: float, substeps: int) -> str:
    upper = prefix.upper()
    memory = sum(8 * (e.function.sz_w() + e.function.sz_iw()) for e in entries)
    about = indent(str(scene), " *   ")
    parts = [
        f"/*\n * {prefix}: a rod scene in plain C99. Build {prefix}.c with any C compiler and -lm.\n *\n{about}\n *\n"
        f" * All numbers are doubles in SI units. Functions return 0 on success, allocate nothing, and keep\n"
        f" * {memory} bytes of static workspace: each is for one thread at a time. Arrays must not overlap.\n */",
        f"#ifndef {upper}_H\n#define {upper}_H\n",
        f"#define {upper}_N_STATES {scene.n_states}\n#define {upper}_N_STRAINS {scene.n_strains}\n"
        f"#define {upper}_N_INPUTS {scene.n_inputs}\n#define {upper}_DT {dt!r}\n#define {upper}_SUBSTEPS {substeps}\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        f"/* State at rest under zero inputs. */\nextern const double {prefix}_rest[{scene.n_states}];\n",
        *[entry.declaration(prefix) for entry in entries],
        "#ifdef __cplusplus\n}\n#endif\n#endif\n",
    ]
    return "\n".join(parts)
