"""The hold split: known and unknown generators added, inputs linear over the step, one exponential.

Strang splitting kicks once a step. Where the unknown part is stiff (tendons of a loaded arm: f and h both large, and
cancelling) one kick is a poor model of what h does over the step. Here the generators are added before the exponential,
which is the limit of the splitting for many sub-steps:

    d/dt psi = L_f [psi; phi] + P H D [psi; phi],      psi_{k+1} = F psi_k + G_0 phi_{k-1} + G_1 phi_k

L_f comes from phase-space samples (gEDMD), the few numbers H from trajectories; P are the directions in which the
unknown part can act (ports) and D the features it can depend on.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from pisplit.checks import finite_array
from pisplit.generator import generator_edmd, spectral_radius
from pisplit.regression.kept import Kept
from pisplit.regression.moments import Moments
from pisplit.splitting.base import SplitContext, SplitFit, Unknown
from pisplit.splitting.options import check_options, directions, generator_samples, ports
from pisplit.splitting.two_stage import departed, departure

Array = NDArray[np.float64]

#: Grids of alpha="cv": from the data alone to the physical map alone.
GRIDS = {"ridge": tuple(np.logspace(-8, 3, 12).tolist()), "lasso": (0.0, *np.logspace(-8, 0, 9).tolist())}


@dataclass(frozen=True)
class KnownRates:
    """d/dt psi = drift psi + drive [phi; 1]: ``drift`` (S, S) and ``drive`` (S, P + 1) of the known part [1/s]."""

    drift: Array
    drive: Array


class Hold:
    """L = L_f + P H D, exponentiated with inputs held (linear over the step when the dictionary delays inputs).

    Options of the estimator (S learned columns, P input features, r ports):
        tangent      PhaseSamples for L_f (default: d2): samples close to one state give the exact linearisation there,
                     also of a stiff f, whose average over a large region is no generator of anything.
        equilibrium  E (S, P) with psi_eq(u) = E phi(u). Both parts then act on the deviation psi - E phi only, and
                     every equilibrium is kept exactly: f stands for the known part with the static load that holds
                     x_eq(u).
        ports        (S, r) directions of h; default: unit vectors of ``rows`` (all learned columns).
        loads        (q, S) rows that select what h depends on, from the deviation; default: all of it. Without
                     ``equilibrium`` h depends on all columns, or on input columns only with rows="inputs".

    ``alpha`` is the weight of a second regression, K = argmin |K Theta - psi'|^2 + alpha |K - K_0|, toward the physical
    map K_0: large alpha keeps K_0, alpha = 0 is EDMDc. ``penalty`` is ridge, |K - K_0|^2, or a LASSO, |K - K_0|_1: a
    sparse departure from the physical map.

    context  what it may use (:class:`pisplit.splitting.SplitContext`)
    """

    def __init__(self, context: SplitContext) -> None:
        check_options(context, "hold")
        theta = context.theta
        self.samples = generator_samples(context, "hold")
        self.context = context
        self.alphas = GRIDS[context.penalty]
        self.learned = theta.learned_columns
        self.inputs = np.arange(theta.n_lifted, theta.n_columns)
        self.scale = context.scale[self.learned]
        self.deviation = self._deviation(len(self.learned), len(self.inputs))
        self.ports = ports(context)
        self.physical: Kept[tuple[Array, dict[str, Any]]] = Kept()

    def known(self) -> KnownRates:
        """L_f from phase samples (paper, eq. cont_koopman_solve): what the state and the inputs do to psi."""
        theta, context = self.context.theta, self.context
        ones = np.ones(theta.n_columns)
        generator = generator_edmd(theta, self.samples, ones, context.generator_alpha, context.known)
        size, features = len(self.learned), len(self.inputs)
        drift = generator[np.ix_(self.learned, self.learned)]
        drive = np.zeros((size, features + 1))
        drive[:, :features] = generator[np.ix_(self.learned, self.inputs)]
        if theta.constant_column is not None:
            drive[:, features] = generator[self.learned, theta.constant_column]
        if "equilibrium" in context.options:
            drive = -drift @ self._equilibrium(size, features)
        return KnownRates(drift, drive)

    def unknown(self, k_f: KnownRates, moments: Moments, alpha: float) -> Unknown:
        """H beside the known rates ``k_f`` from ``moments`` of pairs, then the departure that ``alpha`` weighs."""
        physical, details = self.physical(moments, lambda: self._physical(k_f, moments))
        return departure(self.context, physical, moments, alpha, details)

    def composed(self, k_f: KnownRates, k_h: Unknown) -> SplitFit:
        """The one-step map of the rates ``k_f`` and H, plus the departure ``k_h``."""
        return departed(self.context, k_h)

    def _physical(self, k_f: KnownRates, moments: Moments) -> tuple[Array, dict[str, Any]]:
        """K_0 (S, M) in physical units, and facts about it."""
        size = self.context.theta.n_columns
        data = moments.rows(centred=False)
        a, y = data[:, :size], data[:, size:]
        if self._free() and np.linalg.matrix_rank(a / self.context.scale) == size:
            warnings.warn(
                "split='hold' leaves h free in every row and of every column, so that f has no effect on these data; "
                "say where h acts: rows, options['ports'] or options['loads']",
                stacklevel=10,
            )
        gains = self._identify(k_f, a, y)
        transition = scipy.linalg.expm(self.context.dt * self._rates(k_f, gains)[:, : len(self.learned)])
        return self._discrete(k_f, gains), {"gains": gains.tolist(), "radius": spectral_radius(transition)}

    def _free(self) -> bool:
        """True if P H D can be any generator: whatever f is, h makes up for it."""
        everywhere = np.linalg.matrix_rank(self.ports) == len(self.learned)
        wanted = len(self.learned) if "equilibrium" in self.context.options else self.context.theta.n_columns
        past = 0 if "equilibrium" in self.context.options or not self.context.theta.input_delays else len(self.inputs)
        return bool(everywhere and np.linalg.matrix_rank(self.deviation) >= wanted - past)

    def _identify(self, k_f: KnownRates, a: Array, y: Array) -> Array:
        """H (r, q) that minimises the one-step residual, from H = 0 (the known physics) by least squares."""
        from scipy.optimize import least_squares  # slow to load, and needed here alone

        shape = (self.ports.shape[1], self.deviation.shape[0])
        unit = self._load_unit(k_f)

        def residual(h: Array) -> Array:
            with np.errstate(over="ignore", invalid="ignore"):
                difference = (y - a @ self._discrete(k_f, h.reshape(shape) * unit).T) / self.scale
            flat: Array = np.nan_to_num(difference, nan=1e6, posinf=1e6, neginf=-1e6).ravel()
            return flat

        found = least_squares(residual, np.zeros(shape[0] * shape[1]), method="trf", x_scale=1.0)
        gains: Array = found.x.reshape(shape) * unit
        return gains

    def _load_unit(self, k_f: KnownRates) -> Array:
        """Size of each gain that changes the known drift by as much as itself: makes the unknowns comparable."""
        along = np.linalg.pinv(self.ports)
        size = len(self.learned)
        natural = np.abs(along @ k_f.drift).max(axis=1, keepdims=True) if size else np.ones((0, 1))
        natural = np.maximum(natural, 1e-12 * max(1.0, float(natural.max(initial=1.0))))
        unit: Array = np.broadcast_to(natural, (self.ports.shape[1], self.deviation.shape[0])).copy()
        return unit

    def _rates(self, k_f: KnownRates, gains: Array) -> Array:
        """d/dt psi from [psi; phi; 1], known and unknown part (S, S + P + 1)."""
        return np.hstack([k_f.drift, k_f.drive]) + self.ports @ gains @ self.deviation

    def _discrete(self, k_f: KnownRates, gains: Array) -> Array:
        """Rows K (S, M) of the one-step map: Van Loan's exponential with inputs linear (or constant) over the step."""
        theta, dt = self.context.theta, self.context.dt
        size, width = len(self.learned), k_f.drive.shape[1]
        block = np.zeros((size + 2 * width, size + 2 * width))
        block[:size, : size + width] = self._rates(k_f, gains)
        block[size : size + width, size + width :] = np.eye(width)
        step = np.asarray(scipy.linalg.expm(dt * block))
        held, ramp = step[:size, size : size + width], step[:size, size + width :] / dt
        k = np.zeros((size, theta.n_columns))
        k[:, self.learned] = step[:size, :size]
        features = len(self.inputs)
        if theta.input_delays:
            past = np.arange(theta.n_lifted - features, theta.n_lifted)
            k[:, past] = (held - ramp)[:, :features]
            k[:, self.inputs] = ramp[:, :features]
        else:
            k[:, self.inputs] = held[:, :features]
        if theta.constant_column is not None:
            k[:, theta.constant_column] = held[:, features]
        return k

    def _equilibrium(self, size: int, features: int) -> Array:
        given = finite_array(self.context.options["equilibrium"], "options['equilibrium']", (size, features))
        return np.hstack([given, np.zeros((size, 1))])

    def _deviation(self, size: int, features: int) -> Array:
        """D (q, S + P + 1): features of h from [psi; phi; 1]."""
        options = self.context.options
        if "equilibrium" in options:
            full = np.hstack([np.eye(size), -self._equilibrium(size, features)])
            if "loads" not in options:
                return full
            return np.asarray(directions(options["loads"], "loads", (None, size)) @ full)
        if "loads" in options:
            raise ValueError("options['loads'] selects from the deviation; give options['equilibrium'] too")
        every = np.eye(size + features + 1)
        if self.context.theta.constant_column is None:
            every = every[:-1]
        return every[size : size + features] if self.context.rows == "inputs" else every
