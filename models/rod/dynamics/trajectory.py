"""What a moving scene returns: trajectories, and steps with their derivatives."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from pisplit.brief import brief
from pisplit.checks import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pisplit.models.rod.analysis.energy import EnergyAccount
    from pisplit.models.rod.dynamics.motion_error import MotionError
    from pisplit.models.rod.scene import Scene


@brief
@dataclass(frozen=True)
class Trajectory:
    """States over time.

    Attributes:
        t: (T+1,) in s; x: (T+1, n_states) states [xi, xi_t, u]; u: (T, n_inputs) commands.
        success: False when the integrator gave up; t, x and u then end at the last good step.
        message: why it gave up, empty on success.
        stats: counters of the scheme over the steps that succeeded (``nsteps`` and others), zeros when none did.
        error: estimated error, when ``run`` was asked to check the motion or looked for it over all of it.
        step_errors: (T,) m, estimated error of the shape after each step alone, where the scheme has one.
        fallbacks: numbers of the steps that took more than the scheme's usual way, by what they took.
        work: (T+1, n_terms) work in J of every term since the start, when ``run`` was asked for the energy.
        scene: the scene whose equations moved.
    """

    t: Array
    x: Array
    u: Array
    success: bool
    message: str
    stats: dict[str, int]
    scene: Scene = field(repr=False, compare=False)
    work: Array | None = field(default=None, repr=False)
    error: MotionError | None = None
    step_errors: Array | None = field(default=None, repr=False)
    fallbacks: Mapping[str, tuple[int, ...]] = field(default_factory=dict)

    def fields(self, stations: int | ArrayLike = 6) -> Array:
        """The 24 fields (T+1, S, 24) at stations; see ``Fields``."""
        return self.scene.fields(self.x, stations)

    def reactions(self) -> Array:
        """World force in N and moment in N m (T+1, 6) by which a held tip is held; see ``Scene.reactions``."""
        return self.scene.reactions(self.x)

    def energy(self) -> EnergyAccount:
        """Stored energies, work of every term and dissipation over time; needs ``run(..., energy=True)``."""
        from pisplit.models.rod.analysis.energy import account

        if self.work is None:
            raise ValueError("the work of the terms was not integrated; call run(u, x0, energy=True)")
        return account(self.scene, self.t, self.x, self.work)

    def plot(self, path: str | os.PathLike[str] | None = None) -> Figure:
        """Shapes side by side, the path of the tip and the tensions over time; written to ``path`` where one is given.

        Raises ValueError for a motion without a step.
        """
        from pisplit.models.rod.output.pictures import plot_strip
        from pisplit.pictures import keep

        self._moved()
        return keep(plot_strip(self), path)

    def save(self, path: str | os.PathLike[str], ghost: Trajectory | None = None) -> None:
        """Write the motion as a page to look at to the HTML file ``path``: the arm in 3-D, a slider of time, curves.

        ``ghost``: another motion over the same times that is drawn behind it, such as one that was predicted. Raises
        ValueError for another suffix, a motion without a step, and a ghost of other times.
        """
        from pisplit.models.rod.output.outline import write_page

        if not os.fspath(path).lower().endswith((".html", ".htm")):
            raise ValueError(f"path = {os.fspath(path)!r}; expected a page, such as run.html (plot(path) draws a PNG)")
        self._moved()
        write_page(self, path, ghost)

    def show(self, ghost: Trajectory | None = None) -> str:
        """Open the page of the motion in the web browser, ``ghost`` as in :meth:`save`; its path."""
        from pisplit.pictures.page import shown

        return shown(lambda path: self.save(path, ghost))

    def _moved(self) -> None:
        if len(self.t) < 2:
            raise ValueError(f"nothing moved: there is nothing to draw ({self.message})")


@dataclass(frozen=True)
class StepSensitivity:
    """One step and its derivatives.

    Attributes:
        x: state (n_states,) after the step.
        d_state: (n_states, n_states) derivative with respect to the state before it (its inputs included).
        d_input: (n_states, n_inputs) derivative with respect to the command.
    """

    x: Array
    d_state: Array
    d_input: Array
