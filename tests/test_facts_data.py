"""Facts of recorded data: units from their definition, what a misfit is called, where runs begin, what is asked for."""

from __future__ import annotations

import datetime
import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from pisplit import Episodes, PhaseSamples
from pisplit.data.clock import _check_increasing, seconds
from pisplit.data.episode_checks import _misfit
from pisplit.data.recording_checks import say_what_is_held
from pisplit.data.recordings import _jitter, _step
from pisplit.data.resampling import BRIDGED, Signal, _both, longest_gap, pieces
from pisplit.data.store import _release
from pisplit.data.units import UNITS, to_si
from pisplit.lifted.c_code import listed
from pisplit.lifted.operators import state_range

PREFIXES = {"": 1.0, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9, "h": 1e2, "k": 1e3, "M": 1e6}
BASES = {name: (name, 1.0) for name in ("m", "s", "N", "Pa", "rad", "V", "A", "Nm", "Hz", "s^2")}
BASES |= {"g": ("kg", 1e-3), "bar": ("Pa", 1e5)}
POUND = 0.45359237  # kg, by the treaty of 1959; the inch is 25.4 mm
OTHERS = {
    "deg": ("rad", math.pi / 180.0),
    "rev": ("rad", 2.0 * math.pi),
    "rpm": ("rad/s", 2.0 * math.pi / 60.0),
    "min": ("s", 60.0),
    "hour": ("s", 60.0 * 60.0),
    "day": ("s", 24.0 * 60.0 * 60.0),
    "inch": ("m", 25.4e-3),
    "ft": ("m", 12.0 * 25.4e-3),
    "lbf": ("N", POUND * 9.80665),
    "psi": ("Pa", POUND * 9.80665 / 25.4e-3**2),
}


@pytest.mark.parametrize("unit", [u for u in UNITS if u])
def test_units_are_their_prefix_times_their_base(unit: str) -> None:
    known = OTHERS | BASES | {p + b: (si, f * PREFIXES[p]) for b, (si, f) in BASES.items() for p in PREFIXES}
    name, factor = to_si(unit, "x")
    assert (name, factor) == (known[unit][0], pytest.approx(known[unit][1], rel=1e-15))
    assert to_si(f"{unit}/ms", "x") == (f"{name}/s", pytest.approx(1e3 * factor, rel=1e-15))


@pytest.mark.parametrize(
    ("x", "u", "said"),
    [
        ((2, 11), (1, 10), "time runs along rows; give x.T and u.T"),
        ((11, 2), (11, 1), "leave out the last, u[:-1]"),
        ((11, 2), (1, 10), "give u.T"),
        ((11, 2), (1, 11), "give u[:, :-1].T"),
        ((3, 11), (10, 1), "is time along the columns of x? give x.T"),
        ((3, 10), (10, 1), "is time along the columns of x? give x.T"),
        ((1, 2), (0, 1), "at least two"),
        ((11, 2), (7, 1), "us[4] has 7 rows for 11 states; expected 10 (one a step)"),
        ((11, 12), (0, 11), "us[4] has 0 rows for 11 states"),
        ((5, 5), (3, 4), "give u.T"),
    ],
)
def test_a_misfit_names_its_remedy(x: tuple[int, int], u: tuple[int, int], said: str) -> None:
    assert said in _misfit(4, x, u)


