"""The static balance of a scene in scaled form, and its roots by KINSOL and by Newton's method."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from pisplit.checks import Array
from pisplit.mapping import Mapped
from pisplit.models.rod.equations.residuals import with_slopes
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.memoryless import Memoryless

if TYPE_CHECKING:
    from pisplit.models.rod.scene import Scene

#: Largest scaled residual (parts of EI/L) of a state that counts as an equilibrium.
TOLERANCE = 1e-8
#: Residual at which the rootfinders stop, well below ``TOLERANCE``.
STOP = 1e-10


class Search(Rebuilt):
    """Roots of the static balance (paper, eq. cosserat_rod_eq at rest) of a scene in scaled form.

    The unknowns x are the strains in parts of ``nominal_strains`` (1/L), measured from the unloaded rod; the residual
    is in parts of ``nominal_residual`` (EI/L), so that tolerances mean the same for every rod.

    Args:
        scene: the rod and what acts on it.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    # The equations ---------------------------------------------------------------------------------------------------

    @cached_property
    def graph(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Scaled unknowns, inputs, load factor and scaled residual; the load factor multiplies what deforms the rod."""
        scene = self.scene
        n = scene.n_strains
        x, load = ca.SX.sym("x", n), ca.SX.sym("load")
        xi, u, balance = scene.static_balance
        bare = scene.without(object).balance(xi, ca.SX(n, 1), None, ca.SX(0, 1)).residual
        bare = ca.vertcat(bare, ca.SX(n - bare.numel(), 1))  # a joint at the base resists nothing
        residual = (load * balance.residual + (1.0 - load) * bare) / ca.DM(scene.nominal_residual)
        scaled = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x
        return x, u, load, ca.substitute(residual, xi, scaled)

    @cached_property
    def loaded(self) -> tuple[list[ca.SX], list[ca.SX]]:
        """Unknowns and inputs, and the residual under the whole load.

        Common subexpressions are shared before anything is derived: the derivatives then share theirs within 2 %, in a
        tenth of the time that finding those in the large graphs of derivatives takes.
        """
        x, u, load, residual = self.graph
        return [x, u], [ca.cse(ca.substitute(residual, load, ca.SX(1)))]

    @cached_property
    def blocks(self) -> list[ca.SX]:
        """Derivatives of the ``loaded`` residual with respect to both."""
        scene, ((x, u), (residual,)) = self.scene, self.loaded
        xi, _, balance = scene.static_balance
        if balance.reaction is not None:
            return [ca.jacobian(residual, x), ca.jacobian(residual, u)]
        slope = ca.diag(1.0 / ca.DM(scene.nominal_residual)) @ balance.slope @ ca.diag(ca.DM(scene.nominal_strains))
        scaled = ca.DM(scene.rest_coordinates) + ca.DM(scene.nominal_strains) * x
        return [*ca.substitute([slope], [xi], [scaled]), ca.jacobian(residual, u)]

    @cached_property
    def residual_function(self) -> ca.Function:
        """``(x, u) -> residual``."""
        (x, u), (residual,) = self.loaded
        return with_slopes("residual", {"x": x, "u": u}, residual, self.blocks)

    @cached_property
    def slopes(self) -> ca.Function:
        """``(x, u) -> `` derivatives of the residual with respect to both."""
        return ca.Function("slopes", self.loaded[0], self.blocks)

    def strains(self, x: Array) -> Array:
        """Free strains (..., n_strains) of unknowns ``x`` (..., n_strains)."""
        strains: Array = self.scene.rest_coordinates + x * self.scene.nominal_strains
        return strains

    def scaled(self, strains: Array) -> Array:
        """Unknowns (n_strains,) of free ``strains`` (n_strains,)."""
        scaled: Array = (strains - self.scene.rest_coordinates) / self.scene.nominal_strains
        return scaled

    @cached_property
    def _evaluated(self) -> Mapped:
        return Mapped(self.scene.native(self.residual_function))

    def residual(self, x: Array, u: Array) -> Array:
        """Residual (n_strains,) of unknowns ``x`` (n_strains,) under inputs ``u`` (n_inputs,)."""
        return self._evaluated(x[None], u[None])[0]

    def worst(self, x: Array, u: Array) -> float:
        """Largest residual of ``x`` under ``u``; infinite where it is not finite."""
        g = np.abs(self.residual(x, u))
        return float(g.max(initial=0.0)) if np.all(np.isfinite(g)) else float("inf")

    def worst_of_rows(self, x: Array, u: Array) -> Array:
        """The same (N,) of rows ``x`` (N, n_strains) under rows ``u`` (N, n_inputs)."""
        g = np.abs(self._evaluated(x, u))
        worst: Array = np.where(np.isfinite(g), g, np.inf).max(axis=1, initial=0.0)
        return worst

    # Rootfinders -----------------------------------------------------------------------------------------------------

    def _rootfinder(self, solver: str, raises: bool) -> ca.Function:
        options: dict[str, Any] = {
            "error_on_fail": raises,
            "abstol": STOP,
            "max_iter": 60,
            "linear_solver": "qr",
            "show_eval_warnings": False,
        }
        if solver == "kinsol":  # plain kinsol steps with stale Jacobians and solves 2 % of stiff tendon arms cold
            options |= {"strategy": "linesearch", "disable_internal_warnings": True}
        x, u = (ca.MX.sym(name, self.residual_function.size1_in(name)) for name in ("x", "u"))
        called = self.scene.native(self.residual_function)(x, u)  # by a call, through its own Jacobian
        return ca.rootfinder("equilibrium", solver, ca.Function("called", [x, u], [called]), options)

    @cached_property
    def kinsol(self) -> ca.Function:
        """``(x_guess, u) -> x`` by KINSOL with a line search."""
        return self._rootfinder("kinsol", raises=True)

    @cached_property
    def _cold_kinsol(self) -> Memoryless:
        return Memoryless(lambda: self._rootfinder("kinsol", raises=True))

    def of_rows(self, rows: int, chunks: int, mild: bool) -> ca.Function:
        """``(x_guesses, u) -> x`` of many columns, built anew because KINSOL remembers (see ``Memoryless``).

        A column that fails does not end the call; its residual tells.

        Args:
            rows: their number in a chunk.
            chunks: solved side by side, each by its own thread.
            mild: whether there is only one root each, by KINSOL; else by Newton's method, which fails without a word.
        """
        chunk = self._rootfinder("kinsol" if mild else "newton", raises=False).map(rows)
        return chunk if chunks == 1 else chunk.map(chunks, "thread")

    @cached_property
    def newton(self) -> ca.Function:
        """``(x_guess, u) -> x`` by damped Newton."""
        return self._rootfinder("newton", raises=False)

    # Searching -------------------------------------------------------------------------------------------------------

    def find(self, u: Array, x0: Array, mild: bool) -> tuple[Array, int | None, str]:
        """A root of the balance, or the last iterate.

        Args:
            u: inputs (n_inputs,).
            x0: unknowns (n_strains,) to start from.
            mild: whether there is only one; then KINSOL, which takes stiff tendons in its stride, is first.

        Returns the last iterate (n_strains,), its iterations and the solver's name.
        """
        if mild:
            x = attempt(self._cold_kinsol, x0, u)
            if self.worst(x, u) <= TOLERANCE:
                return x, None, "kinsol"
        return attempt(self.newton, x0, u), _iterations(self.newton), "newton"

    def along(self, x: Array, u: Array, change: Array) -> Array:
        """Change (n_strains,) of the root ``x`` under ``u`` with a ``change`` (n_inputs,) of the inputs."""
        of_x, of_u = (np.asarray(v) for v in self.slopes(x, u))
        try:
            return np.asarray(-np.linalg.solve(of_x, of_u @ change), dtype=np.float64)
        except np.linalg.LinAlgError:
            return np.zeros_like(x)


def attempt(solver: ca.Function | Memoryless, x0: Array, *parameters: Array | float) -> Array:
    """One call of a rootfinder ``solver`` from ``x0`` (n,) with its ``parameters``; NaN (n,) where it fails."""
    try:
        return np.asarray(solver(x0, *parameters)).ravel()
    except RuntimeError:
        return np.full(len(x0), np.nan)


def _iterations(solver: ca.Function) -> int:
    return int(solver.stats()["iter_count"])
