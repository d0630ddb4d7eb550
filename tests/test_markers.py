"""Markers measure positions of stations: exact without noise, with the noise and the losses that were asked for."""

from __future__ import annotations

import numpy as np
import pytest

import pisplit as ps
from pisplit.controllers.plants import Markers


class Line:
    """Three stations on a line that every step moves by the input."""

    dt, n_inputs, n_states = 0.1, 1, 9
    state_names = tuple(f"p_{a}[{k}]" for k in (1, 2, 3) for a in "xyz")
    input_names = ("pull",)

    def reset(self, u0: object = None) -> np.ndarray:
        self.x = np.arange(9.0)
        return self.x

    def step(self, u: np.ndarray) -> object:
        from pisplit.controllers import PlantStep

        self.x = self.x + u[0]
        return PlantStep(self.x)


def test_markers_read_their_stations_and_pass_on_the_rest() -> None:
    seen = ps.Markers(Line(), stations=[3, 1])
    assert seen.n_states == 6 and seen.state_names[:3] == ("p_x[3]", "p_y[3]", "p_z[3]")
    assert seen.input_names == ("pull",) and seen.state_units == ("m",) * 6
    np.testing.assert_array_equal(seen.reset(), [6, 7, 8, 0, 1, 2])
    np.testing.assert_array_equal(seen.step([0.5]).state, [6.5, 7.5, 8.5, 0.5, 1.5, 2.5])
    assert seen.true_states.shape == (2, 9)
    called = ps.Markers(Line(), [3], names=["tip X", "tip Y", "tip Z"], input_names=["servo"])
    assert called.state_names == ("tip X", "tip Y", "tip Z") and called.input_names == ("servo",)
    np.testing.assert_array_equal(called.reset(), [6, 7, 8])


def test_noise_and_losses_are_as_often_as_asked_for_and_repeat() -> None:
    def run() -> np.ndarray:
        seen = Markers(Line(), [1, 2, 3], noise=0.01, dropouts=0.2, seed=3)
        return np.array([seen.reset(), *(seen.step([0.0]).state for _ in range(3000))])

    y = run()
    np.testing.assert_array_equal(y, run())
    assert np.isfinite(y[0]).all()
    lost = np.isnan(y).reshape(-1, 3, 3)
    assert (lost.all(axis=2) == lost.any(axis=2)).all()  # a marker is lost as a whole
    assert lost[..., 0].mean() == pytest.approx(0.2, abs=0.02)
    assert np.nanstd(y - np.arange(9.0)) == pytest.approx(0.01, rel=0.05)


def test_a_restored_plant_goes_on_to_the_last_bit() -> None:
    class Kept(Line):
        def snapshot(self) -> np.ndarray:
            return self.x

        def restore(self, x: np.ndarray) -> None:
            self.x = x

    seen = Markers(Kept(), [2], noise=0.1, dropouts=0.3, seed=1)
    seen.reset()
    seen.step([0.1])
    kept = seen.snapshot()
    after = [seen.step([0.1]).state for _ in range(5)]
    seen.restore(kept)
    np.testing.assert_array_equal([seen.step([0.1]).state for _ in range(5)], after)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"stations": [4]}, r"no state named 'p_x\[4\]'"),
        ({"stations": []}, "at least one"),
        ({"stations": [1, 1]}, "different numbers"),
        ({"stations": [1], "dropouts": 2.0}, "from 0 to 1"),
        ({"stations": [1], "noise": -1.0}, "noise"),
        ({"stations": [1], "names": ["x", "y"]}, "expected 3 different names"),
        ({"stations": [1], "input_names": "pull"}, "expected 1 different names"),
    ],
)
def test_wrong_markers_are_refused(given: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Markers(Line(), **given)
