"""One thread of linear algebra inside loops of many small products, whatever the process is set to."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

_taken = threading.Lock()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within the block, or in a function that this decorates, BLAS and LAPACK of this process use one thread.

    Threads of BLAS wait for one another by spinning: where a product takes less than a time slice and anything else
    runs on the machine, two of them take several times as long as one. The setting belongs to the process: of several
    threads that are inside, the first to come sets it, and puts it back when it leaves. 2 us a call where
    one thread is set already, else 20 us.
    """
    libraries, blas = _libraries()
    if all(library.num_threads == 1 for library in blas) or not _taken.acquire(blocking=False):
        yield
        return
    try:
        with libraries.limit(limits=1, user_api="blas"):
            yield
    finally:
        _taken.release()


@cache
def _libraries() -> tuple[Any, tuple[Any, ...]]:
    """The libraries that are loaded, and those of them that are a BLAS."""
    import scipy.linalg  # noqa: F401  numpy and scipy bring a BLAS each; both must be loaded to be found
    from threadpoolctl import ThreadpoolController

    found = ThreadpoolController()
    return found, tuple(library for library in found.lib_controllers if library.user_api == "blas")
