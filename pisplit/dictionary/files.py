"""Dictionaries in HDF5 files, and the fingerprint that tells one from another."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from pisplit.data import store
from pisplit.dictionary.compiled import Part
from pisplit.dictionary.layout import Structure
from pisplit.observables import Names

if TYPE_CHECKING:
    from pisplit.dictionary.dictionary import Dictionary

KIND = "pisplit/dictionary"


def facts(theta: Dictionary) -> dict[str, Any]:
    """All that makes the dictionary ``theta`` but its compiled columns, JSON-able."""
    return {
        "names": asdict(theta.names),
        "given": [None if names is None else list(names) for names in theta.given],
        "structure": asdict(theta.structure),
        "state_part": [theta.state_part.names, theta.state_part.quantities],
        "input_part": [theta.input_part.names, theta.input_part.quantities],
        "products": theta.products.tolist(),
    }


def fingerprint(theta: Dictionary) -> str:
    """SHA-256 of names, quantities, structure and compiled columns of the dictionary ``theta``."""
    described = {name: fact for name, fact in facts(theta).items() if name != "given"}
    digest = hashlib.sha256(json.dumps(described, sort_keys=True).encode())
    for part in (theta.state_part, theta.input_part):
        digest.update(part.function.serialize().encode())
    return digest.hexdigest()


def save(theta: Dictionary, path: str | os.PathLike[str]) -> None:
    """Write the compiled dictionary ``theta`` to the HDF5 file ``path``, whole or not at all."""
    with store.writing(path, KIND) as file:
        store.write_json(file, "facts", facts(theta))
        store.write_function(file, "state_columns", theta.state_part.function)
        store.write_function(file, "input_columns", theta.input_part.function)
        file.attrs["fingerprint"] = theta.fingerprint()


def load(theta: Dictionary, path: str | os.PathLike[str]) -> None:
    """Fill the bare dictionary ``theta`` from the file ``path``.

    Raises one line for files that are missing, damaged, foreign or of a newer CasADi.
    """
    with store.reading(path, KIND) as file:
        found = store.read_json(file, "facts")
        mark = str(file.attrs["fingerprint"])
        state, inputs = (store.read_function(file, name) for name in ("state_columns", "input_columns"))
    theta.observables, theta.given = (), tuple(found["given"])
    theta.lay_out(
        Names(**{name: tuple(labels) for name, labels in found["names"].items()}),
        Structure(**found["structure"]),
        Part(state, *map(tuple, found["state_part"])),
        Part(inputs, *map(tuple, found["input_part"])),
        np.array(found["products"], dtype=np.int64),
    )
    theta.__dict__["_fingerprint"] = mark
