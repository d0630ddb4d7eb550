"""The balanced split: Strang's formula about the equilibrium that the inputs hold."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.generator import generator_edmd, spectral_radius
from pisplit.regression import composed_lasso, composed_ridge
from pisplit.regression.moments import Moments
from pisplit.splitting.base import SplitContext, SplitFit, Unknown
from pisplit.splitting.options import check_options, directions, generator_samples, ports

Array = NDArray[np.float64]

#: Grids of alpha="cv".
GRIDS = {"ridge": tuple(np.logspace(-10, 1, 12).tolist()), "lasso": tuple(np.logspace(-8, 0, 9).tolist())}


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

    ``alpha`` weighs |H|^2 (ridge) or |H|_1 (LASSO) in units of ports and loads in which the data are of size one; the
    residual is that of the composed map, F is never inverted. Gains are those of the kick: 1 + dt P H D stands for
    exp(dt P H_h D). A large alpha leaves the known part, H = 0.

    context  what it may use (:class:`pisplit.splitting.SplitContext`)

    Source: balanced splitting after Speth, Green, MacNamara and Strang, SIAM J. Numer. Anal. 51 (2013).
    """

    def __init__(self, context: SplitContext) -> None:
        check_options(context, "balanced")
        options, theta = context.options, context.theta
        if "equilibrium" not in options:
            raise ValueError("split='balanced' needs options['equilibrium'], E (S, P) with psi_eq(u) = E phi(u)")
        size = len(theta.learned_columns)
        self.context = context
        self.alphas = GRIDS[context.penalty]
        self.samples = generator_samples(context, "balanced")
        shape = (size, theta.n_features)
        self.equilibrium = finite_array(options["equilibrium"], "options['equilibrium']", shape)
        self.ports = ports(context)
        self.loads = directions(options["loads"], "loads", (None, size)) if "loads" in options else np.eye(size)

    def known(self) -> Array:
        """F (S, S) of the deviation from an equilibrium (paper, eq. cont_koopman_solve and eq. matrix_exp)."""
        context, learned = self.context, self.context.theta.learned_columns
        ones = np.ones(context.theta.n_columns)
        generator = generator_edmd(context.theta, self.samples, ones, context.generator_alpha, context.known)
        return np.asarray(scipy.linalg.expm(0.5 * context.dt * generator[np.ix_(learned, learned)]))

    def unknown(self, k_f: Array, moments: Moments, alpha: float) -> Unknown:
        """H between two half steps ``k_f`` = F, from ``moments`` of pairs; ``alpha`` weighs the penalty."""
        context, size = self.context, self.context.theta.n_columns
        scale = context.scale[context.theta.learned_columns]
        data = moments.rows(centred=False)
        a, y = data[:, :size], data[:, size:]
        known, features = self._rows(k_f)
        residual = (y - a @ known.T) / scale
        regressors, factor = a @ features.T, context.dt * k_f @ self.ports / scale[:, None]
        load_unit, port_unit = _sizes(regressors), _sizes(factor)
        regressors, factor = regressors / load_unit, factor / port_unit
        if context.penalty == "lasso" and alpha > 0.0:
            unit = 2.0 * float(np.abs(regressors.T @ residual @ factor).max())
            weight = context.weight(alpha, unit, moments.n_samples)
            fit = composed_lasso(factor, regressors, residual, weight, context.solver)
        else:
            unit = float((regressors**2).mean(axis=1).sum() * (factor**2).mean(axis=1).sum())
            weight = context.weight(alpha, unit, moments.n_samples)
            fit = composed_ridge(factor, regressors, residual, weight)
        return Unknown(fit.K / port_unit[:, None] / load_unit, weight, fit.rank, fit.gap)

    def composed(self, k_f: Array, k_h: Unknown) -> SplitFit:
        """The map of the half steps ``k_f`` about the equilibria and the gains ``k_h``."""
        known, features = self._rows(k_f)
        k = known + self.context.dt * k_f @ self.ports @ k_h.K @ features
        details = {"gains": k_h.K.tolist(), "radius": spectral_radius(k[:, self.context.theta.learned_columns])}
        return SplitFit(k, k_h.alpha, k_h.rank, k_h.gap, details)

    def _rows(self, half: Array) -> tuple[Array, Array]:
        """The known map (S, M) with H = 0 and what h depends on (q or 2 q, M), both as rows on Theta."""
        theta = self.context.theta
        learned, features = theta.learned_columns, theta.n_features
        state, start, end = (np.zeros((len(learned), theta.n_columns)) for _ in range(3))
        state[:, learned] = np.eye(len(learned))
        end[:, theta.n_lifted :] = self.equilibrium
        past = theta.n_lifted - features if theta.input_delays else theta.n_lifted
        start[:, past : past + features] = self.equilibrium
        middle = start + half @ (state - start)
        known = end + half @ (middle - end)
        parts = [middle - 0.5 * (start + end)] + ([end - start] if theta.input_delays else [])
        return known, np.vstack([self.loads @ part for part in parts])


def _sizes(columns: Array) -> Array:
    """Root mean square of every column, 1 where it is zero."""
    sizes = np.sqrt((columns**2).mean(axis=0))
    sizes[sizes == 0.0] = 1.0
    return np.asarray(sizes)
