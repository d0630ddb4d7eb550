"""A plant in another process, or in another program: one line of JSON a message over a socket."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, count, finite_array, positive
from pisplit.controllers.loop.plant import Plant, PlantStep
from pisplit.controllers.plants.wrapped import TOLD

#: Host where servers listen and clients call when nothing else is given.
LOOPBACK = "127.0.0.1"


class SocketPlant:
    """A plant behind a socket. Any program can be one: it answers a line of JSON with a line of JSON.

    On connection it sends ``{"dt": ..., "n_inputs": ..., "n_states": ...}`` and, if it likes, ``state_names``,
    ``state_units``, ``input_names``, ``input_units``. Then it answers ``{"reset": [u]}`` (or null) with
    ``{"state": [x]}``, and ``{"step": [u]}`` with ``{"state": [x], "ok": true, "message": ""}`` once the step is over;
    ``{"error": "why"}`` is raised here. Numbers keep all their digits; NaN marks what was not measured. :func:`serve`
    does this for a plant in Python. Use it in a ``with`` block, or ``close`` it.

    Args:
        port: of the server.
        host: of the server.
        timeout: longest time in s to wait for a connection or an answer.

    Raises ConnectionError where nobody answers or what answers is no plant, TimeoutError where it is late, in one line.
    """

    def __init__(self, port: int, host: str = LOOPBACK, timeout: float = 10.0) -> None:
        self._where = f"{host}:{count(port, 'port')}"
        seconds = positive(timeout, "timeout", "s")
        try:
            self._socket = socket.create_connection((host, port), timeout=seconds)
        except OSError as error:
            raise ConnectionError(f"no plant at {self._where}: {error}; start its server first") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._lines = self._socket.makefile("rwb")
        told = self._read()
        try:
            self.dt = positive(told["dt"], "dt", "s")
            self.n_inputs, self.n_states = count(told["n_inputs"], "n_inputs"), count(told["n_states"], "n_states")
        except (KeyError, ValueError) as error:
            self.close()
            raise ConnectionError(f"{self._where} is no plant: it sent {sorted(told)[:4]} ({error})") from None
        for name in TOLD:
            if told.get(name) is not None:
                setattr(self, name, tuple(str(entry) for entry in told[name]))

    def reset(self, u0: ArrayLike | None = None) -> Array:
        """Back to rest under ``u0`` (n_inputs,); the measured state (n_states,)."""
        u = None if u0 is None else finite_array(u0, "u0", (self.n_inputs,)).tolist()
        return self._state(self._ask({"reset": u}))

    def step(self, u: ArrayLike) -> PlantStep:
        """Apply ``u`` (n_inputs,) over one time step and wait for the measurement."""
        answer = self._ask({"step": finite_array(u, "u", (self.n_inputs,)).tolist()})
        return PlantStep(self._state(answer), bool(answer.get("ok", True)), str(answer.get("message", "")))

    def close(self) -> None:
        """End the connection."""
        self._lines.close()
        self._socket.close()

    def __enter__(self) -> SocketPlant:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            self._lines.write(json.dumps(request).encode() + b"\n")
            self._lines.flush()
        except (OSError, ValueError) as error:
            raise ConnectionError(f"the plant at {self._where} is gone: {error}") from None
        answer = self._read()
        if "error" in answer:
            raise RuntimeError(f"the plant at {self._where} failed: {answer['error']}")
        return answer

    def _read(self) -> dict[str, Any]:
        try:
            line = self._lines.readline()
        except TimeoutError:
            raise TimeoutError(
                f"the plant at {self._where} did not answer within {self._socket.gettimeout():g} s"
            ) from None
        except OSError as error:
            raise ConnectionError(f"the plant at {self._where} is gone: {error}") from None
        if not line:
            raise ConnectionError(f"the plant at {self._where} closed the connection")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            raise ConnectionError(f"{self._where} is no plant: it sent {line[:40]!r}, expected a line of JSON")
        return answer

    def _state(self, answer: dict[str, Any]) -> Array:
        state = np.array(answer.get("state", ()), dtype=np.float64)
        if state.shape != (self.n_states,):
            raise ConnectionError(
                f"the plant at {self._where} sent a state of shape {state.shape}; expected ({self.n_states},)"
            )
        return state


def serve(
    plant: Plant,
    port: int = 0,
    host: str = LOOPBACK,
    realtime: bool = False,
    connections: int | None = None,
    ready: Callable[[int], object] | None = None,
) -> int:
    """Serve ``plant`` to :class:`SocketPlant` clients, one after the other; returns how many steps were late.

    Args:
        plant: what moves.
        port: to listen on; 0 takes a free one.
        host: to listen on. There is no password: use it on your own machine or network.
        realtime: answer a step no earlier than its end, every ``plant.dt`` seconds after the reset. A step is late
            where its command, or the plant, came after that; the clock then goes on from there.
        connections: end after so many, never when not given.
        ready: called with the port once the server listens.
    """
    late = 0
    with socket.create_server((host, port)) as server:
        if ready is not None:
            ready(server.getsockname()[1])
        served = 0
        while connections is None or served < connections:
            connection, _ = server.accept()
            with connection:
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                late += _attend(plant, connection, realtime)
            served += 1
    return late


def _attend(plant: Plant, connection: socket.socket, realtime: bool) -> int:
    """Answer one client until it leaves; how many steps were late."""
    late, due, dt = 0, 0.0, float(plant.dt)
    told: dict[str, Any] = {"dt": dt, "n_inputs": int(plant.n_inputs), "n_states": int(plant.n_states)}
    told |= {name: list(getattr(plant, name)) for name in TOLD if getattr(plant, name, None) is not None}
    with connection.makefile("rwb") as lines:
        try:
            _send(lines, told)
            for line in lines:
                answer = _answered(plant, line)
                if "ok" not in answer:
                    due = time.monotonic()  # a reset: time begins
                elif realtime:
                    due, now = due + dt, time.monotonic()
                    if now > due:
                        late, due = late + 1, now
                    time.sleep(max(0.0, due - now))
                _send(lines, answer)
        except (ConnectionError, BrokenPipeError):
            pass  # the client left amid a message
    return late


def _answered(plant: Plant, line: bytes) -> dict[str, Any]:
    try:
        request = json.loads(line)
        if "reset" in request:
            given = request["reset"]
            state = plant.reset(None if given is None else np.array(given, dtype=np.float64))
            return {"state": np.asarray(state).tolist()}
        after = plant.step(np.array(request["step"], dtype=np.float64))
        return {"state": np.asarray(after.state).tolist(), "ok": bool(after.ok), "message": str(after.message)}
    except Exception as error:  # told to the client, who decides
        return {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}


def _send(lines: Any, message: dict[str, Any]) -> None:
    lines.write(json.dumps(message).encode() + b"\n")
    lines.flush()
