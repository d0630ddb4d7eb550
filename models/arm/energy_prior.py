"""How far an arm in motion is from its shape at rest, before anything is measured: by energy, mode by mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh

from pisplit.checks import Array
from pisplit.models.arm.drawing import TURN
from pisplit.models.rod import Scene

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Energy of every mode in motion, in parts of the elastic energy of the usual bend.
MOVING = 1.0
#: Least eigenvalue, in parts of the largest, of stiffness and mass: nothing moves without bound.
LEAST = 1e-12
#: Largest (omega smooth)^2 that counts: beyond, nothing moves anyway.
FASTEST = 100.0


def moving_energy(arm: Arm) -> float:
    """Energy in J that one mode of the ``arm`` may have in motion: what bends it as it usually is bent."""
    scene = arm.scene
    stiffness = np.asarray(scene.rod.profile(scene.rule.nodes).stiffness)[:2].mean()
    radius = float(np.hypot(*np.concatenate([g.points(0.0, scene.rod.length) for g in arm.groups]).T).mean())
    turn = arm.amplitude / radius or TURN
    return float(MOVING * 0.5 * stiffness * turn**2 / scene.rod.length)


def energy_root(scene: Scene, strains: Array, inputs: Array, energy: float, smooth: float = 0.0) -> Array:
    """(2n, 2n) root of the precision of [xi, xi_t] about the shape at rest: its square is energy over ``energy``.

    Equipartition: every mode of the linear motion about rest has the same mean energy, so that fast ones are small.
    Those faster than ``smooth`` hardly take part: theirs falls with (omega smooth)^4, as where smooth commands drive
    them. The balance at Gauss nodes, weighted by the quadrature, is the gradient of the energy, to the error of the
    grid; stiffness and mass are its derivatives there.

    Args:
        scene: what moves.
        strains: xi (n,) at rest.
        inputs: (n_inputs,) under which it rests.
        energy: in J.
        smooth: time in s over which motion is smooth; 0: every mode moves alike.
    """
    n = scene.n_strains
    zero = np.zeros(n)
    blocks = scene.motion_residual.jacobian()(strains, zero, zero, inputs, zero)
    scale = np.repeat(scene.rule.weights, n // scene.nodes) * scene.nominal_residual
    stiffness, mass = (_energetic(scale[:, None] * np.asarray(blocks[k])) for k in (0, 2))
    squares, vectors = eigh(stiffness, mass)  # of angular frequencies
    squares = np.maximum(squares, LEAST * squares[-1])
    size = (1.0 + np.minimum(smooth**2 * squares, FASTEST)) / np.sqrt(energy)
    coordinates = vectors.T @ mass
    found = np.zeros((2 * n, 2 * n))
    found[:n, :n] = (size * np.sqrt(squares))[:, None] * coordinates
    found[n:, n:] = size[:, None] * coordinates
    return found


def _energetic(block: Array) -> Array:
    """The symmetric part of a ``block`` (n, n), of positive sign and no direction without bound."""
    symmetric = 0.5 * (block + block.T)
    values, vectors = np.linalg.eigh(np.sign(np.trace(symmetric)) * symmetric)
    return np.asarray((vectors * np.maximum(values, LEAST * values[-1])) @ vectors.T)
