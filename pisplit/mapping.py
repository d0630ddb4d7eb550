"""CasADi functions evaluated on many samples at once."""

from __future__ import annotations

import threading
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 1024
#: Numbers of samples whose work memory is kept.
SIZES = 32

_BUILDING = threading.Lock()  # CasADi's graphs count their references without locks


class Mapped:
    """Evaluate ``function`` on N samples: arguments (N, k_i) hold one flattened argument a row, the result is (N, p).

    A matrix argument (r, c) of the function is given column after column, i.e. row i of the argument is the
    C-ordered flattening of its transpose (times as rows). Samples go through one mapped function in blocks,
    with CasADi's buffer interface, which costs microseconds where converting to DM costs a hundred.
    Threads may share one object: every call has work memory of its own. Copies and pickles hold the function alone.
    Raises ValueError if the function fails on a sample (a rootfinder that does not converge).
    """

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._n_out = function.numel_out(0)
        self._idle: dict[int, list[_Evaluator]] = {}

    def __call__(self, *arguments: Array) -> Array:
        """Results (N, p) for ``arguments``, one array (N, k_i) for each argument of the function."""
        n = len(arguments[0])
        result = np.empty((n, self._n_out))
        for first in range(0, n, BLOCK):
            last = min(first + BLOCK, n)
            evaluator = self._taken(last - first)
            try:
                evaluator([argument[first:last] for argument in arguments], result[first:last])
            except RuntimeError as error:
                reason = str(error).strip().splitlines()[-1]
                name = self._function.name()
                raise ValueError(f"{name} cannot be evaluated on samples {first} to {last - 1}: {reason}") from None
            self._idle.setdefault(last - first, []).append(evaluator)
        return result

    def __getstate__(self) -> ca.Function:
        return self._function

    def __setstate__(self, function: ca.Function) -> None:
        Mapped.__init__(self, function)

    def _taken(self, n: int) -> _Evaluator:
        """An evaluator of n samples that nobody else uses: the caller puts it back among the idle ones."""
        try:
            return self._idle[n].pop()  # one operation, which no other thread can divide
        except (KeyError, IndexError):
            if len(self._idle) > SIZES:
                self._idle.clear()
            with _BUILDING:
                return _Evaluator(self._function, n)


class _Evaluator:
    """One function mapped over n samples, with its own argument memory."""

    def __init__(self, function: ca.Function, n: int) -> None:
        dense = _dense(function)
        mapped = dense if n == 1 else dense.map(n)
        self._inputs = [np.zeros((n, dense.numel_in(i))) for i in range(dense.n_in())]
        self._output = np.zeros((n, dense.numel_out(0)))
        buffer: Any
        buffer, self._run = mapped.buffer()
        self._buffer = buffer
        # Columns of the mapped function are samples: column-major (k, n) is the memory of row-major (n, k).
        for i, memory in enumerate(self._inputs):
            if memory.size:
                buffer.set_arg(i, memory.reshape(-1).data)
        if self._output.size:
            buffer.set_res(0, self._output.reshape(-1).data)

    def __call__(self, arguments: list[Any], result: Array) -> None:
        for memory, argument in zip(self._inputs, arguments, strict=True):
            memory[...] = argument
        self._run()
        result[...] = self._output


def _dense(function: ca.Function) -> ca.Function:
    """The same function with dense arguments and a dense result, as the buffer interface needs."""
    if all(function.sparsity_in(i).is_dense() for i in range(function.n_in())) and function.sparsity_out(0).is_dense():
        return function
    symbols = [ca.MX.sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
    return ca.Function(f"{function.name()}_dense", symbols, [ca.densify(function(*symbols))])


class Buffered:
    """A CasADi function with dense arguments and results as a call with numpy arrays, without conversions.

    Results are flat arrays in column-major order that the next call overwrites. For one thread at a time; no file holds
    it. ``function`` must have no sparse arguments.
    """

    def __init__(self, function: ca.Function) -> None:
        self._inputs = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self._results = tuple(np.zeros(function.numel_out(i)) for i in range(function.n_out()))
        buffer: Any
        buffer, self._run = function.buffer()
        self._buffer = buffer
        for i, memory in enumerate(self._inputs):
            if memory.size:
                buffer.set_arg(i, memory.data)
        for i, memory in enumerate(self._results):
            if memory.size:
                buffer.set_res(i, memory.data)

    def __call__(self, *arguments: Array) -> tuple[Array, ...]:
        """The results for ``arguments``, each in the shape of the transposed (row-major) argument."""
        for memory, argument in zip(self._inputs, arguments, strict=True):
            memory.reshape(argument.shape)[...] = argument
        self._run()
        return self._results
