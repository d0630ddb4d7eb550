"""The balanced split: Strang's formula about the equilibrium that the inputs hold."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.data.episodes import Pairs
from pisplit.generator.generator import generator_edmd, spectral_radius
from pisplit.regression import composed_ridge
from pisplit.splitting.base import Solver, SplitContext, SplitFit
from pisplit.splitting.options import check_options, directions, generator_samples, ports

Array = NDArray[np.float64]

OPTIONS = ("tangent", "equilibrium", "ports", "loads")


class Balanced:
    """K_f K_h K_f with f - f(x_eq(u)) and h + f(x_eq(u)): both parts vanish at every equilibrium, which is so kept.

    Plain Strang splitting loses equilibria under load, where f and h are both large and cancel. With psi_0, psi_1 the
    equilibria under u_{k-1} and u_k (under u_k alone if the dictionary does not delay inputs), F = exp(L_f dt/2):

        psi_m = psi_0 + F (psi_k - psi_0)
        psi_+ = psi_m + dt P H [D (psi_m - (psi_0 + psi_1)/2); D (psi_1 - psi_0)]
        psi_{k+1} = psi_1 + F (psi_+ - psi_1)

    Options of the estimator (S learned columns, P input features, r ports):
        equilibrium  E (S, P) with psi_eq(u) = E phi(u); needed.
        tangent      PhaseSamples for L_f (default: d2), for instance close to one state.
        ports        (S, r) directions P of h; default: unit vectors of ``rows`` (all learned columns).
        loads        (q, S) rows D that select what h depends on, from the deviation; default: all of it.

    ``alpha`` weighs |H|^2 in units of ports and loads in which the data are of size one; the residual is that of the
    composed map, F is never inverted. Gains are those of the kick: 1 + dt P H D stands for exp(dt P H_h D). It is a
    ridge whatever ``penalty`` says; ``toward`` and ``half_step`` play no part. A large alpha leaves the known part,
    H = 0.

    Source: balanced splitting after Speth, Green, MacNamara and Strang, SIAM J. Numer. Anal. 51 (2013).
    """

    #: Default grid of alpha="cv".
    alphas = tuple(np.logspace(-10, 1, 12).tolist())

    def __init__(self, context: SplitContext) -> None:
        check_options(context, "balanced", OPTIONS)
        options, theta = context.options, context.theta
        if "equilibrium" not in options:
            raise ValueError("split='balanced' needs options['equilibrium'], E (S, P) with psi_eq(u) = E phi(u)")
        learned, size = theta.learned_columns, len(theta.learned_columns)
        samples = generator_samples(context, "balanced")
        generator = generator_edmd(theta, samples, np.ones(theta.n_columns), context.generator_alpha)
        self.context = context
        self.half = np.asarray(scipy.linalg.expm(0.5 * context.dt * generator[np.ix_(learned, learned)]))
        shape = (size, theta.n_features)
        self.equilibrium = finite_array(options["equilibrium"], "options['equilibrium']", shape)
        self.ports = ports(context)
        self.loads = directions(options["loads"], "loads", (None, size)) if "loads" in options else np.eye(size)

    def solver(self, pairs: Pairs) -> Solver:
        """A function alpha -> fit for these pairs."""
        theta, context = self.context.theta, self.context
        learned, size = theta.learned_columns, theta.n_columns
        scale = context.scale[learned]
        known, features = self._rows()
        push = context.dt * self.half @ self.ports
        moments = context.moments(pairs)
        data = moments.rows(centred=False)
        a, y = data[:, :size], data[:, size:]
        residual = (y - a @ known.T) / scale
        regressors, factor = a @ features.T, push / scale[:, None]
        load_unit, port_unit = _sizes(regressors), _sizes(factor)
        regressors, factor = regressors / load_unit, factor / port_unit
        unit = float((regressors**2).mean(axis=1).sum() * (factor**2).mean(axis=1).sum())

        def solve(alpha: float) -> SplitFit:
            weight = context.weight(alpha, unit, moments.n_samples)
            fit = composed_ridge(factor, regressors, residual, weight)
            gains = fit.K / port_unit[:, None] / load_unit
            k = known + push @ gains @ features
            details = {"gains": gains.tolist(), "radius": spectral_radius(k[:, learned])}
            return SplitFit(K=k, alpha=weight, rank=fit.rank, details=details)

        return solve

    def _rows(self) -> tuple[Array, Array]:
        """The known map (S, M) with H = 0 and what h depends on (q or 2 q, M), both as rows on Theta."""
        theta = self.context.theta
        learned, features = theta.learned_columns, theta.n_features
        state, start, end = (np.zeros((len(learned), theta.n_columns)) for _ in range(3))
        state[:, learned] = np.eye(len(learned))
        end[:, theta.n_lifted :] = self.equilibrium
        past = theta.n_lifted - features if theta.input_delays else theta.n_lifted
        start[:, past : past + features] = self.equilibrium
        middle = start + self.half @ (state - start)
        known = end + self.half @ (middle - end)
        parts = [middle - 0.5 * (start + end)] + ([end - start] if theta.input_delays else [])
        return known, np.vstack([self.loads @ part for part in parts])


def _sizes(columns: Array) -> Array:
    """Root mean square of every column, 1 where it is zero."""
    sizes = np.sqrt((columns**2).mean(axis=0))
    sizes[sizes == 0.0] = 1.0
    return np.asarray(sizes)
