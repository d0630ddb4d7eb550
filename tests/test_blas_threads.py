"""BLAS inside hot loops has one thread, whatever the process has, and the process keeps its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from pisplit import Dictionary, Episodes, LinearEDMDc
from pisplit import observables as ob
from pisplit.controllers import MPC
from pisplit.regression import accumulate, composed_ridge, ridge, triangular_factor
from pisplit.threads import one_blas_thread


def blas_threads() -> set[int]:
    """Threads of every BLAS that is loaded and has more than one to use."""
    found = [library for library in threadpool_info() if library["user_api"] == "blas"]
    return {library["num_threads"] for library in found if library.get("threading_layer") != "disabled"}


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    """A process with two BLAS threads, as on any machine with more than one core."""
    with threadpool_limits(2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip(f"this BLAS does not let its threads be set: {threadpool_info()}")
        yield


class Watched(np.ndarray):
    """An array that notes the threads of BLAS wherever it is used."""

    seen: set[int]

    def __array_finalize__(self, other: Any) -> None:
        self.seen = getattr(other, "seen", set())

    def __getitem__(self, key: Any) -> Any:
        self.seen |= blas_threads()
        return super().__getitem__(key)


def watched(array: np.ndarray) -> Watched:
    found = array.view(Watched)
    found.seen = set()
    return found


def test_the_setting_is_put_back_on_every_way_out() -> None:
    with one_blas_thread():
        assert blas_threads() == {1}
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == {1}
    assert blas_threads() == {2}
    with pytest.raises(KeyError), one_blas_thread():
        raise KeyError
    assert blas_threads() == {2}


def test_threads_that_overlap_leave_the_setting_as_it_was() -> None:
    """The first to come is the first to go: what the second found, and would put back, is one thread."""
    second_came, first_went = threading.Event(), threading.Event()
    seen: list[set[int]] = []

    def second() -> None:
        with one_blas_thread():
            seen.append(blas_threads())
            second_came.set()
            first_went.wait(10)

    worker = threading.Thread(target=second)
    with one_blas_thread():
        worker.start()
        second_came.wait(10)
    first_went.set()
    worker.join()
    assert seen == [{1}] and blas_threads() == {2}
    with one_blas_thread():
        assert blas_threads() == {1}


@pytest.mark.parametrize(
    "work",
    [
        lambda a, y: accumulate([a]),
        lambda a, y: triangular_factor(a),
        lambda a, y: ridge(a, y, 0.1),
        lambda a, y: ridge(a, y, 0.0),
        lambda a, y: composed_ridge(np.eye(3), a, y, 0.1),
    ],
    ids=["accumulate", "triangular_factor", "ridge", "least squares", "composed_ridge"],
)
def test_regressions_work_with_one_thread(work: Callable[[Any, Any], Any]) -> None:
    rng = np.random.default_rng(0)
    a, y = watched(rng.normal(size=(60, 8))), rng.normal(size=(60, 3))
    work(a, y)
    assert a.seen <= {1}
    assert blas_threads() == {2}


class Asked:
    """Numbers that note the threads of BLAS when somebody asks for them."""

    def __init__(self, values: np.ndarray) -> None:
        self.values, self.seen = values, set[int]()

    def __array__(self, *arguments: Any, **options: Any) -> np.ndarray:
        self.seen |= blas_threads()
        return self.values


def test_moves_and_roll_outs_work_with_one_thread() -> None:
    """A product with 723 columns takes 0.1 ms, or a time slice where another process has the second core."""
    rng = np.random.default_rng(2)
    u = rng.normal(size=(60, 1))
    data = Episodes([rng.normal(size=(61, 2))], [u], 0.1)
    model = LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), alpha=0.1).fit(data).lifted
    window, inputs = Asked(np.zeros((5, 1))), Asked(u)
    MPC(model, 5, -1.0, 1.0, 0.5, track=[0]).step(np.zeros(2), window)  # type: ignore[arg-type]
    model.rollout(np.zeros(2), inputs)  # type: ignore[arg-type]
    assert window.seen == inputs.seen == {1}
    assert blas_threads() == {2}


def test_results_do_not_depend_on_the_threads_of_the_process() -> None:
    rng = np.random.default_rng(1)
    a, y = rng.normal(size=(1500, 300)), rng.normal(size=(1500, 20))
    found = [accumulate([a]).factor, ridge(a, y, 0.1).K]
    with threadpool_limits(1, user_api="blas"):
        alone = [accumulate([a]).factor, ridge(a, y, 0.1).K]
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one, other)


def test_fits_and_the_front_have_one_thread_throughout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not in their products alone: what stands between those took most of the time on a busy machine."""
    from pisplit.estimators import edmdc
    from pisplit.front import control, identification

    seen: dict[str, set[int]] = {}

    def noting(place: Any, name: str) -> None:
        inner = getattr(place, name)

        def noted(*arguments: Any, **options: Any) -> Any:
            seen.setdefault(name, set()).update(blas_threads())
            return inner(*arguments, **options)

        monkeypatch.setattr(place, name, noted)

    noting(edmdc.LinearEDMDc, "_keep")
    noting(identification, "_held_out_error")
    noting(control, "_chosen")
    rng = np.random.default_rng(0)
    xs, us = [], [rng.uniform(-1.0, 1.0, (60, 1)) for _ in range(4)]
    for u in us:
        x = np.zeros((61, 2))
        for k in range(60):
            x[k + 1] = [0.9 * x[k, 0] + 0.2 * x[k, 1], -0.2 * x[k, 0] + 0.9 * x[k, 1] + 0.1 * u[k, 0]]
        xs.append(x)
    data = Episodes(xs, us, 0.05)
    LinearEDMDc(Dictionary(ob.Identity(), n_states=2, n_inputs=1), alpha=0.1).fit(data)
    assert seen == {"_keep": {1}}
    identification.identify(data, candidates=["L-EDMDc"], progress=False).mpc(u_max=1.0, du_max=1.0)
    assert seen == {"_keep": {1}, "_held_out_error": {1}, "_chosen": {1}}
    assert blas_threads() == {2}
