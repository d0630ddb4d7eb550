"""The row mask: where the unknown part may act, and with which weights (paper, "Adjusting the full K_t").

Rows that h leaves alone are those of the identity in K_h: the known half step twice is all that happens to them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pisplit.checks import positive
from pisplit.dictionary.dictionary import Dictionary

Array = NDArray[np.float64]
Index = NDArray[np.int64]
#: Where K_h may differ from the identity (:func:`free_block`).
Rows = str | Sequence[str] | Sequence[bool] | Mapping[str, float] | None


def check_rows(rows: Rows) -> None:
    """Raise ValueError for ``rows`` that are neither None, "inputs", names, a mask nor weights by name."""
    expected = "expected None, 'inputs', a list of names, or a boolean mask"
    if rows is None or (isinstance(rows, str) and rows == "inputs"):
        return
    if isinstance(rows, str) or not isinstance(rows, Sequence | Mapping | np.ndarray):
        raise ValueError(f"rows = {rows!r}; {expected}")
    entries = list(rows)
    if not entries:
        raise ValueError(f"rows is empty; h must act on at least one column: {expected}")
    if not (all(isinstance(e, str) for e in entries) or all(isinstance(e, bool | np.bool_) for e in entries)):
        raise ValueError(f"rows = {entries[:4]!r}; {expected}")
    if isinstance(rows, Mapping):
        for name, weight in rows.items():
            positive(weight, f"weight of rows[{name!r}]")


def free_block(theta: Dictionary, rows: Rows) -> tuple[Index, Index, bool]:
    """Free rows and columns of K_h, and whether its constant column is free too (paper, "Adjusting the full K_t").

    A constant column that is free carries no penalty.

    ``theta``: dictionary of K_h. ``rows``: None = all learned rows and all columns; "inputs" = all learned rows, but
    only the columns of inputs, past and present, and their products; names of learned columns or of quantities, or a
    boolean mask over learned columns = rows where h acts. A mapping from such names to numbers > 0 also weighs the
    penalty of these rows. Raises ValueError for names that are not there, and where nothing stays free.
    """
    check_rows(rows)
    learned = theta.learned_columns
    everything = np.array([i for i in range(theta.n_columns) if i != theta.constant_column], dtype=np.int64)
    affine = theta.constant_column is not None
    if rows is None:
        return learned, everything, affine
    if isinstance(rows, str):
        first = theta.n_present + theta.state_delays * theta.n_states
        if first == theta.n_columns:
            raise ValueError("rows = 'inputs', but the dictionary has no input columns; add ob.Inputs()")
        return learned, np.arange(first, theta.n_columns), False
    entries = list(rows)
    if all(isinstance(entry, bool | np.bool_) for entry in entries):
        if len(entries) != len(learned):
            raise ValueError(f"rows is a mask of length {len(entries)}; expected {len(learned)}, one a learned column")
        chosen = np.array(entries, dtype=bool)
    else:
        labels = [(theta.column_names[i], theta.column_quantities[i]) for i in learned]
        unknown = [entry for entry in entries if not any(entry in label for label in labels)]
        if unknown:
            raise ValueError(f"rows names {unknown[:3]}; expected names or quantities of learned columns")
        chosen = np.array([any(entry in label for entry in entries) for label in labels])
    if not chosen.any():
        raise ValueError("rows leaves no row free; h must act on at least one column")
    return learned[chosen], everything, affine


def row_weights(theta: Dictionary, rows: Rows, free: Index) -> Array:
    """Weights (len(free),) of the penalty of the rows ``free`` of K_h on ``theta``.

    1 unless ``rows`` is a mapping; the name of a column beats its quantity.
    """
    if not isinstance(rows, Mapping):
        return np.ones(len(free))
    labels = [(theta.column_names[i], theta.column_quantities[i]) for i in free]
    return np.array([float(rows[name] if name in rows else rows[quantity]) for name, quantity in labels])
