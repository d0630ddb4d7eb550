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
        "models/rod/equations/tangent.py",
        'scene.__dict__["_stiffness"] = ca.Function("stiffness", [xi, u], pair, {"cse": True})',
        'scene.__dict__["_stiffness"] = ca.Function("stiffness", [xi, u], pair, {"cse": False})',
        "common subexpressions cost time and change no value",
    ),
    Equivalent(
        "controllers/mpc/mpc.py",
        "self._offset_response = self._response.reshape(H * p, -1) @ np.tile(limits.offset, H)",
        "self._offset_response = self._response.reshape(H * p, -2) @ np.tile(limits.offset, H)",
        "NumPy takes any negative number for the length that follows from the others",
    ),
    Equivalent(
        "controllers/mpc/mpc.py",
        "if len(A) > 50:",
        "if len(A) > 51:",
        "both ways give the spectral radius; the size decides which is faster",
    ),
    Equivalent(
        "controllers/mpc/mpc.py",
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
)


def reason_for(mutation: Mutation, known: tuple[Equivalent, ...] = EQUIVALENT) -> str | None:
    """Why the mutation is none, or None."""
    return next((e.reason for e in known if (e.file, e.before, e.after) == mutation.key), None)
