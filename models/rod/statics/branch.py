"""Which equilibrium: the one that slow loading reaches, or a word that it is another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pisplit.checks import Array
from pisplit.models.rod.sharing import Rebuilt
from pisplit.models.rod.statics.certificate import Certificate, without_energy
from pisplit.models.rod.statics.descent import Judge
from pisplit.models.rod.statics.flutter import Flutter, Spot, Vibration
from pisplit.models.rod.statics.path import Event, Walk, walk
from pisplit.models.rod.statics.search import Search, attempt
from pisplit.models.rod.statics.whitened import Whitened

#: Share of the load factor up to which an equilibrium is unique that is used, and the least one worth unloading to.
SAFE, WORTH_UNLOADING = 0.98, 0.2
#: Residual down to which the end of a walk is polished by Newton's method.
POLISHED = 1e-9
#: Largest change of a scaled unknown by the last steps of Newton's method at the end of a walk.
SAME = 1e-3
#: Force, in parts of EI/L, at which a given state counts as an equilibrium that can be followed.
RESTING = 1e-6


@dataclass(frozen=True)
class Verdict:
    """What is known of an equilibrium.

    Attributes:
        x: scaled unknowns (n,).
        branch: "unique", "followed", "snapped", "flutters" or "unverified": see ``Equilibrium``.
        stable: whether no deformation goes on by itself and no vibration grows.
        load_factor: part of the loads up to which loading was followed without loss of stability.
        message: what happened on the way, empty if nothing did.
    """

    x: Array
    branch: str
    stable: bool
    load_factor: float
    message: str


#: Branches that a rod does not take.
LOST = ("unverified", "flutters")


class Branches(Rebuilt):
    """Tells the branch of equilibria of a scene.

    A root of the balance may be any of many, and most of them no arm takes. Where the energy is convex whatever the
    shape (``Certificate``) there is one. Else the root is unloaded, in steps under which it stays stable, to the load
    factor below which there is one; where that fails or is long, loading is followed from nothing (``walk``).

    Args:
        search: the scaled balance.
    """

    def __init__(self, search: Search) -> None:
        self.search = search

    @cached_property
    def whitened(self) -> Whitened:
        """The balance in which stability is judged."""
        return Whitened(self.search)

    @cached_property
    def certificate(self) -> Certificate:
        """Proof of uniqueness."""
        return Certificate(self.search.scene)

    @cached_property
    def judge(self) -> Judge:
        """Tells stable shapes."""
        return Judge(not without_energy(self.search.scene))

    @cached_property
    def flutter(self) -> Flutter:
        """Tells shapes about which vibrations grow."""
        return Flutter(self.whitened)

    def unique(self, u: Array) -> bool:
        """Whether there is only one equilibrium under ``u`` (n_inputs,), as far as can be proved."""
        return SAFE * self.certificate.unique_below(u) >= 1.0

    def all_unique(self, rows: Array) -> bool:
        """Whether there is only one equilibrium under each of ``rows`` (N, n_inputs), as far as can be proved."""
        return bool(np.all(SAFE * self.certificate.unique_below_of_rows(rows) >= 1.0))

    def of_root(self, x: Array, u: Array, converged: bool) -> Verdict:
        """The equilibrium that loading from nothing reaches, given a candidate.

        Args:
            x: unknowns (n,) of the candidate.
            u: inputs (n_inputs,).
            converged: whether it is a root at all.
        """
        unique_to = SAFE * self.certificate.unique_below(u)
        if converged and unique_to >= 1.0:
            return Verdict(x, "unique", True, 1.0, "")
        if converged and unique_to >= WORTH_UNLOADING and self._unloads(x, u, unique_to):
            return Verdict(x, "followed", True, 1.0, "")
        found = walk(self.whitened.loading(u), np.zeros(len(x)), self.judge)
        return self._verdict(found, u, "of the loads", None)

    def of_state(self, x: Array, u: Array, start: Array, before: Array, converged: bool) -> Verdict:
        """The equilibrium that is reached from another one by moving the inputs.

        Args:
            x: unknowns (n,) of a candidate.
            u: inputs (n_inputs,).
            start: unknowns (n,) at rest under the inputs ``before`` (n_inputs,).
            before: the inputs to start from.
            converged: whether ``x`` is a root at all.
        """
        if converged and self.unique(u):
            return Verdict(x, "unique", True, 1.0, "")
        found = walk(self.whitened.commands(before, u), self.whitened.of(start), self.judge)
        return self._verdict(found, u, "of the change of the inputs", before)

    def near(self, x: Array, u: Array) -> Verdict:
        """The equilibrium ``x`` (n,) under ``u`` (n_inputs,) near a guess: its stability is known, its history not."""
        if self.unique(u):
            return Verdict(x, "unique", True, 1.0, "")
        stiffness = self.whitened.stiffness(self.whitened.of(x), u)
        stable = self.judge.stable(stiffness)
        margin = self.judge.softest(stiffness)[0] if np.isfinite(stiffness).all() else -np.inf
        message = "" if stable else f"the equilibrium near the guess is unstable (margin {margin:.2g}); leave guess out"
        if stable and not self.judge.has_energy:
            vibration = self.flutter.at(self.whitened.of(x), u)
            if vibration is not None:
                return Verdict(x, "flutters", False, 0.0, f"the equilibrium near the guess flutters: {vibration}")
        return Verdict(x, "given" if stable else "unverified", stable, 1.0 if stable else 0.0, message)

    def rests(self, x: Array, u: Array) -> bool:
        """Whether unknowns ``x`` (n,) are at rest under ``u`` (n_inputs,)."""
        return self.search.worst(x, u) <= RESTING

    def margin(self, x: Array, u: Array) -> float:
        """Least stiffness of unknowns ``x`` (n,) under ``u`` (n_inputs,), in parts of the elastic one."""
        stiffness = self.whitened.stiffness(self.whitened.of(x), u)
        return self.judge.softest(stiffness)[0] if np.isfinite(stiffness).all() else -np.inf

    def _unloads(self, x: Array, u: Array, to: float) -> bool:
        """Whether the root is stable and stays so until the load factor ``to``, where there is only one."""
        y = self.whitened.of(x)
        if not self.judge.stable(self.whitened.stiffness(y, u)):
            return False
        return walk(self.whitened.loading(u, 1.0, to), y, self.judge, snaps=False).success

    def _verdict(self, found: Walk, u: Array, of_what: str, before: Array | None) -> Verdict:
        """What a walk under the inputs ``u``, or from the inputs ``before`` to them, ``found``."""
        x = self.whitened.unknowns(found.y)
        if found.success and self.search.worst(x, u) > POLISHED:  # a walk ends with a force that is small, not zero
            exact = attempt(self.search.newton, x, u)
            x = exact if np.abs(exact - x).max() < SAME else x
        lost = [told(e, of_what) for e in found.events]
        first = found.events[0].at if found.events else 1.0
        if not found.success:
            if found.events and not found.events[-1].at_rest:
                message = f"lost stability at {', '.join(lost)} and found no rest behind"
            else:
                message = f"no equilibrium found: loading was followed to {found.t:.3g} {of_what}"
            return Verdict(x, "unverified", False, min(first, found.t), message)
        at_end, met = self._shaken(found, x, u, before)
        if met is not None:
            lost.append(f"{met[0]:.4g} {of_what} (flutter: {met[1]})")
            first = min(first, met[0])
        if at_end is not None:
            return Verdict(
                x, "flutters", False, first, f"lost stability at {', '.join(lost)}; there is no rest: {at_end}"
            )
        message = f"lost stability at {', '.join(lost)}; this is where it rests behind" if lost else ""
        return Verdict(x, "snapped" if lost else "followed", True, first, message)

    def _shaken(
        self, found: Walk, x: Array, u: Array, before: Array | None
    ) -> tuple[Vibration | None, tuple[float, Vibration] | None]:
        """The vibration that grows about the end ``x`` of a walk, and where on its way one does first."""
        if self.judge.has_energy:
            return None, None
        y = self.whitened.of(x)
        there = self.whitened.stiffness(y, u) if found.stiffness is None else found.stiffness
        places = (*found.passed, (1.0, y, there))
        if before is None:
            return self.flutter.met([Spot(t, y, u, t, h) for t, y, h in places])
        return self.flutter.met([Spot(t, y, before + t * (u - before), 1.0, h) for t, y, h in places])


def told(event: Event, of_what: str) -> str:
    """An ``event`` in words; ``of_what`` its parameter is a part."""
    what = "snap-through" if event.kind == "fold" else "buckling"
    return f"{event.at:.4g} {of_what} ({what})"
