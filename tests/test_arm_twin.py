"""Dictionaries that suit a simulated twin of the arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pisplit import Episodes
from pisplit.models.arm import TendonArm, make_episodes, random_displacements, twin_alone, twin_dictionaries
from pisplit.models.arm.twin import PLAIN, RICH, twin_dictionary

DT = 0.03


@pytest.fixture(scope="module")
def twin(tmp_path_factory: pytest.TempPathFactory) -> Episodes:
    path: Path = tmp_path_factory.mktemp("twin") / "twin.h5"
    make_episodes(TendonArm.paper(), path, 4, 60, DT, seed=1, workers=1, progress=False)
    return Episodes.load(path)


@pytest.fixture(scope="module")
def excitation() -> np.ndarray:
    arm = TendonArm.paper()
    return np.stack([random_displacements(arm, 60, np.random.default_rng(7 + i)) for i in range(2)])


def test_the_rich_dictionary_rolls_out_better_than_the_plain_one(twin: Episodes, excitation: np.ndarray) -> None:
    (plain, plain_ridge), (rich, ridge) = twin_dictionaries(twin, excitation)
    assert plain_ridge == PLAIN[-1] and ridge >= min(r for _, _, r in RICH) and plain.n_columns < rich.n_columns
    errors = [
        twin_alone(theta, r, twin[:-1], excitation).score(twin[-1:], "shape").median
        for theta, r in ((plain, plain_ridge), (rich, ridge))
    ]
    assert errors[1] < errors[0]


def test_recorded_pairs_have_no_weight_in_the_model_of_the_twin(twin: Episodes, excitation: np.ndarray) -> None:
    theta = twin_dictionary(twin)
    one, other = (twin_alone(theta, 1e-4, twin[order], excitation) for order in (slice(None), slice(None, None, -1)))
    np.testing.assert_allclose(one.K_, other.K_, atol=1e-6 * np.abs(one.K_).max())


def test_columns_of_the_dictionary_are_those_asked_for(twin: Episodes) -> None:
    n, m = twin.n_states, twin.n_inputs
    names = twin_dictionary(twin, components=2, delays=1).column_names
    assert len(set(names)) == len(names)
    plain, products = twin_dictionary(twin), twin_dictionary(twin, components=2)
    assert products.n_present - plain.n_present == 3  # two squares and a product
    assert twin_dictionary(twin, delays=1).n_columns > plain.n_columns >= (1 + n) * (1 + m)


def test_a_twin_of_one_episode_is_refused(twin: Episodes, excitation: np.ndarray) -> None:
    with pytest.raises(ValueError, match="the twin has 1 episode; expected at least 2"):
        twin_dictionaries(twin[:1], excitation)
