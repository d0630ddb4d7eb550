"""Columns with kinks of re-lifted models: tendons that go slack, and friction that turns round."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pisplit import observables as ob
from pisplit.data.pairs import Pairs
from pisplit.estimators.relifted_coordinates import Coordinates, joined_tables, kinked_table
from pisplit.lifted.relifting import GATE, HINGE

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Parts of a step at which the stretch of tendons is looked at.
PARTS = (0.0, 0.5, 1.0)


@dataclass(frozen=True)
class Kinked:
    """What kinks are made of: stretch of tendons (``tension``) and speeds of slip (``slip``), none where not given."""

    tension: ob.Tension | None = None
    slip: ob.Slip | None = None

    def __post_init__(self) -> None:
        for value, kind, name in ((self.tension, ob.Tension, "tension"), (self.slip, ob.Slip, "slip")):
            if value is not None and not isinstance(value, kind):
                told = f"expected pisplit.observables.{kind.__name__}, such as arm.{name}() gives"
                raise ValueError(f"{name} = {value!r}; {told}")

    def columns(self, coordinates: Coordinates, pairs: Pairs, dt: float, factors: Index) -> tuple[Array, Index]:
        """Kinks as ``ReliftedTerm`` takes them, and ``factors`` with the products of kinks below.

        Args:
            coordinates: of the states.
            pairs: by which stretch and slip are told from the coordinates.
            dt: time step in s.
            factors: (P, d) products of the coordinates alone.
        """
        variables = len(coordinates.variables[1])
        kinks: Array = np.zeros((0, coordinates.sizes[0] + 2 * coordinates.sizes[2] + 3))
        found = [] if self.tension is None else [stretched(self.tension, coordinates, pairs, dt)]
        found += [] if self.slip is None else [sliding(self.slip, coordinates, pairs)]
        for more, hinges, sets in found:
            table = kinked_table(variables + len(kinks), variables, hinges, sets)
            before, after = variables + len(kinks), variables + len(kinks) + len(more)
            factors, kinks = joined_tables(factors, table, before, after), np.vstack([kinks, more])
        return kinks, factors


def stretched(
    tension: ob.Tension, coordinates: Coordinates, pairs: Pairs, dt: float
) -> tuple[Array, int, Sequence[tuple[int, ...]]]:
    """Kinks of the stretch of tendons, how many of them are hinges, and the gates that are multiplied.

    What the state adds to the stretch of a ``tension`` is linear in the components of the ``coordinates`` to rounding
    where they are many, and by least squares over the ``pairs`` where they are few. ``dt`` is the time step in s.
    """
    r, _, m = coordinates.sizes
    x = np.vstack([pairs.x, pairs.x_next])
    design = np.hstack([(x - coordinates.mean) @ coordinates.encode.T, np.ones((len(x), 1))])
    told = np.hstack(tension.along(x, m))
    slope = np.linalg.lstsq(design, told, rcond=1e-10)[0].T  # (2 m, r + 1)
    unit = float(np.sqrt(((pairs.u - coordinates.offset) ** 2).mean(axis=0)).max()) or 1.0
    rows = []
    for part in PARTS:
        of_state = slope[:m] + part * dt * slope[m:]
        eye = np.eye(m)
        rows.append(np.hstack([of_state[:, :r], (1.0 - part) * eye, part * eye, of_state[:, r:]]) / unit)
    kind = [(row, HINGE, w) for w in tension.widths for block in rows for row in block]
    gates = [(row, GATE, tension.gate) for block in (rows[-1], rows[0]) for row in block]
    kinks = np.array([[*row, k, w] for row, k, w in [*kind, *gates]])
    first = len(kind)
    last = [first + i for i in range(m)]
    return kinks, first, [(i,) for i in range(first, len(kinks))] + list(combinations(last, 2))


def sliding(slip: ob.Slip, coordinates: Coordinates, pairs: Pairs) -> tuple[Array, int, Sequence[tuple[int, ...]]]:
    """Kinks of the mean ``slip`` over the coming step, all of them gates; see :func:`stretched`.

    The mean of begin and end of the step is told from the components of the ``coordinates`` and both inputs by least
    squares over the ``pairs``.
    """
    before = (pairs.x - coordinates.mean) @ coordinates.encode.T
    design = np.hstack([before, pairs.u_history[:, 0], pairs.u, np.ones((len(before), 1))])
    told = 0.5 * (slip.speeds(pairs.x) + slip.speeds(pairs.x_next))
    rows = np.linalg.lstsq(design, told, rcond=1e-8)[0].T  # (G, r + 2 m + 1)
    unit = float(np.sqrt((told**2).mean(axis=0)).max()) or 1.0
    kinks = np.array([[*row / unit, GATE, w] for w in slip.widths for row in rows])
    return kinks, 0, [(i,) for i in range(len(kinks))]
