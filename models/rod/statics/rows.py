"""Equilibria of many inputs, and along a path of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.statics.branch import LOST, RESTING
from pisplit.models.rod.statics.equilibrium import Equilibrium, EquilibriumBatch
from pisplit.models.rod.statics.search import TOLERANCE, attempt

if TYPE_CHECKING:
    from pisplit.models.rod.statics.statics import Statics


def one_by_one(statics: Statics, rows: Array, near: Array | None, follow: bool, progress: bool) -> EquilibriumBatch:
    """Equilibria by one solve a row.

    Args:
        statics: solves them.
        rows: inputs (N, n_inputs).
        near: states (N, n_states) to start from.
        follow: whether each starts from the one before it.
        progress: whether to show a bar.
    """
    found: list[Equilibrium] = []
    last: Array | None = None
    for k, u in enumerate(_bar(rows, disable=not progress, desc="equilibria", unit="row")):
        found.append(statics.solve(u, last if near is None else near[k]))
        last = found[-1].state if follow and found[-1].success else last
    return EquilibriumBatch(
        np.array([f.state for f in found]).reshape(len(rows), statics.scene.n_states),
        np.array([f.success for f in found], dtype=bool),
        np.array([f.residual for f in found]),
        np.array([f.tensions for f in found]).reshape(len(rows), -1),
        np.array([f.branch for f in found], dtype=str),
        np.array([f.load_factor for f in found]),
        scene=statics.scene,
    )


def solve_rows(
    statics: Statics, rows: Array, near: Array | None, chunk: int, progress: bool, threads: int
) -> EquilibriumBatch:
    """Equilibria by a few calls for all rows; those that are not the only ones are judged one by one.

    Args:
        statics: solves them.
        rows: inputs (N, n_inputs).
        near: states at rest (N, n_states) from which the inputs are moved to ``rows``.
        chunk: rows solved by one call.
        progress: whether to show a bar.
        threads: chunks side by side.
    """
    scene, search, branches = statics.scene, statics.search, statics.branches
    found = np.empty((len(rows), scene.n_strains))
    worst = np.empty(len(rows))
    mild, resting = branches.all_unique(rows), np.zeros(len(rows), dtype=bool)
    if near is None:
        guess = _affine_guess(statics, rows)
    else:
        strains, *_, before = scene.layout.split(near)
        guess = search.scaled(strains)
        resting = search.worst_of_rows(guess, before) <= RESTING
    for part in _bar(_parts(len(rows), chunk, threads), disable=not progress, desc="equilibria", unit="block"):
        block = rows[part]
        solver = search.of_rows(min(chunk, len(block)), -(-len(block) // chunk), mild)
        found[part] = x = np.asarray(solver(guess[part].T, block.T)).T
        worst[part] = search.worst_of_rows(x, block)
    branch, factor, zero = np.full(len(rows), "unique", dtype=object), np.ones(len(rows)), np.zeros(scene.n_strains)
    open_rows = np.flatnonzero(worst > TOLERANCE) if mild else np.arange(len(rows))
    for k in _bar(open_rows, disable=not progress or mild, desc="branches", unit="row"):
        x, u = found[k].copy(), rows[k]
        if resting[k]:
            verdict = branches.of_state(x, u, guess[k], before[k], worst[k] <= TOLERANCE)
        else:
            if worst[k] > TOLERANCE:
                x, _, _ = search.find(u, zero, branches.unique(u))
            verdict = branches.of_root(x, u, search.worst(x, u) <= TOLERANCE)
        found[k], worst[k] = verdict.x, search.worst(verdict.x, u)
        branch[k], factor[k] = verdict.branch, verdict.load_factor
    strains = search.strains(found)
    readings = statics.readings(strains, rows)
    tensions = readings[:, : readings.shape[1] // 3]
    branch[worst > TOLERANCE] = "unverified"
    return _checked(statics, scene.at_rest(strains, rows), branch, worst, tensions, factor)


def _parts(rows: int, chunk: int, threads: int) -> list[slice]:
    """Rows of every call: as many whole chunks as there are threads, then chunk by chunk what is left."""
    together = threads * chunk
    found = [slice(start, start + together) for start in range(0, rows - together + 1, together)]
    return found + [slice(s, min(s + chunk, rows)) for s in range(found[-1].stop if found else 0, rows, chunk)]


def follow_rows(statics: Statics, rows: Array) -> EquilibriumBatch:
    """Equilibria along a path, each from where the tangent of the last good one leads.

    Args:
        statics: solves them.
        rows: inputs (N, n_inputs) in the order of the path.
    """
    scene, search = statics.scene, statics.search
    found, tensions = np.empty((len(rows), scene.n_strains)), []
    worst, factor = np.empty(len(rows)), np.ones(len(rows))
    branch = np.full(len(rows), "unverified", dtype=object)
    x, before = np.zeros(scene.n_strains), None
    for k, u in enumerate(rows):
        guess = x if before is None else x + search.along(x, before, u - before)
        candidate = attempt(search.newton, guess, u)
        converged = search.worst(candidate, u) <= TOLERANCE
        if before is None:
            verdict = statics.branches.of_root(candidate, u, converged)
        else:
            verdict = statics.branches.of_state(candidate, u, x, before, converged)
        found[k] = verdict.x
        worst[k] = search.worst(found[k], u)
        if worst[k] <= TOLERANCE:
            branch[k] = verdict.branch
        if branch[k] not in LOST:
            x, before = found[k], u
        factor[k] = verdict.load_factor
        tensions.append(statics.read(found[k], u)[0])
    return _checked(statics, scene.at_rest(search.strains(found), rows), branch, worst, np.array(tensions), factor)


def _checked(
    statics: Statics, states: Array, branch: np.ndarray, worst: Array, tensions: Array, factor: Array
) -> EquilibriumBatch:
    """The batch, after its most bent shape was looked at."""
    good = ~np.isin(branch.astype(str), LOST)
    statics.check(states, good)
    return EquilibriumBatch(states, good, worst, tensions, branch.astype(str), factor, scene=statics.scene)


def _affine_guess(statics: Statics, rows: Array) -> Array:
    """Guesses (N, n) affine in u, fitted to the equilibria of the first rows: a third of a zero guess's steps."""
    n, pilots = statics.scene.n_strains, 4 * (statics.scene.n_inputs + 1)
    if len(rows) < 4 * pilots:
        return np.zeros((len(rows), n))
    zero = np.zeros(n)
    solved = np.array([statics.search.find(u, zero, statics.branches.unique(u))[0] for u in rows[:pilots]])
    lift = np.hstack([np.ones((pilots, 1)), rows[:pilots]])
    coefficients = np.linalg.lstsq(lift, solved, rcond=None)[0]
    return np.asarray(coefficients[0] + rows @ coefficients[1:])


def _bar(items: Iterable[Any], **options: Any) -> Iterable[Any]:
    """``items`` with a bar of progress."""
    from tqdm import tqdm  # slow to load, and of no use to a single equilibrium

    bar: Iterable[Any] = tqdm(items, **options)
    return bar
