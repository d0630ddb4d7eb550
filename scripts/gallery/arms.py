"""Pictures of arms: drawings, reach, recordings, calibration, slack tendons."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from pisplit.models.arm import TendonArm, equilibrium_table
from pisplit.models.calibration import calibrate_from_shapes
from pisplit.pictures.figures import below, new_figure, tidy


@cache
def _drawn() -> TendonArm:
    return TendonArm(length=0.45, radius=0.7e-3, material="steel", offset=0.01, tip_mass=0.01, nodes=4)


@cache
def _paper() -> TendonArm:
    return TendonArm.paper(4)


def drawing() -> Any:
    """An arm from a drawing in words, hanging, and the same pulled in six directions (`arm.plot`)."""
    arm = _drawn()
    turns = np.linspace(0.0, 2.0 * np.pi, 7)
    moves = [arm.differential_basis @ (arm.amplitude * np.array([np.cos(a), np.sin(a)])) for a in turns]
    return arm.plot(arm.rest_inputs + np.array(moves), "a drawing, pulled in six directions")


def reach() -> Any:
    """Where the tip of the paper's arm gets (`equilibrium_table(...).plot()`): the map from inputs to equilibria,
    which identification takes as known.
    """
    return equilibrium_table(_paper(), half_width=0.02, points=17).plot()


def strip() -> Any:
    """Two seconds of the paper's arm under smooth displacements: shapes, motion of the tip, tensions
    (`trajectory.plot`).
    """
    arm, t = _paper(), 0.03 * np.arange(66)
    turn = 2.0 * np.pi * t[:, None] / 1.3 - np.deg2rad([0.0, 120.0, 240.0])
    moves = arm.rest_inputs + 6e-3 * np.minimum(1.0, t[:, None] / 0.6) * np.cos(turn)
    rest = arm.scene.statics().solve(arm.rest_inputs).state
    return arm.scene.fast_stepper(0.03).run(moves, rest).plot()


def slack() -> Any:
    """Tensions of the prototype, whose tendons are weak and not pretensioned, at rest while one is pulled and the
    others are let out by half as much, and back: let out, a tendon hangs loose, and the arm is no longer linear
    in its inputs.
    """
    arm = TendonArm.prototype(4)
    pulled = np.linspace(-10e-3, 10e-3, 81)
    inputs = arm.rest_inputs + pulled[:, None] * np.array([1.0, -0.5, -0.5])
    found = arm.scene.statics().solve_many(inputs)
    figure = new_figure(7.0, 4.4)
    axis: Any = figure.subplots()
    for i, style in enumerate(("-", "--", ":")):
        axis.plot(1e3 * pulled, found.tensions[:, i], style, lw=1.8, label=f"tendon {i + 1}")
    axis.set(xlabel="displacement of tendon 1 (mm)", ylabel="tension (N)", title="slack")
    below(axis)
    tidy(axis)
    return figure


def photographs() -> Any:
    """Ten shapes at rest with 1 mm of noise at six stations (`arm.rest_shapes(10, position_noise=1e-3).plot()`)."""
    return _drawn().rest_shapes(10, position_noise=1e-3).plot()


def calibration() -> Any:
    """Tendons found from four shapes at rest; the drawing had them at 10.4 mm, the arm has them at 10 mm and 0,
    120 and 240 degrees (`calibrate_from_shapes(...).plot()`).
    """
    shapes = _drawn().rest_shapes(4)
    wrong = TendonArm(length=0.45, radius=0.7e-3, material="steel", offset=0.0104, tip_mass=0.01, nodes=4)
    return calibrate_from_shapes(wrong, shapes.inputs, shapes.fields).plot()


def modes_at_rest() -> Any:
    """Natural modes of the hanging arm at rest on four nodes, and which of them the nodes resolve
    (`scene.modes(x).plot()`).
    """
    arm = _drawn()
    return arm.scene.modes(arm.scene.statics().solve(arm.rest_inputs).state).plot()


def large_steps() -> Any:
    """Error over time of one motion of the paper's arm by large checked steps, beside what the scheme itself
    estimates for each step; the truth is IDAS at rtol 1e-8 on the same nodes.
    """
    arm, t = _paper(), 0.03 * np.arange(40)
    moves = arm.rest_inputs + 5e-3 * np.sin(4.0 * t[:, None]) * np.array([1.0, -0.5, -0.5])
    rest = arm.scene.statics().solve(arm.rest_inputs).state
    quick = arm.scene.fast_stepper(0.03).run(moves, rest)
    truth = arm.scene.simulator(0.03, rtol=1e-8).run(moves, rest)
    off = np.linalg.norm(quick.fields(1)[:, 0, :3] - truth.fields(1)[:, 0, :3], axis=1)
    figure = new_figure(7.0, 4.4)
    axis: Any = figure.subplots()
    axis.semilogy(quick.t[1:], 1e3 * off[1:], lw=1.5, label="error of the tip")
    if quick.step_errors is not None:
        axis.semilogy(quick.t[1:], 1e3 * np.maximum(quick.step_errors, 1e-12), ":", label="estimate of one step")
    axis.set(xlabel="time (s)", ylabel="mm", title="large checked steps of 30 ms")
    below(axis)
    tidy(axis)
    return figure