def test_many_columns_of_few_steps_are_asked_about_where_they_look_transposed() -> None:
    with pytest.warns(UserWarning, match="is time along the columns"):
        Episodes([np.random.default_rng(0).normal(size=(3, 201))], [np.zeros((2, 200))], 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Episodes([np.random.default_rng(0).normal(size=(3, 200))], [np.zeros((2, 200))], 0.1)
        Episodes([np.random.default_rng(0).normal(size=(201, 3))], [np.zeros((200, 2))], 0.1)


def test_a_command_holds_until_the_last_step_ends() -> None:
    """u = 1 from 0 s, 3 from 0.95 s: the step from 0.9 to 1 s has their mean over time."""
    signal = Signal(np.array([0]), np.array([0.0, 0.95]), np.array([[1.0], [3.0]]))
    assert signal.held(np.linspace(0.0, 1.0, 11))[:, 0] == pytest.approx([1.0] * 9 + [2.0], abs=1e-12)
    early = Signal(np.array([0]), np.array([0.0, 0.95, 7.0]), np.array([[1.0], [3.0], [5.0]]))
    assert early.held(np.linspace(0.0, 1.0, 11))[-1, 0] == pytest.approx(2.0, abs=1e-12)


def test_common_spans_are_intersections() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        first, second = (sorted(rng.choice(40, 8, replace=False).reshape(4, 2).tolist()) for _ in range(2))
        first, second = ([(min(a), max(a)) for a in s] for s in (first, second))
        first, second = (_apart(s) for s in (first, second))
        found = _both(first, second)
        for t in np.arange(0.25, 40.0, 0.5):
            inside = all(any(a <= t <= b for a, b in spans) for spans in (first, second))
            assert inside == any(a <= t <= b for a, b in found)


def _apart(spans: list[tuple[float, float]]) -> list[tuple[float, float]]:
    found: list[tuple[float, float]] = []
    for a, b in spans:
        if not found or a > found[-1][1]:
            found.append((a, b))
    return found


def test_all_pairs_may_be_sampled_and_not_one_more() -> None:
    data = Episodes([np.random.default_rng(0).normal(size=(6, 1))], [np.zeros((5, 1))], 0.1)
    assert np.array_equal(data.pairs().sample(5, 0).x, data.pairs().x)
    with pytest.raises(ValueError, match="n = 6 pairs asked for; the episodes hold 5"):
        data.pairs().sample(6, 0)


def test_values_on_the_bounds_of_a_range_are_inside() -> None:
    t, x = 0.1 * np.arange(6), np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    names: dict[str, list[str]] = {"state_names": ["x"], "input_names": ["u"]}
    found = Episodes.from_arrays(t, x, np.zeros(6), ranges={"x": (0.0, 1.0)}, **names)
    assert len(found) == 1
    for bounds, value in (((0.1, 1.0), "x is 0 at 0 s"), ((0.0, 0.9), "x is 1 at 0.5 s")):
        with pytest.raises(ValueError, match=value):
            Episodes.from_arrays(t, x, np.zeros(6), ranges={"x": bounds}, **names)


def test_a_step_is_absurd_by_its_ratio_to_the_samples() -> None:
    """Milliseconds that are read as seconds are refused at any sample spacing, and a fine step is not."""
    for spacing in (1e-3, 100.0):
        t = spacing * np.arange(50)
        with pytest.raises(ValueError, match="check time_unit"):
            Episodes.from_arrays(t, np.sin(np.arange(50.0)), np.zeros(50), dt=1e-3 * spacing)
        assert Episodes.from_arrays(t, np.sin(np.arange(50.0)), np.zeros(50), dt=spacing).dt == spacing


@pytest.mark.parametrize(
    ("t", "said"),
    [
        ([0.0, 0.1, 0.1, 0.2, 0.3], "1 repeated times"),
        ([0.4, 0.3, 0.2, 0.1, 0.0], "runs backwards"),
        ([*np.linspace(0.0, 3.0, 31), *np.linspace(0.0, 3.0, 31)], "several runs"),
        ([0.0, 0.1, 0.3, 0.2, 0.4, 0.5], "out of order"),
    ],
)
def test_a_clock_that_does_not_rise_is_told_apart(t: list[float], said: str) -> None:
    with pytest.raises(ValueError, match=said) as found:
        Episodes.from_arrays(np.array(t), np.zeros(len(t)), np.zeros(len(t)))
    falls = [k for k in range(len(t) - 1) if t[k + 1] < t[k]] or [k for k in range(len(t) - 1) if t[k + 1] == t[k]]
    assert f"after sample {falls[0]} " in str(found.value)


@pytest.mark.parametrize("shape", [(7, 2), (2, 3, 10)])
def test_matlab_variables_of_another_size_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = tmp_path / "run.mat"
    savemat(path, {"t": 0.1 * np.arange(10), "x": np.zeros(shape), "u": np.zeros(10)})
    with pytest.raises(ValueError, match="expected 10 rows, one a time"):
        Episodes.from_mat(path, "t", "x", "u")


def test_runs_of_a_table_are_told_by_their_column(tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    rows = [f"{0.1 * k:g},{run + 0.01 * k:g},{k},{run}" for run in (1, 2) for k in range(6)]
    path.write_text("t,x,u,run\n" + "\n".join(rows) + "\n")
    found = Episodes.from_csv(path, "t", "x", "u", episode="run")
    assert [float(x[0, 0]) for x in found.xs] == [1.0, 2.0] and [len(u) for u in found.us] == [5, 5]


@pytest.mark.parametrize("zone", [None, datetime.timezone(datetime.timedelta(hours=2))])
def test_instants_are_seconds_since_the_first_and_missing_ones_missing(zone: datetime.tzinfo | None) -> None:
    start = datetime.datetime(2026, 3, 29, 0, 30, tzinfo=zone)
    t = [start + datetime.timedelta(seconds=0.5 * k) for k in range(6)]
    assert seconds(np.array(t, dtype=object), "s") == pytest.approx(0.5 * np.arange(6))
    t[2] = None  # type: ignore[call-overload]
    assert seconds(np.array(t, dtype=object), "s") == pytest.approx([0.0, 0.5, np.nan, 1.5, 2.0, 2.5], nan_ok=True)
    durations = [datetime.timedelta(seconds=2 + k) for k in range(3)]
    assert seconds(np.array(durations, dtype=object), "s") == pytest.approx([2.0, 3.0, 4.0])


def test_masked_and_missing_instants_are_missing() -> None:
    t = np.array(["2026-01-01T00:00:00", "2026-01-01T00:00:01", "NaT", "2026-01-01T00:00:03"], "M8[s]")
    masked = np.ma.MaskedArray(t, mask=[False, True, False, False])
    assert seconds(masked, "s") == pytest.approx([0.0, np.nan, np.nan, 3.0], nan_ok=True)


@pytest.mark.parametrize("sign", [1, -1])
def test_ticks_with_more_digits_than_a_float_keep_their_differences(sign: int) -> None:
    ticks = sign * np.int64(1_790_000_000_000_000_001) + np.arange(5, dtype=np.int64) * 7
    assert np.diff(seconds(ticks, "ns")) == pytest.approx(7e-9, rel=1e-12)


def test_a_roll_out_needs_one_step_after_its_history() -> None:
    data = Episodes([np.arange(4.0)[:, None]], [np.zeros((3, 1))], 0.1)
    start = data.start(0, 2)
    assert start.inputs.shape == (1, 1) and start.states[:, 0].tolist() == [2.0, 3.0]
    with pytest.raises(ValueError, match="episode 0 has 3 steps; 3 delays need at least 4"):
        data.start(0, 3)


@pytest.mark.parametrize("asked", [True, False])
def test_what_looks_transposed_begins_at_four_inputs_a_step(asked: bool) -> None:
    """2 steps of 9 inputs are more than four a step, 3 steps are not."""
    steps = 2 if asked else 3
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        Episodes([np.random.default_rng(0).normal(size=(steps + 1, 10))], [np.zeros((steps, 9))], 0.1)
    assert any("along the columns" in str(w.message) for w in said) is asked


def test_release_numbers_are_compared_by_their_first_two_parts() -> None:
    assert _release("3.7.2") == _release("3.7.0") == (3, 7) < _release("3.10.0") == (3, 10)


def test_the_largest_magnitude_of_a_quantity_is_that_of_all_its_states() -> None:
    data = Episodes([np.array([[0.1, -0.3, 0.0], [0.2, 0.2, 0.0]])], [np.zeros((1, 1))], 0.1)
    assert state_range(data.pairs(), ("q", "q", "w")) == pytest.approx([0.3, 0.3, 1.0])


def test_jitter_counts_early_readings_and_late_ones() -> None:
    for odd in (0.06, 0.14):
        times = np.cumsum([0.0, 0.1, 0.1, odd, 0.1, 0.1, 0.1])
        signal = Signal(np.array([0]), times, np.zeros((7, 1)))
        assert _jitter([[signal]]) == pytest.approx(0.04)


def test_warnings_point_to_the_line_that_reads_the_recording() -> None:
    t = np.concatenate([0.1 * np.arange(30), 40.0 + 0.1 * np.arange(30)])
    u = np.where(np.arange(60) % 30 > 20, np.nan, 1.0)
    with pytest.warns(UserWarning) as said:
        Episodes.from_arrays(t, np.sin(t), u, max_gap=0.3)
    assert {w.filename for w in said} == {__file__}


def test_names_in_a_comment_of_c_do_not_end_it() -> None:
    assert listed(("a*/b", "c"), ("m", "")) == "a* /b [m], c"
    assert listed((), ()) == "none" and listed(("q\u00e9",), ("",)) == "q?"


def signal(times: np.ndarray) -> Signal:
    return Signal(np.array([0]), times, np.zeros((len(times), 1)))


def test_a_command_that_was_read_once_is_no_slow_signal() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert _step(0.1, [[signal(0.1 * np.arange(20)), signal(np.array([0.0]))]], ["x"]) == 0.1


@pytest.mark.parametrize(("dt", "said"), [(0.099, False), (0.101, True), (0.15, True)])
def test_of_more_than_a_hundred_readings_a_step_the_waste_is_said(dt: float, said: bool) -> None:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        assert _step(dt, [[signal(1e-3 * np.arange(2000))]], ["x"]) == dt
    assert any("one is used" in str(w.message) for w in found) == said


def test_two_readings_have_a_spacing_and_one_has_none() -> None:
    assert signal(np.array([1.0, 1.5])).spacing == 0.5
    assert signal(np.array([1.0])).spacing == np.inf


@pytest.mark.parametrize("steps", [1, 2, 10**6])
def test_rounding_of_the_clock_costs_no_step(steps: int) -> None:
    low, step = 3.0, 0.01
    high = low + step * steps * (1.0 - 5e-10)
    grids, short = pieces([signal(np.array([low, high]))], [signal(np.array([low]))], step, 1e9)
    assert len(grids) == 1 and len(grids[0]) == steps + 1 and not short


def test_commands_that_change_within_a_step_count_by_their_time() -> None:
    command = Signal(np.array([0]), np.array([0.0, 1.25, 1.75, 2.5]), np.array([[0.0], [4.0], [8.0], [1.0]]))
    held = command.held(np.array([0.0, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(held[:, 0], [0.0, 0.25 * 0.0 + 0.5 * 4.0 + 0.25 * 8.0, 0.5 * 8.0 + 0.5 * 1.0])


@pytest.mark.parametrize("array", ["x", "u"])
def test_one_array_is_no_list_of_episodes(array: str) -> None:
    x, u = np.zeros((1, 5, 2)), np.zeros((1, 4, 1))
    with pytest.raises(ValueError, match=r"for a single episode give \[x\] and \[u\]"):
        Episodes(x if array == "x" else list(x), u if array == "u" else list(u), 0.1)  # type: ignore[arg-type]


def test_a_clock_that_falls_is_shown_where_it_falls() -> None:
    with pytest.raises(ValueError, match=r"after sample 2 \(3 s, then 2.5 s\)"):
        _check_increasing(np.array([1.0, 2.0, 3.0, 2.5, 4.0, 5.0]), np.arange(6), "")


def test_an_integer_of_numpy_takes_an_episode() -> None:
    data = Episodes([np.full((3, 1), float(i)) for i in range(3)], [np.zeros((2, 1))] * 3, 0.1)
    assert data[np.int64(2)].xs[0][0, 0] == 2.0


def test_neighbours_share_the_memory_of_all_episodes_from_the_first_on() -> None:
    data = Episodes([np.full((3, 1), float(i)) for i in range(3)], [np.zeros((2, 1))] * 3, 0.1)
    assert np.shares_memory(data.subset([0, 1]).xs[0], data.xs[0])
    assert not np.shares_memory(data.subset([1, 0]).xs[0], data.xs[1])


def test_phase_samples_keep_their_names(tmp_path: Path) -> None:
    names = {"state_names": ("a", "b"), "input_names": ("p",)}
    PhaseSamples(x=np.ones((3, 2)), u=np.ones((3, 1)), xdot=np.ones((3, 2)), **names).save(tmp_path / "d2.h5")
    again = PhaseSamples.load(tmp_path / "d2.h5")
    assert (again.state_names, again.input_names) == (("a", "b"), ("p",))


def test_provenance_counts_the_samples_that_are_in_no_episode_and_names_runs_that_were_told() -> None:
    t = np.concatenate([np.arange(50) * 0.1, [100.0]])
    x, u = np.sin(t)[:, None], np.zeros((51, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plain = Episodes.from_arrays(t, x, u, dt=0.1)
        told = Episodes.from_arrays(
            np.tile(t[:50], 2), np.tile(x[:50], (2, 1)), np.zeros((100, 1)), dt=0.1, episode=np.repeat([7, 9], 50)
        )
    assert plain.provenance["lost_samples"] == 1 and "runs" not in plain.provenance
    assert [int(float(label)) for label in told.provenance["runs"]] == [7, 9]


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("slow", [1, 10])
def test_a_slow_signal_is_told_by_its_ratio_to_the_step(unit: float, slow: int) -> None:
    t = unit * np.arange(200)
    fast, other = Signal(np.array([0]), t, t[:, None]), Signal(np.array([1]), t[::slow], t[::slow, None])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        _step(unit, [[fast, other]], ["a", "b"])
    assert len(said) == (slow > 1)


def test_the_command_that_comes_late_is_named() -> None:
    t = 0.1 * np.arange(40)
    u = np.ones((40, 2))
    u[:15, 1] = np.nan
    with pytest.warns(UserWarning, match="u2 has no command before sample 15"):
        Episodes.from_arrays(t, np.sin(t)[:, None], u, dt=0.1, input_names=("u1", "u2"))


def test_small_inputs_are_excited_like_large_ones() -> None:
    u = np.random.default_rng(0).normal(size=(50, 2))
    for size in (1e-9, 1e3):
        assert Episodes([np.zeros((51, 1))], [size * u], 0.1).input_subspace()[1].shape == (2, 2)


def test_the_end_of_a_command_that_is_read_there_is_no_gap() -> None:
    t, nan = np.arange(6.0), np.nan
    command = np.array([[0.0], [1.0], [nan], [nan], [nan], [2.0]])  # read 1 s and 4 s apart: the median is 2.5 s
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        say_what_is_held(t, command, ["u"], 1.0, None)


def test_a_command_that_holds_over_a_step_is_itself_to_the_last_digit() -> None:
    rng = np.random.default_rng(0)
    times, values = np.arange(40.0), rng.normal(size=(40, 2))
    np.testing.assert_array_equal(Signal(np.arange(2), times, values).held(np.arange(41.0)), values)


class Table(list):
    """Rows that name their columns, as those of pandas and polars do."""

    def __init__(self, rows: object, columns: list[str]) -> None:
        super().__init__(np.asarray(rows).tolist())
        self.columns = columns


def test_tables_of_one_recording_name_their_columns_alike() -> None:
    x, u = np.arange(6.0).reshape(3, 2), np.zeros((2, 1))
    alike = Episodes([Table(x, ["a", "b"])] * 2, [u, u], 0.1)
    assert alike.state_names == ("a", "b")
    with pytest.raises(ValueError, match="expected one order"):
        Episodes([Table(x, ["a", "b"]), Table(x, ["b", "a"])], [u, u], 0.1)


def test_an_episode_has_states_and_starts_without_delays() -> None:
    with pytest.raises(ValueError, match="at least one state"):
        Episodes([np.zeros((3, 0))], [np.zeros((2, 1))], 0.1)
    start = Episodes([np.zeros((3, 1))], [np.ones((2, 1))], 0.1).start(0)
    assert start.x_history.shape == (1, 1) and start.u_history.shape == (0, 1)


def test_a_command_is_held_where_it_is_missing_not_where_nothing_was_recorded() -> None:
    nan = np.nan
    slow = np.array([[0.0], [1.0], [0.5], [nan], [1.5]])  # read every 10 s, once after 20 s
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        say_what_is_held(10.0 * np.arange(5), slow, ["u"], 1.0, None)
        say_what_is_held(np.array([0.0, 1.0, 2.0, 40.0, 41.0]), np.ones((5, 1)), ["u"], 1.0, None)


def test_two_readings_have_a_spacing() -> None:
    twice = Signal(np.arange(1), np.array([0.0, 5.0]), np.zeros((2, 1)))
    assert longest_gap(twice, 1.0, None) == BRIDGED * 5.0
