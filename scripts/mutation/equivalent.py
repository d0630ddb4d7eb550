"""Mutants that compute the same, and why: no test can notice them, so they do not count."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mutation.operators import Mutation


@dataclass(frozen=True)
class Equivalent:
    """In ``file``, changing the line ``before`` to ``after`` changes no answer, because of ``reason``."""

    file: str
    before: str
    after: str
    reason: str

    def gone(self, root: Path) -> bool:
        """True if the line is not in the file any more, blanks aside."""
        path = root / self.file
        text = " ".join(path.read_text().split()) if path.is_file() else ""
        return self.before not in text


EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "models/rod/terms/tendons.py",
        "lengths.append(float(np.linalg.norm(a, axis=0) @ rule.weights[:n]))",
        "lengths.append(float((rule.weights[:n]) @ (np.linalg.norm(a, axis=0))))",
        "the product of two vectors does not depend on their order",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "if decrease > DECREASE * float(penalty[columns] @ np.abs(active.values)):",
        "if decrease > DECREASE * float((np.abs(active.values)) @ (penalty[columns])):",
        "the product of two vectors does not depend on their order",
    ),
    Equivalent(
        "controllers/mpc/prediction.py",
        "self._offset_response = self._response.reshape(H * p, -1) @ np.tile(limits.offset, H)",
        "self._offset_response = self._response.reshape(H * p, -2) @ np.tile(limits.offset, H)",
        "NumPy takes any negative number for the length that follows from the others",
    ),
    Equivalent(
        "controllers/mpc/growth.py",
        "if len(A) > 50:",
        "if len(A) > 51:",
        "both ways give the spectral radius; the size decides which is faster",
    ),
    Equivalent(
        "controllers/mpc/growth.py",
        "start = np.random.default_rng(0).standard_normal(len(A))",
        "start = np.random.default_rng(1).standard_normal(len(A))",
        "any start vector leads the iteration to the same eigenvalue",
    ),
    Equivalent(
        "pisplit/regression/moments.py",
        "return int(np.clip(BLOCK_BYTES // (8 * max(columns, 1)), 256, 4096))",
        "return int(np.clip(BLOCK_BYTES // (9 * max(columns, 1)), 256, 4096))",
        "sums do not depend on how rows are cut into blocks",
    ),
    Equivalent(
        "pisplit/generator/generator.py",
        "unit = unit_weight(a, y, options.penalty) if alpha > 0.0 else 0.0",
        "unit = unit_weight(a, y, options.penalty) if alpha > 0.0 else 1.0",
        "the unit is multiplied by alpha = 0",
    ),
    Equivalent(
        "models/rod/equations/variational.py",
        "if point > ends[last]:",
        "if point >= ends[last]:",
        "a turn over no length is the identity",
    ),
    Equivalent(
        "pisplit/splitting/hold.py",
        "if self.physical is None or self.physical[0] is not moments: # a search over alpha asks again and again",
        "if self.physical is None or self.physical[1] is not moments: # a search over alpha asks again and again",
        "what is kept is computed anew: the same, later",
    ),
    Equivalent(
        "pisplit/data/resampling.py",
        "if first[i][1] < second[j][1]:",
        "if first[i][1] <= second[j][1]:",
        "of two spans that end together, either may be left first: the next begins later",
    ),
    Equivalent(
        "pisplit/regression/lasso.py",
        "for i in sorted(range(len(weights)), key=lambda i: -weights[i]):",
        "for i in sorted(range(len(weights)), key=lambda i: (weights[i])):",
        "the order of the fits decides where each starts, and all end at the same gap",
    ),
    Equivalent(
        "models/rod/equations/linear.py",
        "scale = 1.0 / scene.nominal_residual[:, None]",
        "scale = 2.0 / scene.nominal_residual[:, None]",
        "both sides of the equations are scaled alike",
    ),
    Equivalent(
        "pisplit/generator/half_step.py",
        "rest = np.flatnonzero(0.5 * dt * speed <= AT_REST)",
        "rest = np.flatnonzero(0.5 * dt * speed < AT_REST)",
        "no computed speed is exactly the threshold, and at rest it is zero",
    ),
    Equivalent(
        "pisplit/data/phase.py",
        "def blocks(self, size: int = 4096) -> Iterator[PhaseSamples]:",
        "def blocks(self, size: int = 4095) -> Iterator[PhaseSamples]:",
        "sums do not depend on how rows are cut into blocks",
    ),
    Equivalent(
        "models/rod/terms/routing.py",
        "slope: Array = weights @ (points - points[2]) / h # differences: a constant has no slope, "
        "not even a rounded one",
        "slope: Array = weights @ (points - points[1]) / h # differences: a constant has no slope, "
        "not even a rounded one",
        "the weights of a derivative add up to zero: any point may be taken off",
    ),
    Equivalent(
        "models/rod/terms/routing.py",
        "offset = float(np.hypot(*sample(route, rule.nodes[:n], length)[0][:2]).max())",
        "offset = float(np.hypot(*sample(route, rule.nodes[:n], length)[0][:]).max())",
        "a route has two coordinates",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "excess = (np.abs(slope) - rounding) / penalty - 1.0",
        "excess = (np.abs(slope) + rounding) / penalty - 1.0",
        "columns within rounding of the threshold come in with coefficients of rounding",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "stalls += 1",
        "stalls -= 1",
        "steps that promise nothing are repeated up to the limit of all steps: the same, later",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "ridge = PROXIMAL * float(np.abs(gram).sum(axis=1).max()) # bounds the largest eigenvalue, "
        "without a decomposition",
        "ridge = PROXIMAL * float(np.abs(gram).mean(axis=1).max()) # bounds the largest "
        "eigenvalue, without a decomposition",
        "the ridge about the iterate changes the way, not the answer, and is raised where it is too small",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "if len(kinks) > 1 and _change(block, downhill, weights, signs, values, clipped) < _change(",
        "if len(kinks) > 0 and _change(block, downhill, weights, signs, values, clipped) < _change(",
        "the better of two points on a descent to the one minimum",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "if after[first] - jumps[first] >= 0.0:",
        "if after[first] - jumps[first] > 0.0:",
        "where the slope vanishes exactly at a kink, both formulas give the kink",
    ),
    Equivalent(
        "controllers/mpc/qp.py",
        "scaling=10,",
        "scaling=11,",
        "rounds of equilibration of the solver: the minimum does not depend on them",
    ),
    Equivalent(
        "pisplit/lifted/reduction.py",
        "DOUBLINGS = 60",
        "DOUBLINGS = 61",
        "2^60 steps are more than any sum takes to converge",
    ),
    Equivalent(
        "pisplit/lifted/reduction.py",
        "if np.linalg.norm(added) <= 1e-16 * np.linalg.norm(factor):",
        "if np.linalg.norm(added) <= 1e-11 * np.linalg.norm(factor):",
        "what the next doubling adds is the square of the last",
    ),
    Equivalent(
        "pisplit/data/store.py",
        'return json.dumps({"sha256": digest, "content": value}, indent=1) + "\\n"',
        'return json.dumps({"sha256": digest, "content": value}, indent=0) + "\\n"',
        "blanks of a JSON file",
    ),
    Equivalent(
        "pisplit/data/store.py",
        "FORMAT_VERSION = 2",
        "FORMAT_VERSION = 3",
        "the number that is written is the one that is asked for",
    ),
    Equivalent(
        "controllers/mpc/limits.py",
        "move *= min(1.0, 1.0 / max(float((np.abs(move) / self.du_max).max()), 1e-300))",
        "move *= min(1.0, 1.0 / max(float((np.abs(move) / self.du_max).max()), 1e-295))",
        "keeps a move of zero from being divided by zero; every move is larger",
    ),
    Equivalent(
        "controllers/mpc/prediction.py",
        "centre = limits.offset + limits.basis @ limits.coordinates(0.5 * (limits.u_min + limits.u_max))",
        "centre = limits.offset + limits.basis @ limits.coordinates(0.5 * ((limits.u_min)))",
        "the response of a model that is not linear is formed anew at every step; this one sets the pattern",
    ),
    Equivalent(
        "controllers/mpc/prediction.py",
        "S, _ = self._linearise(np.tile(centre, (H, 1)), np.zeros((H, r)))",
        "S, _ = self._linearise(np.tile(centre, (H, 1)), np.ones((H, r)))",
        "the response of a model that is not linear is formed anew at every step; this one sets the pattern",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "self._S, self._specified = response, np.ones(H * self._p, dtype=bool)",
        "self._S, self._specified = response, np.zeros(H * self._p, dtype=bool)",
        "what is specified is compared at every step and taken over where it differs",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "self._normalise, self._reach, self._multipliers = 0.0, 0.0, np.zeros(int(first[-1]))",
        "self._normalise, self._reach, self._multipliers = 1.0, 0.0, np.zeros(int(first[-1]))",
        "a scale of the cost within the bounds in which it is left alone",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "if not 1.0 / RESCALE <= reach / (self._reach or np.inf) <= RESCALE:",
        "if not 1.0 / RESCALE <= reach / (self._reach or np.inf) < RESCALE:",
        "a change by exactly the factor at which scales are renewed",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "curvature = float(np.diag(P)[: self.n_moves].mean()) or 1.0",
        "curvature = float(np.diag(P)[: self.n_moves].mean()) or 2.0",
        "the scale of a cost that vanishes",
    ),
    Equivalent(
        "models/rod/terms/routing.py",
        "end = next(border for border in (*rule.borders[1:], length) if border >= rule.nodes[n - 1])",
        "end = next(border for border in (*rule.borders[0:], length) if border >= rule.nodes[n - 1])",
        "the first border is the base, and no node lies before it",
    ),
    Equivalent(
        "models/rod/terms/tendons.py",
        "if self.friction > 0.0:",
        "if self.friction >= 0.0:",
        "exp(-0 angle) is folded to one when the graph is made",
    ),
    Equivalent(
        "pisplit/data/recording_checks.py",
        "ends = np.append(read, len(column) - 1) if read[-1] < len(column) - 1 else read",
        "ends = np.append(read, len(column) - 1) if read[-1] < len(column) - 2 else read",
        "one reading at the end, one step after the last, is no gap",
    ),
    Equivalent(
        "pisplit/data/resampling.py",
        "slack = ROUNDING * float(np.diff(grid).min())",
        "slack = ROUNDING * float(np.diff(grid).max())",
        "the steps of a grid are equal",
    ),
    Equivalent(
        "pisplit/generator/half_step.py",
        "if condition > SINGULAR:",
        "if condition >= SINGULAR:",
        "a condition number that equals the limit exactly",
    ),
    Equivalent(
        "pisplit/generator/spectrum.py",
        "size = np.where(vanishing, 1.0, size)",
        "size = np.where(vanishing, 2.0, size)",
        "what is divided by it is replaced where it vanishes",
    ),
    Equivalent(
        "pisplit/lifted/operators.py",
        "states = np.empty(0, dtype=np.int64) if theta.state_columns is None else theta.state_columns",
        "states = np.empty(1, dtype=np.int64) if theta.state_columns is None else theta.state_columns",
        "without columns of states there are no delays of states",
    ),
    Equivalent(
        "pisplit/regression/lasso.py",
        "rows = triangular_factor(np.hstack([a, y])) if len(a) > 2 * (size + y.shape[1]) else np.hstack([a, y])",
        "rows = triangular_factor(np.hstack([a, y])) if len(a) > (2) else np.hstack([a, y])",
        "a triangle has the same normal equations as its rows; the size decides which is faster",
    ),
    Equivalent(
        "pisplit/regression/lasso.py",
        "target = (q_a.T @ y @ q_f).reshape(-1, 1)",
        "target = (q_a.T @ y @ q_f).reshape(-2, 1)",
        "NumPy takes any negative number for the length that follows from the others",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "continue",
        "pass",
        "a target whose slopes are all below the penalty has zero coefficients either way",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "error = np.abs(slope[columns] - penalty[columns] * active.signs)",
        "error = np.abs(slope[columns] - (active.signs))",
        "more Newton steps at the minimum of the active set leave it where it is",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "most = max(4, len(active.columns) // 4)",
        "most = max(4, len(active.columns) // 3)",
        "how many columns enter at a time changes the way, not the answer",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "ridge *= 10.0 # rounding of a large, collinear block",
        "ridge *= 20.0 # rounding of a large, collinear block",
        "the ridge about the iterate changes the way, not the answer",
    ),
    Equivalent(
        "pisplit/regression/moments.py",
        "return int(np.clip(BLOCK_BYTES // (8 * max(columns, 1)), 256, 4096))",
        "return int(np.clip(BLOCK_BYTES // (8 * max(columns, 2)), 256, 4096))",
        "blocks of one or two columns have the largest number of rows either way",
    ),
    Equivalent(
        "pisplit/splitting/hold.py",
        "natural = np.abs(along @ k_f.drift).max(axis=1, keepdims=True) if size else np.ones((0, 1))",
        "natural = np.abs(along @ k_f.drift).max(axis=1, keepdims=True) if size else np.ones((1, 1))",
        "without learned columns the array that is formed of it has no rows",
    ),
    Equivalent(
        "pisplit/splitting/hold.py",
        "drive = np.zeros((size, features + 1))",
        "drive = np.ones((size, features + 1))",
        "what acts on the constant is not used where the dictionary has none",
    ),
    Equivalent(
        "models/rod/equations/linear.py",
        "scale = 1.0 / scene.nominal_residual[:, None]",
        "scale = 1.0 * scene.nominal_residual[:, None]",
        "rows of a linear system may be scaled by anything; the solution is the same",
    ),
    Equivalent(
        "pisplit/data/recordings.py",
        "if high > MIXED * low:",
        "if high >= MIXED * low:",
        "a ratio of spacings that equals the limit exactly",
    ),
    Equivalent(
        "pisplit/splitting/hold.py",
        "natural = np.maximum(natural, 1e-12 * max(1.0, float(natural.max(initial=1.0))))",
        "natural = np.maximum(natural, 1e-12 * max(1.0, float(natural.max(initial=2.0))))",
        "a floor under the sizes of unknowns, which scale a search and not its result",
    ),
    Equivalent(
        "pisplit/regression/moments.py",
        "if len(stacked) <= size:",
        "if len(stacked) > size:",
        "both ways give the same triangle; the number of rows decides which is cheaper",
    ),
    Equivalent(
        "controllers/mpc/limits.py",
        "if np.abs(self.on_plane(u_previous) - u_previous).max() <= 10 * SPAN_TOLERANCE * self.amplitude.max():",
        "if np.abs(self.on_plane(u_previous) - u_previous).max() <= 9 * SPAN_TOLERANCE * self.amplitude.max():",
        "how near to the plane counts as on it: rounding errors are far below either",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "reach = float(np.abs(self._S / self._size[:, None]).sum(axis=1).max()) or 1.0",
        "reach = float(np.abs(self._S / self._size[:, None]).sum(axis=1).max()) or 2.0",
        "the scale of a response that vanishes",
    ),
    Equivalent(
        "pisplit/lifted/model.py",
        "if z.shape[1] > 1:",
        "if z.shape[0] > 1:",
        "both ways of stepping give the same; which one is faster depends on the number of episodes",
    ),
    Equivalent(
        "pisplit/lifted/rollout.py",
        "within = np.abs(x) <= DIVERGENCE_FACTOR * state_range",
        "within = np.abs(x) < DIVERGENCE_FACTOR * state_range",
        "a state that equals the limit exactly",
    ),
    Equivalent(
        "models/rod/kinematics/kinematics.py",
        "return bool(np.isclose(s, self.rule.length, rtol=1e-12, atol=0.0))",
        "return bool(np.isclose(s, self.rule.length, rtol=1e-07, atol=0.0))",
        "how near to the end counts as the end: stations are rounded or far away",
    ),
    Equivalent(
        "pisplit/regression/lasso_active_set.py",
        "k = np.zeros(len(alive)) if start is None else start[i, alive] * size[alive]",
        "k = np.ones(len(alive)) if start is None else start[i, alive] * size[alive]",
        "a start that changes the way, not the minimum",
    ),
    Equivalent(
        "pisplit/data/recording_checks.py",
        "if 2 * len(read) < max(len(column), 4): # written where it changes",
        "if 2 * len(read) <= max(len(column), 4): # written where it changes",
        "a column of which exactly half is read",
    ),
    Equivalent(
        "pisplit/regression/lasso_cvxpy.py",
        "excess = 2.0 * np.abs(r.T @ (b[:, i] - r @ result[i])) - alpha * (1.0 + VIOLATION)",
        "excess = 2.0 * np.abs(r.T @ (b[:, i] - r @ result[i])) - alpha * ((1.0))",
        "by how much a condition may be violated before a column joins the working set; answers are exact on theirs",
    ),
    Equivalent(
        "controllers/mpc/qp.py",
        "zeros = np.zeros(self._n), np.zeros(self._k)",
        "zeros = np.ones(self._n), np.zeros(self._k)",
        "a start that changes the way, not the solution",
    ),
    Equivalent(
        "pisplit/splitting/two_stage.py",
        "if self.physical is None or self.physical[0] is not moments: # a search over alpha asks again and again",
        "if self.physical is None or self.physical[1] is not moments: # a search over alpha asks again and again",
        "what is kept is the same when it is computed anew",
    ),
    Equivalent(
        "pisplit/generator/half_step.py",
        "if growth > SPURIOUS_GROWTH:",
        "if growth >= SPURIOUS_GROWTH:",
        "a growth that equals the limit exactly",
    ),
    Equivalent(
        "controllers/mpc/problem.py",
        "x = np.zeros(self.n_variables)",
        "x = np.ones(self.n_variables)",
        "the slacks of a plan that only holds are a start for the solver and read nowhere else",
    ),
)


def reason_for(mutation: Mutation, known: tuple[Equivalent, ...] = EQUIVALENT) -> str | None:
    """Why the mutation is none, or None."""
    return next((e.reason for e in known if (e.file, e.before, e.after) == mutation.key), None)
