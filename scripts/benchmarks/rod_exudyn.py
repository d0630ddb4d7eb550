"""The clamped rod of ``rod_peers`` by Exudyn (``pip install exudyn``), in the plane."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.rod_peers import SHEAR_FACTOR, Case, Run

Array = NDArray[np.float64]

#: Elements up to which dense factors are faster than sparse ones.
DENSE = 10


@dataclass(frozen=True)
class Newton:
    """How the equations of a step are solved; the defaults of Exudyn (1e-8) hardly converge on a steel rod.

    Attributes:
        tolerance: of the residual, relative to that at the start of the step.
        contractivity: above which a modified Newton iteration forms its matrix anew.
        every_step: whether the matrix is formed in every step.
    """

    tolerance: float
    contractivity: float = 0.5
    every_step: bool = False

    def __str__(self) -> str:
        when = "every step" if self.every_step else f"above {self.contractivity:g}"
        return f"Newton {self.tolerance:.0e}, matrix {when}"


LOOSE, USUAL, TIGHT = Newton(1e-2, 0.9), Newton(3e-3, 0.7), Newton(1e-3, 0.7)
STIFF = Newton(1e-4, every_step=True)
#: Elements, their number, steps between outputs and Newton's method by case: the fastest at each error of a search over
#: kinds, numbers, steps, tolerances, contractivities, matrices, spectral radii of 0.6 to 0.9 and full Newton.
SETTINGS = {
    "soft": [
        *(("beam", n, steps, LOOSE) for n, steps in ((8, 2), (10, 2), (12, 2), (12, 3), (14, 3))),
        *(("beam", n, steps, USUAL) for n, steps in ((16, 4), (18, 4), (20, 5), (22, 5), (24, 5), (32, 8))),
        *(("beam", n, steps, TIGHT) for n, steps in ((28, 6), (32, 7), (48, 8))),
    ],
    "steel": [
        *(("beam", n, steps, STIFF) for n, steps in ((6, 2), (8, 2), (10, 2), (10, 3), (12, 3), (14, 3))),
        *(("cable", n, steps, STIFF) for n, steps in ((10, 3), (10, 4), (12, 4))),
        *(("cable", n, steps, LOOSE) for n, steps in ((12, 6), (14, 6), (16, 8))),
        ("cable", 12, 5, Newton(1e-3, 0.9)),
    ],
}


def run_exudyn(case: Case, element: str, elements: int, steps: int, newton: Newton) -> Run:
    """The case by implicit steps of the generalised alpha method (spectral radius 0.9) with modified Newton.

    A drag in proportion to mass enters by a damping matrix. The time is that of the solver alone.

    Args:
        case: what moves.
        element: ``"beam"``, geometrically exact with shear and stretch, linear in its two nodes, or ``"cable"``, cubic
            in absolute nodal coordinates, with stretch alone.
        elements: of equal length.
        steps: of equal size between two outputs.
        newton: how a step is solved.
    """
    import exudyn as exu
    from exudyn import itemInterface as items

    system = exu.SystemContainer()
    bodies = system.AddSystem()
    h, line = case.length / elements, case.density * case.area
    bending, stretch = case.bending, case.young * case.area
    if element == "cable":
        at = [items.NodePoint2DSlope1(referenceCoordinates=[k * h, 0.0, 1.0, 0.0]) for k in range(elements + 1)]
        shape = {"length": h, "massPerLength": line, "bendingStiffness": bending, "axialStiffness": stretch}
        bodies_of, held, shares = items.ObjectANCFCable2D, (0, 1, 3), _cubic(h)
    else:
        at = [items.NodeRigidBody2D(referenceCoordinates=[k * h, 0.0, 0.0]) for k in range(elements + 1)]
        shape = {"length": h, "massPerLength": line, "bendingStiffness": bending, "axialStiffness": stretch}
        shape["crossSectionInertia"] = line * case.radius**2 / 4.0
        shape["shearStiffness"] = SHEAR_FACTOR * case.shear_modulus * case.area
        shape["includeReferenceRotations"] = False
        bodies_of, held, shares = items.ObjectBeamGeometricallyExact2D, (0, 1, 2), _linear(h)
    nodes = [bodies.AddNode(node) for node in at]
    for pair in pairwise(nodes):
        bodies.AddObject(bodies_of(nodeNumbers=list(pair), **shape))
    drag = exu.MatrixContainer()
    drag.SetWithDenseMatrix(case.damping * line * _assembled(shares, elements), useDenseMatrix=False)
    bodies.AddObject(items.ObjectGenericODE2(nodeNumbers=nodes, dampingMatrix=drag))
    ground = bodies.AddNode(items.NodePointGround())
    fixed = bodies.AddMarker(items.MarkerNodeCoordinate(nodeNumber=ground, coordinate=0))
    for coordinate in held:
        base = bodies.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[0], coordinate=coordinate))
        bodies.AddObject(items.CoordinateConstraint(markerNumbers=[fixed, base]))
    across = bodies.AddMarker(items.MarkerNodeCoordinate(nodeNumber=nodes[-1], coordinate=1))
    push = items.LoadCoordinate(markerNumber=across, loadUserFunction=lambda _, t, __: case.force_at(t))
    bodies.AddLoad(push)
    place = exu.OutputVariableType.Position
    seen = bodies.AddSensor(
        items.SensorNode(nodeNumber=nodes[-1], outputVariableType=place, storeInternal=True, writeToFile=False)
    )
    bodies.Assemble()
    settings = _settings(case, elements, steps, newton)
    before = time.process_time()
    success = bool(bodies.SolveDynamic(settings))
    seconds = time.process_time() - before
    tip = np.full((case.outputs, 3), np.nan)
    if success:
        rows = np.asarray(bodies.GetSensorStoredData(seen))[-case.outputs :]
        tip = np.stack([rows[:, 2], np.zeros(len(rows)), rows[:, 1]], axis=1)
    return Run("Exudyn, plane", f"{element} n={elements}, {steps} steps, {newton}", tip, seconds, success)


def _settings(case: Case, elements: int, steps: int, newton: Newton) -> object:
    import exudyn as exu

    settings = exu.SimulationSettings()
    stepping = settings.timeIntegration
    stepping.numberOfSteps, stepping.endTime = case.outputs * steps, case.span
    stepping.adaptiveStep, stepping.verboseMode = False, 0
    stepping.generalizedAlpha.spectralRadius = 0.9
    stepping.newton.useModifiedNewton = True
    stepping.newton.relativeTolerance = newton.tolerance
    stepping.newton.modifiedNewtonContractivity = newton.contractivity
    stepping.newton.modifiedNewtonJacUpdatePerStep = newton.every_step
    if elements > DENSE:
        settings.linearSolverType = exu.LinearSolverType.EigenSparse
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = case.span / case.outputs
    return settings


def _cubic(h: float) -> tuple[Array, int, int]:
    """Mass matrix over mass per length of a cubic element, its coordinates of one direction a node, all of a node."""
    rows = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h]]
    rows += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
    return h / 420.0 * np.array(rows), 2, 4


def _linear(h: float) -> tuple[Array, int, int]:
    """The same of a linear element with a rotation, which the drag does not slow."""
    return h / 6.0 * np.array([[2.0, 1.0], [1.0, 2.0]]), 1, 3


def _assembled(shares: tuple[Array, int, int], elements: int) -> Array:
    """The matrix of all nodes; both directions have the same."""
    part, of_direction, of_node = shares
    whole = np.zeros((of_node * (elements + 1),) * 2)
    for k in range(elements):
        for direction in range(2):
            rows = [of_node * (k + end) + direction + 2 * j for end in range(2) for j in range(of_direction)]
            whole[np.ix_(rows, rows)] += part
    return whole
