"""Facts of the controller: checked limits, growth of predictions, time that it takes."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pisplit.controllers.mpc.mpc import _each_output, _spectral_radius, _warn_of_growth


@pytest.mark.parametrize("bad", [[0.0, np.nan], np.nan, [np.nan, np.nan], [1.0, 2.0, 3.0]])
def test_limits_of_outputs_are_numbers_one_each(bad: object) -> None:
    with pytest.raises(ValueError, match="y_min"):
        _each_output(bad, "y_min", 2)  # type: ignore[arg-type]
    assert _each_output(0.5, "y_min", 2).tolist() == [0.5, 0.5]
    assert _each_output([0.5, -np.inf], "y_min", 2).tolist() == [0.5, -np.inf]


@pytest.mark.parametrize("size", [3, 50, 51, 120])
def test_the_spectral_radius_is_the_largest_modulus(size: int) -> None:
    rng = np.random.default_rng(size)
    q, _ = np.linalg.qr(rng.normal(size=(size, size)))
    values = np.linspace(-0.9, 0.5, size)
    assert _spectral_radius(q @ np.diag(values) @ q.T) == pytest.approx(0.9, rel=1e-3)


def test_growth_over_the_horizon_is_said_beyond_its_limit() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _warn_of_growth(np.diag([1.01, 0.5]), 20)
    with pytest.warns(UserWarning, match=r"spectral radius 3.0000 grows 3.5e\+09 times over 20 steps"):
        _warn_of_growth(np.diag([3.0, 0.5]), 20)
