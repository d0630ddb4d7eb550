"""Pictures of rods: shapes, buckling, convergence, modes, energy."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from pisplit.models import rod
from pisplit.models.arm import MultiSectionArm
from pisplit.models.rod.output.pictures import plot_arm
from pisplit.models.rod.output.results import hung
from pisplit.pictures.figures import below, new_figure, tidy

STEEL = rod.Elastic(young=207e9, shear=207e9 / 2.6, density=7850.0)


def _strip(*terms: Any, nodes: int = 8, strains: str = "planar") -> rod.Scene:
    """One metre of steel wire of 1 mm radius with ``terms``."""
    return rod.Scene(rod.Rod(1.0, rod.Circle(1e-3), STEEL, strains=strains), *terms, nodes=nodes)


def _stiffness() -> float:
    return float(_strip().rod.stiffness[0])


def elastica() -> Any:
    """A cantilever under dead loads across it, F L^2 / EI = 0 to 10 in steps of 1, on 8 nodes. Crosses: the height
    of the tip for 1, 2, ..., 10 by elliptic integrals (Bisshopp and Drucker 1945).
    """
    from scipy.optimize import brentq
    from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

    scene = _strip(rod.TipWrench(force=rod.Input("f", 3)))
    loads = np.arange(0.0, 11.0)
    found = scene.statics().solve_many(_stiffness() * loads[:, None] * np.array([1.0, 0.0, 0.0]))
    s = np.linspace(0.0, 1.0, 60)
    figure = new_figure(7.0, 5.4)
    axis: Any = figure.subplots()
    for state, load in zip(found.states, loads, strict=True):
        p = scene.fields(state, s)[:, :3]
        axis.plot(p[:, 0], p[:, 2], lw=1.6, color=_viridis(load / 10.0))
    for load in loads[1:]:
        alpha = np.sqrt(load)

        def length(k: float, alpha: float = alpha) -> float:
            return float(ellipk(k**2) - ellipkinc(np.arcsin(1.0 / (np.sqrt(2.0) * k)), k**2) - alpha)

        k = brentq(length, 1.0 / np.sqrt(2.0) + 1e-12, 1.0 - 1e-12)
        first = np.arcsin(1.0 / (np.sqrt(2.0) * k))
        across = 1.0 - 2.0 / alpha * (ellipe(k**2) - ellipeinc(first, k**2))
        along = np.sqrt(2.0) / alpha * np.sqrt(max(0.0, 2.0 * k**2 - 1.0))
        axis.plot(across, along, "kx", ms=7)
    axis.set(xlabel="across (m)", ylabel="along (m)", aspect="equal", title="elastica")
    tidy(axis)
    return figure


def euler_column() -> Any:
    """A column pushed from above beyond Euler's load (P = 1 is pi^2 EI / 4 L^2). Dots: the answers of the statics;
    those that buckled on the way say so (`branch` "snapped", red). Line: the stable branch of the elastica.
    """
    scene = _strip(rod.TipWrench(force=rod.Input("f", 3)))
    critical = np.pi**2 * _stiffness() / 4.0
    load = np.concatenate([np.linspace(0.2, 0.98, 8), np.linspace(1.03, 2.2, 18)])
    found = scene.statics().solve_many(-critical * load[:, None] * np.array([0.0, 0.0, 1.0]))
    tip = np.abs(scene.fields(found.states, 1)[:, 0, 0])
    from scipy.special import ellipk

    half = np.linspace(1e-3, 1.25, 200)  # half the angle of the tip
    p = (2.0 / np.pi * ellipk(np.sin(half) ** 2)) ** 2
    side = 2.0 * np.sin(half) / (np.pi / 2.0 * np.sqrt(p))
    figure = new_figure(7.0, 4.6)
    axis: Any = figure.subplots()
    axis.plot(p, side, "k-", lw=1.0, label="elastica")
    axis.plot([0.0, 1.0], [0.0, 0.0], "k-", lw=1.0)
    snapped = found.branch == "snapped"
    axis.plot(load[~snapped], tip[~snapped], "o", ms=5, label="not buckled on the way")
    axis.plot(load[snapped], tip[snapped], "o", ms=5, color="#b91c1c", label="snapped")
    axis.set(xlabel="load / Euler's load", ylabel="tip to the side (m)", xlim=(0.0, 2.3), title="a column")
    below(axis)
    tidy(axis)
    return figure


def convergence() -> Any:
    """Error of the tip over the number of Gauss nodes, F L^2 / EI = 2 and 10 across a cantilever, against 16
    nodes: the error falls exponentially. Dotted: what the scene itself estimates (`eq.error`, along the whole
    rod).
    """
    figure = new_figure(7.0, 4.6)
    axis: Any = figure.subplots()
    counts = np.arange(3, 12, 2)
    for load in (2.0, 10.0):
        force = tuple((_stiffness() * load * np.array([1.0, 0.0, 0.0])).tolist())
        exact = _strip(rod.TipWrench(force=force), nodes=16).statics().solve()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rod.Unresolved)  # few nodes say so, which is what is drawn
            answers = [_strip(rod.TipWrench(force=force), nodes=int(k)).statics().solve() for k in counts]
        off = [np.linalg.norm(a.tip - exact.tip) for a in answers]
        (line,) = axis.semilogy(counts, off, "o-", ms=4, label=f"F L^2/EI = {load:g}")
        axis.semilogy(counts, [a.error for a in answers], ":", color=line.get_color())
    axis.set(xlabel="nodes", ylabel="error in parts of the length", title="convergence in space")
    below(axis)
    tidy(axis)
    return figure


def natural_frequencies() -> Any:
    """The first modes of a cantilever on 10 nodes beside Euler and Bernoulli's: (1.8751, 4.6941, 7.8548,
    10.9955)^2.
    """
    scene = _strip(rod.Retardation(1e-6), nodes=10)
    found = scene.modes(np.zeros(scene.n_states), 5)
    line = _strip().rod
    unit = np.sqrt(_stiffness() / (7850.0 * np.pi * 1e-6)) / (2.0 * np.pi * line.length**2)
    roots = np.array([1.875104, 4.694091, 7.854757, 10.995541])
    figure = new_figure(11.0, 4.4)
    axes: Any = figure.subplots(1, 2)
    s = np.linspace(0.0, 1.0, 81)
    for k in range(4):
        shape = found.displacements(s[1:])[k][:, 0]
        turned = np.append(0.0, (shape * np.exp(-1j * np.angle(shape[-1]))).real)
        axes[0].plot(s, turned, lw=1.5, label=f"mode {k + 1}")
    axes[0].set(xlabel="arclength (m)", ylabel="displacement / that of the tip", title="shapes")
    below(axes[0], 4)
    axes[1].plot(range(1, 5), unit * roots**2, "k+", ms=13, label="Euler and Bernoulli")
    axes[1].plot(range(1, 5), found.frequency[:4], "o", ms=5, label="10 nodes")
    axes[1].set(xlabel="mode", ylabel="frequency (Hz)", xticks=range(1, 5), title="frequencies")
    below(axes[1])
    tidy(*axes)
    return figure


def energy() -> Any:
    """An undamped rod of rubber let go in three dimensions, Gauss steps of 2 ms by the variational balance: the
    energies go to and fro, their sum stays (below).
    """
    soft = rod.Rod(0.5, rod.Circle(0.01), rod.Elastic(1e7, 3.4e6, 1100.0))
    loaded = rod.Scene(soft, rod.Gravity((-9.81, 0.0, 0.0)), rod.TipWrench(force=(0.0, 0.3, 0.0)), nodes=6)
    start = loaded.statics().solve().state
    free = rod.Scene(soft, rod.Gravity((-9.81, 0.0, 0.0)), nodes=6)
    moved = free.stepper(0.01, step=2e-3).run(np.zeros((60, 0)), start, energy=True)
    return moved.energy().plot()


def helix() -> Any:
    """A rod of nitinol with two tendons on helices, one of them pulled: it bends and twists. The colour is the
    tension.
    """
    scene = rod.Scene(
        rod.Rod(0.4, rod.Circle(1e-3), rod.Elastic(60e9, 23e9, 6450.0)),
        rod.Gravity((0.0, 0.0, -9.81)),
        rod.Tendons.helical(8e-3, 0.4, (0, 180), rod.Tension()),
        nodes=10,
    )
    found = scene.statics().sweep(np.linspace(0.0, 1.0, 12)[:, None] * np.array([6.0, 0.5]))
    return hung(plot_arm(scene, found.states[[0, 4, 8, 11]], "tendons on helices, pulled by 0 to 6 N"), scene)


def finger() -> Any:
    """A tapered finger of silicone with a curved rest shape and pressure chambers, from rest to 40 kPa in one
    chamber.
    """
    scene = rod.Scene(
        rod.Rod(
            0.15,
            rod.Tapered(rod.Circle(9e-3), rod.Circle(5e-3)),
            rod.Elastic(young=3e5, shear=1e5, density=1100.0),
            strains="cosserat",
            rest_curvature=(0.0, 1.5, 0.0),
        ),
        rod.Gravity((0.0, 0.0, 9.81)),
        rod.Chambers.parallel(2e-5, 5e-3, (0, 180)),
        nodes=6,
    )
    found = scene.statics().sweep(np.linspace(0.0, 4e4, 9)[:, None] * np.array([1.0, 0.0]))
    return hung(plot_arm(scene, found.states, "a finger under 0 to 40 kPa"), scene)


def two_sections() -> Any:
    """An arm of two sections with three tendons each; the inner one bends to one side, the outer one back."""
    arm = MultiSectionArm(sections=2, tendons=3, nodes=4)
    bend = np.cos(arm.tendon_angles)
    moves = [0.0, 3e-3, 6e-3]
    rows = [arm.pretension + m * bend * arm.shares[:, 0] - 1.6 * m * bend * arm.shares[:, 1] for m in moves]
    return arm.plot(rows, "two sections")


def _viridis(part: float) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](part)
