"""The same ramped tip load on a clamped rod in three codes: this package, PyElastica, a method of lines in numpy."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.sparse import csr_matrix

from pisplit.models import rod

Array = NDArray[np.float64]

#: Shear correction of PyElastica, used by all.
SHEAR_FACTOR = 27.0 / 28.0


@dataclass(frozen=True)
class Case:
    """A rod along +z, clamped at the origin, under a dead tip force along +x that grows linearly and then stays.

    Attributes:
        young, radius, length, density: in Pa, m, m, kg/m^3; the shear modulus is E / 3.
        load: F L^2 / EI of the full force.
        ramp, span: duration of ramp and simulation in s.
        outputs: number of times at which the tip is compared.
        damping: rate in 1/s of a drag proportional to mass.
    """

    name: str
    young: float
    radius: float
    length: float
    density: float
    load: float
    ramp: float
    span: float
    outputs: int
    damping: float

    @property
    def area(self) -> float:
        return np.pi * self.radius**2

    @property
    def bending(self) -> float:
        """EI in N m^2."""
        return self.young * np.pi * self.radius**4 / 4.0

    @property
    def shear_modulus(self) -> float:
        return self.young / 3.0

    @property
    def force(self) -> float:
        return self.load * self.bending / self.length**2

    @property
    def times(self) -> Array:
        return self.span * np.arange(1, self.outputs + 1) / self.outputs

    def force_at(self, t: float) -> float:
        return self.force * min(1.0, t / self.ramp)


SOFT = Case("soft", 1e6, 1e-2, 0.4, 1000.0, load=2.0, ramp=0.6, span=1.2, outputs=24, damping=1.0)
STEEL = Case("steel", 207e9, 1e-3, 0.4, 8000.0, load=2.0, ramp=0.03, span=0.06, outputs=24, damping=20.0)


@dataclass(frozen=True)
class Run:
    """Tip (outputs, 3) in m, CPU seconds (of several rounds their median, and the least), and what was run."""

    code: str
    setting: str
    tip: Array = field(repr=False)
    seconds: float
    success: bool = True
    note: str = ""
    least: float = 0.0


@cache
def scene_of(case: Case, strains: str, nodes: int, compiled: bool = False) -> rod.Scene:
    """The case as a scene; kept, so that settings of the integrator share its functions."""
    if compiled:
        return scene_of(case, strains, nodes).compile(stations=1)
    material = rod.Elastic(case.young, case.shear_modulus, case.density)
    return rod.Scene(
        rod.Rod(case.length, rod.Circle(case.radius, shear_factor=SHEAR_FACTOR), material, strains),
        rod.LinearDrag(case.damping * case.density * case.area),
        rod.TipWrench(force=rod.Input("force", 3)),
        nodes=nodes,
    )


def run_idas(case: Case, strains: str, nodes: int, rtol: float, compiled: bool = False, balance: str = "auto") -> Run:
    """IDAS over the whole span in one call."""
    notes = (", direct" if balance == "direct" else "") + (", compiled" if compiled else "")
    mover = _idas(case, strains, nodes, rtol, compiled, balance)
    return _timed(case, mover, f"pisplit IDAS{notes}", f"K={nodes}, rtol {rtol:.0e}")


def run_gauss(case: Case, strains: str, nodes: int, stages: int, substeps: int, compiled: bool = False) -> Run:
    """Equal Gauss steps, ``substeps`` of them between outputs."""
    label = f"K={nodes}, order {2 * stages}, step {1e3 * case.span / case.outputs / substeps:.3g} ms"
    mover = _gauss(case, strains, nodes, stages, substeps, compiled)
    return _timed(case, mover, f"pisplit Gauss{', compiled' if compiled else ''}", label)


def run_large(case: Case, strains: str, nodes: int, stages: int, substeps: int, compiled: bool = False) -> Run:
    """Large checked Radau steps, ``substeps`` of them between outputs."""
    label = f"K={nodes}, order {2 * stages - 1}, step {1e3 * case.span / case.outputs / substeps:.3g} ms"
    mover = _large(case, strains, nodes, stages, substeps, compiled)
    notes = (", plane" if strains.startswith("planar") else "") + (", compiled" if compiled else "")
    return _timed(case, mover, f"pisplit large steps{notes}", label)


# What moves a case is kept: rounds and settings share its functions.


@cache
def _idas(case: Case, strains: str, nodes: int, rtol: float, compiled: bool, balance: str) -> Any:
    scene = scene_of(case, strains, nodes, compiled)
    return scene.simulator(case.span / case.outputs, rtol=rtol, balance=balance)


@cache
def _gauss(case: Case, strains: str, nodes: int, stages: int, substeps: int, compiled: bool) -> Any:
    scene, dt = scene_of(case, strains, nodes, compiled), case.span / case.outputs
    return scene.stepper(dt, step=dt / substeps, stages=stages, tolerance=1e-6)


@cache
def _large(case: Case, strains: str, nodes: int, stages: int, substeps: int, compiled: bool) -> Any:
    scene, dt = scene_of(case, strains, nodes, compiled), case.span / case.outputs
    return scene.fast_stepper(dt, step=dt / substeps, stages=stages, accuracy=1e-3)


def _timed(case: Case, moving: Any, code: str, setting: str) -> Run:
    """The case from rest, once warm."""
    scene = moving.scene
    commands = np.array([[case.force_at(t), 0.0, 0.0] for t in case.times])
    rest = np.concatenate([scene.rest_coordinates, np.zeros(scene.n_strains + 3)])
    moving.run(commands, rest, check=False)
    before = time.process_time()
    found = moving.run(commands, rest, check=False)
    seconds = time.process_time() - before
    tip = np.full((case.outputs, 3), np.nan)
    tip[: len(found.t) - 1] = found.fields(1)[1:, 0, :3]
    return Run(code, setting, tip, seconds, found.success)


def run_elastica(case: Case, elements: int, outputs: int | None = None) -> Run:
    """PyElastica with its largest stable step and its clamp moved by half an element.

    With fewer ``outputs`` than the case it stops there, and its time is scaled up to the whole span.

    Its clamp holds node 0 and the frame of element 0, whose centre is half an element up: a rod of n elements is too
    short by half an element. Here it starts half an element below the origin and is that much longer.
    """
    import elastica as ea

    class System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.Damping):
        pass

    step = case.length / (elements - 0.5)
    wave = np.sqrt(case.young / case.density)
    fastest = np.hypot(2.0 / case.radius * np.sqrt(SHEAR_FACTOR * case.shear_modulus / case.density), 2.0 * wave / step)
    every = case.span / case.outputs
    per_output = int(np.ceil(every / (1.6 / fastest)))
    dt = every / per_output
    system = System()
    body = ea.CosseratRod.straight_rod(
        elements,
        np.array([0.0, 0.0, -0.5 * step]),
        np.array([0.0, 0.0, 1.0]),
        np.array([0.0, 1.0, 0.0]),
        step * elements,
        case.radius,
        case.density,
        youngs_modulus=case.young,
        shear_modulus=case.shear_modulus,
    )
    system.append(body)
    system.constrain(body).using(ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,))
    force = np.array([case.force, 0.0, 0.0])
    system.add_forcing_to(body).using(ea.EndpointForces, np.zeros(3), force, ramp_up_time=case.ramp)
    system.dampen(body).using(ea.AnalyticalLinearDamper, uniform_damping_constant=case.damping, time_step=dt)
    system.finalize()
    stepper = ea.PositionVerlet()
    _warm_up_elastica()
    tips, seconds, now = [], 0.0, 0.0
    for _ in range(case.outputs if outputs is None else outputs):
        before = time.process_time()
        for _ in range(per_output):
            now = stepper.step(system, now, dt)
        seconds += time.process_time() - before
        tips.append(body.position_collection[:, -1].copy())
    tip = np.array(tips)
    label = f"n={elements}, dt {dt:.1e} s"
    seconds *= case.outputs / len(tip)
    note = "  time scaled up from a shorter span" if len(tip) < case.outputs else ""
    return Run("PyElastica", label, tip, seconds, bool(np.all(np.isfinite(tip))), note)


_WARM: list[bool] = []


def _warm_up_elastica() -> None:
    """Compile the kernels of numba before the clock runs."""
    if not _WARM:
        _WARM.append(True)
        run_elastica(Case("warm", 1e6, 1e-2, 0.4, 1000.0, 1.0, 0.01, 0.02, 2, 1.0), 5)


def run_lines(case: Case, elements: int, rtol: float, patience: float = 20.0) -> Run:
    """Method of lines of the plane rod with shear and stretch in numpy, stepped by BDF of scipy.

    A run that takes longer than ``patience`` seconds of CPU time is given up: ``success`` is False.

    Nodes carry positions, elements carry angles; the clamp acts at the base itself, half an element below the first
    angle. The Jacobian is that of scipy: finite differences over its sparsity.
    """
    h, n = case.length / elements, elements
    mass = np.full(n, case.density * case.area * h)
    mass[-1] *= 0.5
    inertia = case.density * case.area * case.radius**2 / 4.0 * h
    shear = SHEAR_FACTOR * case.shear_modulus * case.area
    stretch = case.young * case.area

    def rate(t: float, y: Array) -> Array:
        if time.process_time() - before > patience:
            raise TimeoutError(f"reached {t:.2g} of {case.span:g} s in {patience:g} s")
        x, z, angle, vx, vz, spin = y.reshape(n, 6).T
        dx, dz = np.diff(x, prepend=0.0) / h, np.diff(z, prepend=0.0) / h
        c, s = np.cos(angle), np.sin(angle)
        across, along = shear * (c * dx - s * dz), stretch * (s * dx + c * dz - 1.0)
        fx, fz = c * across + s * along, c * along - s * across
        tip_x = np.append(fx[1:], case.force_at(t))
        tip_z = np.append(fz[1:], 0.0)
        bend = np.diff(angle, prepend=0.0) * case.bending / h
        bend[0] *= 2.0
        turn = np.append(bend[1:], 0.0) - bend + h * (dz * fx - dx * fz)
        parts = [vx, vz, spin, (tip_x - fx) / mass, (tip_z - fz) / mass, turn / inertia]
        parts[3] = parts[3] - case.damping * vx
        parts[4] = parts[4] - case.damping * vz
        return np.stack(parts, axis=1).ravel()

    start = np.zeros((n, 6))
    start[:, 1] = h * np.arange(1, n + 1)
    band = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) <= 1
    pattern = csr_matrix(np.kron(band, np.ones((6, 6))))
    scale = rtol * np.tile([case.length, case.length, 1.0, *np.array([case.length, case.length, 1.0]) / case.ramp], n)
    before = time.process_time()
    code, setting, tip = "numpy + scipy BDF, plane", f"n={n}, rtol {rtol:.0e}", np.full((case.outputs, 3), np.nan)
    options = {"rtol": rtol, "atol": scale, "jac_sparsity": pattern}
    try:
        found = solve_ivp(rate, (0.0, case.span), start.ravel(), "BDF", case.times, **options)
    except TimeoutError as reason:
        return Run(code, setting, tip, time.process_time() - before, False, note=f"  not finished: {reason}")
    seconds = time.process_time() - before
    ends = found.y.T.reshape(-1, n, 6)[:, -1]
    tip[: len(ends)] = np.stack([ends[:, 0], np.zeros(len(ends)), ends[:, 1]], axis=1)
    return Run(code, setting, tip, seconds, bool(found.success))


def error(run: Run, reference: Run) -> float:
    """Largest distance of tips over the outputs both have, in parts of the largest travel of the reference tip."""
    n = len(run.tip)
    travel = np.linalg.norm(reference.tip[:n] - [0.0, 0.0, float(reference.tip[0, 2])], axis=1).max()
    return float(np.linalg.norm(run.tip - reference.tip[:n], axis=1).max() / travel) if run.success else float("inf")


def run_reference(case: Case, strains: str, nodes: int, rtol: float) -> Run:
    """The scene stepped by Radau IIA of order 5 (scipy) with exact Jacobians: nothing of IDAS is in it."""
    scene = scene_of(case, strains, nodes)
    n = scene.n_strains
    x, u = ca.MX.sym("x", 2 * n), ca.MX.sym("u", 3)
    slope = ca.vertcat(x[n:], scene.acceleration(x[:n], x[n:], u))
    rate = ca.Function("rate", [x, u], [slope])
    jacobian = ca.Function("jacobian", [x, u], [ca.jacobian(slope, x)])
    rest = np.concatenate([scene.rest_coordinates, np.zeros(n)])
    scale = np.concatenate([scene.nominal_strains, scene.nominal_strains * scene.rod.bending_rate])

    def f(t: float, y: Array) -> Array:
        return np.asarray(rate(y, [case.force_at(t), 0.0, 0.0])).ravel()

    def j(t: float, y: Array) -> Array:
        return np.asarray(jacobian(y, [case.force_at(t), 0.0, 0.0]).full())

    before = time.process_time()
    states, y = [], rest
    for start, end in ((0.0, case.ramp), (case.ramp, case.span)):  # the load has a corner at the end of the ramp
        times = case.times[(case.times > start + 1e-12) & (case.times <= end + 1e-12)]
        found = solve_ivp(f, (start, end), y, "Radau", [*times[:-1], end], jac=j, rtol=rtol, atol=rtol * scale)
        states.append(found.y.T)
        y = found.y[:, -1]
    seconds = time.process_time() - before
    whole = np.hstack([np.vstack(states), np.zeros((case.outputs, 3))])
    return Run("Radau", f"K={nodes}, rtol {rtol:.0e}", scene.fields(whole, 1)[:, 0, :3], seconds)
