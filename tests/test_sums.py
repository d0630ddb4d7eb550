"""Recordings joined: what one row was before, it is after, under the names and units of the first."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, StreamingEDMDc, identify
from pisplit import observables as ob


def drawn(seed: int, **fields: object) -> Episodes:
    rng = np.random.default_rng(seed)
    given = {
        "state_names": ("p", "v"),
        "input_names": ("u",),
        "units": ("m", "m/s"),
        "provenance": {"seed": seed, "robot": "a"},
    }
    return Episodes(
        [rng.normal(size=(6 + k, 2)) for k in range(2)],
        [rng.normal(size=(5 + k, 1)) for k in range(2)],
        0.1,
        **{**given, **fields},
    )


def test_joined_recordings_hold_both_in_order_and_know_their_origin() -> None:
    first, second, third = drawn(0), drawn(1), drawn(2)
    found = sum([first, second, third])
    assert isinstance(found, Episodes) and len(found) == 6
    np.testing.assert_array_equal(
        found.stacked_states(), np.vstack([d.stacked_states() for d in (first, second, third)])
    )
    assert found.provenance is not None and found.provenance["robot"] == "a" and "seed" not in found.provenance
    assert [(p["seed"], p["episodes"]) for p in found.provenance["parts"]] == [(0, 2), (1, 2), (2, 2)]
    assert found.provenance == ((first + second) + third).provenance == (first + (second + third)).provenance


def test_columns_of_another_order_and_unit_become_those_of_the_first() -> None:
    first, second = drawn(0), drawn(1)
    turned = replace(
        second,
        xs=[x[:, ::-1] * [1.0, 1e3] for x in second.xs],
        state_names=("v", "p"),
        quantities=None,
        units=("m/s", "mm"),
    )
    np.testing.assert_allclose((first + turned).stacked_states(), (first + second).stacked_states(), rtol=1e-12)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"dt": 0.2}, "the second recording has dt"),
        ({"state_names": ("p", "w")}, "no states named v"),
        ({"units": ("m", "rad/s")}, "no factor is known"),
        ({"quantities": ("p", "p")}, "quantities are"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        drawn(0) + replace(drawn(1), **fields)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    with pytest.raises(TypeError):
        drawn(0) + 1  # type: ignore[operator]


def test_what_only_one_saved_along_is_left_out_and_said() -> None:
    first = replace(drawn(0), extra={"field": [np.zeros(3), np.ones(4)]}, outputs={"tip": (0,)})
    with pytest.warns(UserWarning, match="extra 'field' is in one of the recordings only"):
        found = first + drawn(1)
    assert not found.extra and found.outputs == {"tip": (0,)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert [len(a) for a in (first + first).extra["field"]] == [3, 4, 3, 4]  # type: ignore[index]


def test_a_list_is_fitted_as_one_and_refused_with_a_word_elsewhere() -> None:
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    parts = [drawn(0), drawn(1)]
    for estimator in (LinearEDMDc(theta), StreamingEDMDc(theta)):
        np.testing.assert_array_equal(estimator.fit(parts).lifted.A, estimator.fit(parts[0] + parts[1]).lifted.A)
    for refuse in (StreamingEDMDc(theta).update, lambda d: identify(d, progress=False)):
        with pytest.raises(
            ValueError, match=r"is a list; expected Episodes.*several recordings become one by d1 \+ d2"
        ):
            refuse(parts)  # type: ignore[arg-type]


def test_a_log_that_gaps_cut_into_many_pieces_says_so_and_names_max_gap() -> None:
    t = 0.01 * np.arange(4000)
    x = np.sin(3.0 * t)
    x[np.arange(len(t)) % 40 < 8] = np.nan  # 80 ms are lost in every 0.4 s
    with pytest.warns(
        UserWarning, match=r"cut the recording into 100 pieces of about 32 samples: x1 is missing .* max_gap=0.091"
    ):
        found = Episodes.from_arrays(t, x, np.cos(t))
    assert len(found) == 100
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (whole,) = Episodes.from_arrays(t, x, np.cos(t), max_gap=0.091, interpolation="cubic").xs
    np.testing.assert_allclose(whole[:, 0], np.sin(3.0 * t[8:]), atol=1e-4)
