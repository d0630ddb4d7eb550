"""What stands between a command and a tendon: rate limit, lag and play of a servo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pisplit.checks import Array, finite_array, non_negative, one_of, positive


@dataclass(frozen=True)
class ActuatorState:
    """Where an actuator is: its ``setpoint``, ``servo`` and ``position``, each (m,) in the unit of the command."""

    setpoint: Array
    servo: Array
    position: Array

    @classmethod
    def at(cls, position: ArrayLike) -> ActuatorState:
        """At rest at a ``position`` (m,), in the middle of its play."""
        rest = finite_array(position, "position", (None,))
        return cls(rest.copy(), rest.copy(), rest.copy())


@dataclass(frozen=True)
class Actuator:
    """A servo with a transmission: rate limit, then first-order lag, then play. All of zero, it does nothing.

    The setpoint goes to the command at no more than ``rate``; the servo follows it, lag servo' = setpoint - servo; the
    position follows the servo when the play is used up, |servo - position| <= play / 2. Its state is known from the
    commands alone. Source of the play operator: Visintin, *Differential Models of Hysteresis*, Springer 1994, ch. III.

    Args:
        lag: time constant in s.
        play: width of the play in the unit of the command.
        rate: largest speed of the setpoint in units of the command per s, no limit when not given.
    """

    lag: float = 0.0
    play: float = 0.0
    rate: float | None = None

    def __post_init__(self) -> None:
        non_negative(self.lag, "Actuator lag", "s")
        non_negative(self.play, "Actuator play")
        if self.rate is not None:
            positive(self.rate, "Actuator rate")

    def simulate(
        self,
        commands: ArrayLike,
        dt: float,
        start: ActuatorState | None = None,
        inputs: str = "ramp",
    ) -> tuple[Array, ActuatorState]:
        """Positions (T, m) at the ends of T steps, exact, and the state after them.

        Args:
            commands: (T, m).
            dt: step in s.
            start: state before the first step, at rest at the first command when not given.
            inputs: whether a command is reached linearly over its step (``"ramp"``) or held from its beginning
                (``"step"``).

        Raises ValueError for other shapes, numbers that are not finite and unknown ``inputs``.
        """
        u, h = finite_array(commands, "commands", (None, None)), positive(dt, "dt", "s")
        ramp = one_of(inputs, "inputs", ("ramp", "step")) == "ramp"
        if start is None:
            start = ActuatorState.at(u[0] if len(u) else np.zeros(u.shape[1]))
        elif not isinstance(start, ActuatorState):
            raise ValueError(f"start is a {type(start).__name__}; expected an ActuatorState, as simulate() gives")
        parts = (("setpoint", start.setpoint), ("servo", start.servo), ("position", start.position))
        r, y, z = (finite_array(value, f"start.{name}", (u.shape[1],)) for name, value in parts)
        begin, end, t = self._setpoints(u, r, h, ramp)
        servo, turns = (end, end) if self.lag == 0.0 else self._servo(begin, end, t, y)
        found = _followed(np.stack([turns, servo], axis=1), z, 0.5 * self.play)
        if len(found):
            r, y, z = end[-1], servo[-1], found[-1]
        per_step = max(1, len(end) // max(len(u), 1))
        return found[per_step - 1 :: per_step].copy(), ActuatorState(r.copy(), y.copy(), z.copy())

    def _setpoints(self, u: Array, r: Array, h: float, ramp: bool) -> tuple[Array, Array, Array]:
        """Linear moves of the setpoint, begin, end and times (K, m): one a step, or two."""
        if self.rate is None:
            begin = np.vstack([r, u])[:-1]
            return (begin if ramp else u), u, np.full_like(u, h)
        limit, reached = self.rate * h, np.empty((len(u) + 1, len(r)))
        reached[0] = r
        for k, command in enumerate(u):
            away = command - reached[k]
            reached[k + 1] = np.where(np.abs(away) <= limit, command, reached[k] + np.clip(away, -limit, limit))
        if ramp:
            return reached[:-1], reached[1:], np.full_like(u, h)
        arrives = np.minimum(np.abs(u - reached[:-1]) / self.rate, h)
        begin = np.stack([reached[:-1], reached[1:]], axis=1).reshape(-1, len(r))
        return begin, np.repeat(reached[1:], 2, axis=0), np.stack([arrives, h - arrives], axis=1).reshape(-1, len(r))

    def _servo(self, begin: Array, end: Array, t: Array, y: Array) -> tuple[Array, Array]:
        """Servo (K, m) from ``y`` (m,) after moves of the setpoint, and where it turned round on their way."""
        begin = np.where(t > 0.0, begin, end)  # a jump takes no time, and moves no servo
        slope = np.divide(end - begin, t, out=np.zeros_like(t), where=t > 0.0)
        steady, decay = slope * self.lag, np.exp(-t / self.lag)  # lag behind' = steady - behind
        servo = np.empty_like(begin)
        before = np.empty_like(begin)
        for k in range(len(begin)):
            before[k] = y
            y = servo[k] = end[k] - steady[k] - (begin[k] - y - steady[k]) * decay[k]
        behind = begin - before
        # The servo turns round where the setpoint meets it, behind = 0, if that happens on the way.
        turns = (behind * (end - servo) < 0.0) & (t > 0.0)
        ratio = np.divide(steady - behind, steady, out=np.ones_like(t), where=turns)
        at = begin + slope * self.lag * np.log(np.where(turns, ratio, 1.0))
        return servo, np.where(turns, at, before)


def _followed(moves: Array, z: Array, half: float) -> Array:
    """The play operator of width 2 ``half`` from ``z`` (m,) over monotone moves (K, parts, m) in turn: (K, m)."""
    found = np.empty((len(moves), len(z)))
    low, high = moves - half, moves + half
    for k in range(len(moves)):
        for part in range(moves.shape[1]):
            z = np.minimum(np.maximum(z, low[k, part]), high[k, part])
        found[k] = z
    return found


def checked_actuator(value: object) -> Actuator:
    """``value``, which must be an Actuator. Raises ValueError otherwise."""
    if not isinstance(value, Actuator):
        raise ValueError(f"actuator is a {type(value).__name__}; expected an Actuator(lag=, play=, rate=)")
    return value
