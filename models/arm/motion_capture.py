"""What motion capture sees of an arm: a few positions, perhaps frames, in axes of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pisplit import Episodes
from pisplit.checks import Array, count, finite_array, one_of, positive
from pisplit.data.columns import unit_factors

#: Names of a position as rods and ``pisplit.Markers`` have them: p_x[3].
POSITION = re.compile(r"p_[xyz]\[(\d+)\]")
#: Distance from the base, in parts of the arm's length, beyond which positions are in another unit or in other axes.
FAR = 1.5
POSES = ("given", "estimated")


@dataclass(frozen=True)
class MotionCapture:
    """Markers on an arm: where they sit, how well they are seen, and in which axes.

    Its columns are, marker by marker, x, y, z in m, and for a marker that is a tracked body the nine entries of its
    rotation matrix row by row after them: K of them in all. NaN in arrays of them is a marker that was lost.

    Attributes:
        stations: distances (S,) of the markers from the base along the backbone, increasing.
        noise: standard deviation in m of every coordinate.
        stations_in: "m", or "L" for parts of the arm's length.
        frames: numbers of the markers, from 1, that are bodies with a frame.
        frame_error: standard deviation of the entries of frames.
        offsets: (S, 3) from the backbone to each marker in m, in axes that the section carries along; None: on it.
        pose: "given", where ``position`` and ``turn`` say how the base stands in the axes of the measurement, or
            "estimated", where they are found with the arm, by a calibration.
        position: of the base (3,) in m in the axes of the measurement.
        turn: rotation vector (3,) in rad that takes axes of the base to those of the measurement.
        columns: names of the K columns in recordings; all their states in their order when not given.

    Raises ValueError, in one line, for what cannot be.
    """

    stations: Sequence[float]
    noise: float
    stations_in: str = "m"
    frames: Sequence[int] = ()
    frame_error: float = 0.02
    offsets: ArrayLike | None = None
    pose: str = "given"
    position: ArrayLike = (0.0, 0.0, 0.0)
    turn: ArrayLike = (0.0, 0.0, 0.0)
    columns: Sequence[str] | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        s = finite_array(self.stations, "MotionCapture stations", (None,))
        if not len(s) or s[0] <= 0.0 or np.any(np.diff(s) <= 0.0):
            raise ValueError(f"MotionCapture stations = {s.tolist()}; expected one or more, above 0 and increasing")
        if one_of(self.stations_in, "stations_in", ("m", "L")) == "L" and s[-1] > 1.0:
            raise ValueError(f"MotionCapture stations end at {s[-1]:g} L; expected parts of the length, up to 1")
        put(self, "stations", tuple(s.tolist()))
        positive(self.noise, "MotionCapture noise", "m")
        framed = tuple(count(k, "MotionCapture frames") for k in self.frames)
        if len(set(framed)) < len(framed) or any(k > len(s) for k in framed):
            raise ValueError(f"MotionCapture frames = {list(framed)}; expected different numbers from 1 to {len(s)}")
        put(self, "frames", framed)
        positive(self.frame_error, "MotionCapture frame_error")
        one_of(self.pose, "MotionCapture pose", POSES)
        for name in ("position", "turn"):
            put(self, name, tuple(finite_array(getattr(self, name), f"MotionCapture {name}", (3,)).tolist()))
        if self.offsets is not None:
            told = finite_array(self.offsets, "MotionCapture offsets", (len(s), 3))
            put(self, "offsets", tuple(map(tuple, told.tolist())))
        if self.columns is not None:
            put(self, "columns", tuple(self.columns))
            if len(set(self.columns)) != self.n_columns or len(self.columns) != self.n_columns:
                raise ValueError(
                    f"MotionCapture has {len(self.columns)} columns; expected {self.n_columns} different names: "
                    f"x, y, z of {len(s)} markers" + (f" and 9 more of {len(framed)} frames" if framed else "")
                )

    @classmethod
    def named(cls, names: Sequence[str], length: float, stations: int, noise: float) -> MotionCapture:
        """Markers whose columns are named p_x[k], p_y[k], p_z[k] as those of ``pisplit.Markers`` are.

        Args:
            names: of the columns, station by station.
            length: of the arm in m.
            stations: number of equally spaced stations that the k count, the last of them at the tip.
            noise: standard deviation in m.

        Raises ValueError for other names.
        """
        numbers = [m.group(1) for m in map(POSITION.fullmatch, names) if m]
        found = [int(k) for k in dict.fromkeys(numbers)]
        if tuple(names) != tuple(f"p_{axis}[{k}]" for k in found for axis in "xyz") or not found:
            raise ValueError(f"columns are {list(names)[:4]}; expected p_x[k], p_y[k], p_z[k] marker by marker")
        if max(found) > count(stations, "stations"):
            raise ValueError(f"marker {max(found)} of {stations} stations; give the number of stations of the plant")
        order = np.argsort(found)
        columns = [f"p_{axis}[{found[i]}]" for i in order for axis in "xyz"]
        return cls([length * found[i] / stations for i in order], noise, columns=columns)

    @property
    def n_columns(self) -> int:
        """Number K of measured columns."""
        return 3 * len(self.stations) + 9 * len(self.frames)

    @property
    def sizes(self) -> Array:
        """Standard deviations (K,) of the columns."""
        found: list[float] = []
        for k in range(1, len(self.stations) + 1):
            found += [self.noise] * 3 + ([self.frame_error] * 9 if k in self.frames else [])
        return np.array(found)

    @property
    def positions(self) -> tuple[int, ...]:
        """Columns (3 S,) that are positions."""
        first, found = 0, []
        for k in range(1, len(self.stations) + 1):
            found += [first, first + 1, first + 2]
            first += 12 if k in self.frames else 3
        return tuple(found)

    @property
    def names(self) -> tuple[str, ...]:
        """Names (K,) of the columns: those given, or marker by marker p_x[1], p_y[1], ..."""
        if self.columns is not None:
            return tuple(self.columns)
        found: list[str] = []
        for k in range(1, len(self.stations) + 1):
            found += [f"p_{a}[{k}]" for a in "xyz"]
            found += [f"R_{a}{b}[{k}]" for a in "xyz" for b in "xyz"] if k in self.frames else []
        return tuple(found)

    def at(self, length: float) -> tuple[float, ...]:
        """Arclengths (S,) in m of the markers on an arm of ``length`` in m.

        Raises ValueError for markers beyond its tip.
        """
        factor = length if self.stations_in == "L" else 1.0
        found = factor * np.array(self.stations)
        if found[-1] > length * (1.0 + 1e-9):
            raise ValueError(
                f"the last marker sits at {found[-1]:g} m, the arm is {length:g} m long; give stations in m from the "
                "base, or stations_in='L'"
            )
        return tuple(np.minimum(found, length).tolist())

    def placed(self, position: ArrayLike, turn: ArrayLike) -> MotionCapture:
        """The same with the pose of the base known: ``position`` (3,) in m and ``turn`` (3,) in rad."""
        told = [np.asarray(v, float).tolist() for v in (position, turn)]
        return replace(self, pose="given", position=told[0], turn=told[1])

    def read(self, episodes: Episodes, length: float) -> list[Array]:
        """The columns (T+1, K) of recordings in m, one array an episode.

        Args:
            episodes: recordings with these columns.
            length: of the arm in m, which says what a position can be.

        Raises ValueError, in one line, for missing columns, units of another kind, and positions far from the arm.
        """
        names, wanted = list(episodes.state_names or ()), list(self.columns or ())
        if not wanted and len(names) != self.n_columns:
            raise ValueError(
                f"the recordings have {len(names)} states, {len(self.stations)} markers {self.n_columns} columns; "
                "name them: MotionCapture(columns=[...])"
            )
        missing = [n for n in wanted if n not in names]
        if missing:
            raise ValueError(f"no state is named {missing[0]!r}; the recordings have {', '.join(names[:6])}")
        at = [names.index(n) for n in wanted] if wanted else list(range(len(names)))
        meters = ["m" if i in self.positions else "" for i in range(self.n_columns)]
        units = [(episodes.units or [""] * len(names))[i] for i in at]
        factors = unit_factors(units, meters, [names[i] for i in at], "the recordings", "a marker")
        found = [x[:, at] * factors for x in episodes.xs]
        self.check(np.concatenate(found), length)
        return found

    def check(self, values: Array, length: float) -> None:
        """Raise ValueError where ``values`` (..., K) are no positions on an arm of ``length`` in m."""
        if values.shape[-1] != self.n_columns:
            raise ValueError(f"markers have {values.shape[-1]} columns; expected {self.n_columns}")
        if self.pose != "given":
            return
        points = values[..., list(self.positions)].reshape(-1, 3) - np.asarray(self.position)
        away = float(np.nanmax(np.linalg.norm(points, axis=1), initial=0.0))
        reach = length + (0.0 if self.offsets is None else float(np.abs(np.asarray(self.offsets)).max()))
        if away > FAR * reach:
            raise ValueError(
                f"a marker is {away:.3g} m from the base of an arm of {length:g} m; expected m in the axes of the base "
                "(is it in mm?), or MotionCapture(position=, turn=) or pose='estimated'"
            )
