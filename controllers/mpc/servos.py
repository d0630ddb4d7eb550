"""Servos with lag and play between the commands of a controller and the positions that its model takes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pisplit.checks import Array, non_negative
from pisplit.controllers.mpc.limits import InputLimits
from pisplit.data.actuator import Actuator, ActuatorState, checked_actuator

#: Way of a position that is planned, in parts of the play, below which the servo is not sent through the play for it.
DEAD = 0.3
#: Standard error of a play of which none is told, in parts of it, and how many of them are left in.
UNSURE, MARGIN = 0.15, 2.0


@dataclass(frozen=True, eq=False)
class ServoState:
    """Where the servos are, as an ``actuator``, and the ``shift`` (m,) of what was sent last for their play."""

    actuator: ActuatorState
    shift: Array


class Servos:
    """Positions behind the commands of a controller: predicted along a plan, and reached by what is sent.

    The lag is linear and becomes part of the prediction: a step takes a servo from y to b0 u + b1 u' + a y under the
    command u after u'. The play is taken out of what is sent: the servo is shifted by half of it to the side to which
    the plan goes ``lead`` steps ahead, as many as the lag needs to get there; near its turn a position hardly moves.
    So plans are commands of servos without play, and the position in a step is what the actuator makes of all that was
    sent, in the plane of the limits: of what play does across it a model knows nothing.

    What is taken out beyond the play makes the position jump at every turn, the plan answers, and the loop swings; what
    is left in costs little. So the servos are taken to have two standard errors less of it than told.

    Args:
        actuator: the servos, all alike; None for none.
        play_error: standard error of the play; 15 % of it if None.
        dt: step in s.
        inputs: whether a command is reached linearly over its step ("ramp") or held ("step").
        limits: of the commands.
        horizon: H steps of a plan.

    Source: the right inverse of the play operator, Tao and Kokotovic, *Adaptive Control of Systems with Actuator and
    Sensor Nonlinearities*, Wiley 1996, chapter 3.
    """

    def __init__(
        self,
        actuator: Actuator | None,
        dt: float,
        inputs: str,
        limits: InputLimits,
        horizon: int,
        play_error: float | None = None,
    ) -> None:
        told = Actuator() if actuator is None else checked_actuator(actuator)
        if play_error is not None and told.play == 0.0:
            raise ValueError(f"play_error = {play_error!r} has no effect without an actuator with play; leave it out")
        error = UNSURE * told.play if play_error is None else non_negative(play_error, "play_error")
        self.actuator = replace(told, play=max(0.0, told.play - MARGIN * error))
        self._dt, self._inputs, self._limits = dt, inputs, limits
        self._half = 0.5 * self.actuator.play
        self.lead = 2 + int(np.ceil(self.actuator.lag / dt - 1e-9))
        r = limits.basis.shape[1]
        self.idle = self.actuator == Actuator()
        self._new, self._old, self._stay = self._step()
        weights = np.zeros(horizon)
        weights[0] = self._new
        for j in range(1, horizon):
            weights[j] = self._stay * weights[j - 1] + (self._old if j == 1 else 0.0)
        # y_j = sum_i w_{j-i} u_i with w_0 = b0, w_1 = a b0 + b1, w_j = a w_{j-1}
        lower = np.array([[weights[j - i] if j >= i else 0.0 for i in range(horizon)] for j in range(horizon)])
        self._weights, self._map = lower, np.kron(lower, np.eye(r))
        self.reset(limits.offset)

    def _step(self) -> tuple[float, float, float]:
        """b0, b1 and a, found by three steps of the actuator without play."""
        servo = Actuator(lag=self.actuator.lag)
        rows = []
        for setpoint, at, command in ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
            begin = ActuatorState(np.array([setpoint]), np.array([at]), np.array([at]))
            rows.append(float(servo.simulate([[command]], self._dt, begin, self._inputs)[0][0, 0]))
        return rows[0], rows[1], rows[2]

    def reset(self, u0: Array) -> None:
        """At rest under the commands ``u0`` (m,), in the middle of the play."""
        self.restore(ServoState(ActuatorState.at(u0), np.zeros(len(u0))))

    def snapshot(self) -> ServoState:
        """Where the servos are."""
        return ServoState(self._state, self._shift)

    def restore(self, state: ServoState) -> None:
        """Go on from a ``state``."""
        self._state, self._shift = state.actuator, state.shift

    @property
    def position(self) -> Array:
        """Positions (m,) now."""
        return self._state.position

    @property
    def command(self) -> Array:
        """The last command (m,) as servos without play would have got it."""
        return self._state.setpoint - self._shift

    def planned(self, v: Array, scale: float) -> Array:
        """Positions (H, r) under the plan ``v`` (H, r), both in coordinates of the limits over ``scale``."""
        return v if self.idle else self._weights @ v + self._free(scale)

    def by_commands(self, S: Array | None, y_free: Array, nominal: Array, scale: float) -> tuple[Array | None, Array]:
        """S (H p, H r) and y_free (H p,) of outputs y = y_free + S v by commands, from those by positions.

        ``nominal`` (H p, H r) stands for an ``S`` that is None, which stays None; ``scale`` as in ``planned``.
        """
        if self.idle:
            return S, y_free
        y_free = y_free + (nominal if S is None else S) @ self._free(scale).ravel()
        return (None if S is None else S @ self._map), y_free

    def response(self, nominal: Array) -> Array:
        """The answer ``nominal`` (H p, H r) of outputs to positions as one to commands."""
        return nominal if self.idle else nominal @ self._map

    def send(self, command: Array, ahead: Array) -> tuple[Array, Array]:
        """What is sent (m,) for the ``command`` (m,) of servos without play, and the positions (m,) it leads to.

        ``ahead`` (H, m): positions of the plan that begins with the command.
        """
        if self._half == 0.0:
            return command, self.sent(command)
        limits, last = self._limits, self._state.setpoint
        way = ahead[min(self.lead, len(ahead) - 1)] - ahead[0]
        shift = np.where(np.abs(way) > DEAD * self.actuator.play, np.sign(way) * self._half, self._shift)
        low, high = np.maximum(limits.u_min, last - limits.du_max), np.minimum(limits.u_max, last + limits.du_max)
        sent = np.clip(command + shift, low, high)
        position = self.sent(sent)
        self._shift = np.clip(sent - command, -self._half, self._half)
        return sent, position

    def sent(self, command: Array) -> Array:
        """Positions (m,) after the ``command`` (m,) was sent."""
        if self.idle:
            self._state = ActuatorState(command, command, command)
            return command
        found, self._state = self.actuator.simulate(command[None, :], self._dt, self._state, self._inputs)
        return self._limits.on_plane(found[0])

    def _free(self, scale: float) -> Array:
        """Positions (H, r) under no moves, in coordinates over ``scale``."""
        basis, offset = self._limits.basis, self._limits.offset
        at, before = (basis.T @ (value - offset) / scale for value in (self.position, self.command))
        found = np.empty((len(self._weights), basis.shape[1]))
        for j in range(len(found)):
            at = self._stay * at + (self._old * before if j == 0 else 0.0)
            found[j] = at
        return found
