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
        parts = (("setpoint", start.setpoint), ("servo", start.servo), ("position", start.position))
        r, y, z = (finite_array(value, f"start.{name}", (u.shape[1],)) for name, value in parts)
        found = np.empty_like(u)
        limit = np.inf if self.rate is None else self.rate
        for k, command in enumerate(u):
            away = command - r
            arrives = np.full_like(r, h) if ramp else np.minimum(np.abs(away) / limit, h)
            after = np.where(np.abs(away) <= limit * h, command, r + np.clip(away, -limit * h, limit * h))
            y, z = self._along(r, after, y, z, arrives)
            y, z = self._along(after, after, y, z, h - arrives)
            r, found[k] = after, z
        return found, ActuatorState(r.copy(), y.copy(), z.copy())

    def _along(self, begin: Array, end: Array, y: Array, z: Array, t: Array) -> tuple[Array, Array]:
        """Servo and position (m,) after the setpoint went linearly from ``begin`` to ``end`` in times ``t`` (m,)."""
        if self.lag == 0.0:
            return end, self._follow(z, end)
        begin = np.where(t > 0.0, begin, end)  # a jump takes no time, and moves no servo
        slope = np.divide(end - begin, t, out=np.zeros_like(t), where=t > 0.0)
        behind, steady = begin - y, slope * self.lag  # lag behind' = steady - behind
        after = end - steady - (behind - steady) * np.exp(-t / self.lag)
        # The servo turns round where the setpoint meets it, behind = 0, if that happens on the way.
        turns = (behind * (end - after) < 0.0) & (t > 0.0)
        ratio = np.divide(steady - behind, steady, out=np.ones_like(t), where=turns)
        at = begin + slope * self.lag * np.log(np.where(turns, ratio, 1.0))
        return after, self._follow(self._follow(z, np.where(turns, at, y)), after)

    def _follow(self, z: Array, y: Array) -> Array:
        """The play operator over a monotone move to ``y`` (m,)."""
        return np.clip(z, y - 0.5 * self.play, y + 0.5 * self.play)


def checked_actuator(value: object) -> Actuator:
    """``value``, which must be an Actuator. Raises ValueError otherwise."""
    if not isinstance(value, Actuator):
        raise ValueError(f"actuator is a {type(value).__name__}; expected an Actuator(lag=, play=, rate=)")
    return value
