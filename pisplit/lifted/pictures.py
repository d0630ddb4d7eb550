"""Pictures of lifted models: eigenvalues, modes, what was cut off, roll-outs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pisplit.lifted.modes import modes
from pisplit.pictures.figures import LINES, MEASURED, below, keep, labelled, new_figure, tidy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.lifted.model import LiftedModel
    from pisplit.lifted.modes import Modes
    from pisplit.lifted.reduction import Reduction
    from pisplit.lifted.rollout import Rollout

Path = str | os.PathLike[str] | None
#: Steps after which a model that comes to rest does.
SETTLING = 400


def plot_model(model: LiftedModel, path: Path) -> Figure:
    """Eigenvalues of A (not of a re-lifted ``model``) and the response of outputs to a step of each input.

    The step is 1 % of the mean training input (0.01 where that is zero), from where the model comes to rest under it,
    and drawn per unit of the input: the outputs are those of the tip, of the first group, or the first states.

    Written to ``path`` where one is given.
    """
    linear = model.relifted is None
    figure = new_figure(11.0 if linear else 6.5, 4.4)
    axes: Any = figure.subplots(1, 2 if linear else 1, squeeze=False)[0]
    if linear:
        plane(axes[0], modes(model).eigenvalues, f"eigenvalues of A, {model.n_lifted} lifted states")
    _steps(axes[-1], model)
    tidy(*axes)
    return keep(figure, path)


def _steps(axis: Any, model: LiftedModel) -> None:
    group = list(model.outputs.get("tip") or next(iter(model.outputs.values()), range(model.n_states)))[:3]
    rest, size = model.input_offset, 0.01 * (np.abs(model.input_offset).max(initial=0.0) or 1.0)
    T, D = 60, model.n_delays
    x0, u0 = np.zeros((D + 1, model.n_states)), np.tile(rest, (D, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        settled = model.predict(x0, u0, np.tile(rest, (SETTLING, 1)))
    if not settled.diverged:
        x0 = settled.x[-D - 1 :]
    calm = model.predict(x0, u0, np.tile(rest, (T, 1))).x
    t = model.dt * np.arange(T + 1)
    for j, name in enumerate(model.input_names[:2]):
        moved = np.tile(rest, (T, 1))
        moved[:, j] += size
        response = (model.predict(x0, u0, moved).x - calm) / size
        for i in group:
            label = f"{name} -> {model.state_names[i]}"
            axis.plot(t, response[:, i], "-" if j == 0 else "--", lw=1.2, label=label)
    start = "zero: it does not come to rest" if settled.diverged else "rest"
    axis.set(xlabel="time (s)", ylabel="response per unit of input", title=f"step responses from {start}")
    below(axis, 2)


def plane(axis: Any, values: NDArray[np.complex128], title: str) -> None:
    """Eigenvalues ``values`` on ``axis`` with the unit circle, those outside it in red, under a ``title``."""
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    axis.plot(np.cos(angle), np.sin(angle), color="k", lw=0.8)
    out = np.abs(values) > 1.0 + 1e-9
    axis.plot(values[~out].real, values[~out].imag, "o", ms=4, mfc="none", color=MEASURED, label="inside or on it")
    if out.any():
        axis.plot(values[out].real, values[out].imag, "x", ms=6, color="#b91c1c", label=f"{out.sum()} outside")
    axis.set(xlabel="real part", ylabel="imaginary part", title=title, aspect="equal")
    below(axis, 2)


def plot_modes(found: Modes, path: Path) -> Figure:
    """Eigenvalues of ``found`` in the unit circle, and frequency over time constant.

    Written to ``path`` where one is given.
    """
    figure = new_figure(11.0, 4.6)
    axes: Any = figure.subplots(1, 2)
    plane(axes[0], found.eigenvalues, f"eigenvalues, radius {found.radius:.6g}")
    decays = (found.time_constants > 0.0) & np.isfinite(found.time_constants)
    weight = np.abs(found.shapes).max(axis=0)
    size = 12.0 + 120.0 * weight / (weight.max() or 1.0)
    drawn = axes[1].scatter(
        found.time_constants[decays],
        found.frequencies[decays],
        s=size[decays],
        c=found.damping[decays].clip(0.0, 1.0),
        cmap="viridis_r",
        vmin=0.0,
        vmax=1.0,
        alpha=0.8,
    )
    figure.colorbar(drawn, ax=axes[1], label="damping ratio")
    axes[1].set(xscale="log", xlabel="time constant (s)", ylabel="frequency (Hz)")
    axes[1].margins(0.12)
    axes[1].set_title("modes that decay; size: largest state they move", fontsize=10)
    tidy(*axes)
    return keep(figure, path)


def plot_reduction(found: Reduction, path: Path) -> Figure:
    """Hankel singular values of ``found``, those that are kept filled, with the bound of the error.

    Written to ``path`` where one is given.
    """
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    values = np.maximum(found.singular_values, 1e-300)
    kept = found.model.n_lifted - found.kept
    at = np.arange(1, len(values) + 1)
    axis.semilogy(at[:kept], values[:kept], "o", color=MEASURED, ms=4, label=f"kept ({kept})")
    axis.semilogy(at[kept:], values[kept:], "o", color=MEASURED, ms=4, mfc="none", label=f"left out ({len(at) - kept})")
    top = values.max(initial=1.0)
    axis.set_ylim(max(values.min(initial=top), 1e-18 * top) / 3.0, 3.0 * top)
    also = f", {found.kept} modes that do not decay kept as they are" if found.kept else ""
    axis.set(xlabel="number", ylabel="Hankel singular value")
    axis.set_title(f"error at most {found.bound:.3g} of the state ranges{also}", fontsize=10)
    below(axis, 2)
    tidy(axis)
    return keep(figure, path)


def plot_rollout(found: Rollout, path: Path) -> Figure:
    """The states of ``found`` that move most over the steps; of several episodes the first. Red: where it diverged.

    Written to ``path`` where one is given.
    """
    single = found.x.ndim == 2
    x = found.x if single else found.x[0]
    at = found.diverged_at if single else int(np.asarray(found.diverged_at)[0])
    figure = new_figure(7.0, 4.2)
    axis = figure.subplots()
    most = np.sort(np.argsort(-np.ptp(x, axis=0))[:LINES])
    for i in most:
        axis.plot(x[:, i], lw=1.3, label=f"state {i}")
    if at is not None and np.asarray(at) >= 0:
        axis.axvline(float(np.asarray(at)), color="#b91c1c", lw=1.0, ls="--", label="diverged")
    more = "" if single else f"first of {len(found.x)} episodes; "
    axis.set(xlabel="step", ylabel=labelled("state", "its unit"))
    axis.set_title(f"{more}the {len(most)} of {x.shape[1]} states that move most", fontsize=10)
    below(axis, 6)
    tidy(axis)
    return keep(figure, path)
