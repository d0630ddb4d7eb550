"""How far an arm in motion is from its shape at rest, before anything is measured: by energy, mode by mode."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pisplit.checks import Array
from pisplit.models.arm.drawing import TURN
from pisplit.models.rod import Scene

if TYPE_CHECKING:
    from pisplit.models.arm.base import Arm

#: Energy of every mode in motion, in parts of the elastic energy of the usual bend.
MOVING = 1.0
#: Least eigenvalue, in parts of the largest, of stiffness and mass: nothing moves without bound.
LEAST = 1e-12


def moving_energy(arm: Arm) -> float:
    """Energy in J that one mode of the ``arm`` may have in motion: what bends it as it usually is bent."""
    scene = arm.scene
    stiffness = np.asarray(scene.rod.profile(scene.rule.nodes).stiffness)[:2].mean()
    radius = float(np.hypot(*np.concatenate([g.points(0.0, scene.rod.length) for g in arm.groups]).T).mean())
    turn = arm.amplitude / radius or TURN
    return float(MOVING * 0.5 * stiffness * turn**2 / scene.rod.length)


def energy_root(scene: Scene, strains: Array, inputs: Array, energy: float) -> Array:
    """(2n, 2n) root of the precision of [xi, xi_t] about the shape at rest: its square is energy over ``energy``.

    Equipartition: every mode of the linear motion about rest has the same mean energy, so that fast ones are small.
    The balance at Gauss nodes, weighted by the quadrature, is the gradient of the energy, to the error of the grid;
    stiffness and mass are its derivatives there.

    Args:
        scene: what moves.
        strains: xi (n,) at rest.
        inputs: (n_inputs,) under which it rests.
        energy: in J.
    """
    n = scene.n_strains
    zero = np.zeros(n)
    blocks = scene.motion_residual.jacobian()(strains, zero, zero, inputs, zero)
    weights = np.repeat(scene.rule.weights, n // scene.nodes)
    scale = weights * scene.nominal_residual
    found = np.zeros((2 * n, 2 * n))
    for k, block in ((0, blocks[0]), (1, blocks[2])):
        energetic = scale[:, None] * np.asarray(block)
        energetic = 0.5 * (energetic + energetic.T)
        energetic *= np.sign(np.trace(energetic))
        values, vectors = np.linalg.eigh(energetic)
        root = np.sqrt(np.maximum(values, LEAST * values[-1]) / energy)
        found[k * n : (k + 1) * n, k * n : (k + 1) * n] = root[:, None] * vectors.T
    return found
