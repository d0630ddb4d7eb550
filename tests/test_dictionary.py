"""Columns, names, delays and derivatives of a dictionary."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from pisplit import Dictionary, Episodes
from pisplit import observables as ob

RNG = np.random.default_rng(0)


def episodes(n: int = 2, m: int = 2) -> Episodes:
    return Episodes([RNG.normal(size=(t + 1, n)) for t in (9, 6)], [RNG.normal(size=(t, m)) for t in (9, 6)], dt=0.1)


def table(order: int = 3) -> ca.Function:
    grid = np.linspace(-6, 6, 40)
    return ca.interpolant("table", "bspline", [grid], np.sin(grid), {"degree": [order]})


def rich() -> Dictionary:
    return Dictionary(
        ob.Constant(),
        ob.Identity(),
        ob.Delays(states=2, inputs=1),
        ob.Polynomials(3),
        ob.Slack(width=0.1),
        ob.Expression(lambda x, u: ca.vertcat(ca.sin(x[0]), x[0] * x[1]), name="s"),
        ob.Expression(lambda x, u: table()(x[1]), name="t"),
        ob.Expression(lambda x, u: u[0] * u[1], name="u1*u2"),
        n_states=2,
        n_inputs=2,
    )


def test_names_say_what_each_column_holds() -> None:
    theta = Dictionary(
        ob.Constant(),
        ob.Identity(),
        ob.Delays(states=1, inputs=2),
        ob.Polynomials(2),
        n_states=2,
        n_inputs=1,
        state_names=("a", "b"),
        quantities=("p", "q"),
    )
    assert " ".join(theta.column_names) == "1 a b a^2 a*b b^2 a[k-1] b[k-1] u1[k-1] u1[k-2] u1"
    assert " ".join(theta.column_quantities) == "1 p q p^2 p*q q^2 p q u u u"
    assert (theta.n_delays, theta.n_lifted, theta.n_features, theta.n_columns) == (2, 10, 1, 11)
    assert (theta.constant_column, list(theta.learned_columns)) == (0, [1, 2, 3, 4, 5])


def test_values_are_those_that_the_names_say() -> None:
    theta, pairs = rich(), episodes().pairs(2)
    columns = dict(zip(theta.column_names, theta.evaluate(pairs).T, strict=True))
    x, u, past = pairs.x.T, pairs.u.T, pairs.u_history[:, -1].T
    soft = lambda s: 0.1 * np.logaddexp(0, s / 0.1)  # noqa: E731
    expected = {
        "1": np.ones(len(pairs)),
        "x2": x[1],
        "x1^2*x2": x[0] ** 2 * x[1],
        "s[1]": np.sin(x[0]),
        "s[2]": x[0] * x[1],
        "x1[k-1]": pairs.x_history[:, 1, 0],
        "x2[k-2]": pairs.x_history[:, 0, 1],
        "u1": u[0],
        "max(0,u1)": soft(u[0]),
        "max(0,u1+u2)": soft(u[0] + u[1]),
        "max(0,-u1-u2)": soft(-u[0] - u[1]),
        "u1*u2": u[0] * u[1],
        "(u1*u2)[k-1]": past[0] * past[1],
        "max(0,u2)[k-1]": soft(past[1]),
    }
    for name, value in expected.items():
        np.testing.assert_allclose(columns[name], value, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(columns["t"], np.sin(x[1]), atol=1e-3)


def test_a_sharp_hinge_is_the_limit_of_the_soft_one() -> None:
    u = RNG.normal(size=(50, 2))
    sharp, soft = (
        Dictionary(ob.States(), ob.Slack(width=w, knots=(0.0, 0.5)), n_states=1, n_inputs=2).features(u)
        for w in (0.0, 1e-3)
    )
    assert (soft - sharp).min() >= 0 and (soft - sharp).max() <= 1e-3 * np.log(2) * (1 + 1e-9)
    huge = Dictionary(ob.States(), ob.Slack(width=1e-9), n_states=1, n_inputs=2).features(1e6 * u)
    assert np.isfinite(huge).all()


def test_the_lift_of_the_next_step_is_the_next_column() -> None:
    theta, pairs = rich(), episodes().pairs(2)
    values, following = theta.evaluate(pairs), theta.next(pairs)
    same = pairs.episode[1:] == pairs.episode[:-1]
    np.testing.assert_array_equal(following[:-1][same], values[1:, : theta.n_lifted][same])


def test_the_compiled_lift_agrees_with_the_evaluation_of_pairs() -> None:
    theta, pairs = rich(), episodes().pairs(2)
    values = theta.evaluate(pairs)
    for i in (0, 5):
        lifted = np.array(theta.lift_function(pairs.x_history[i].T, pairs.u_history[i].T))[:, 0]
        np.testing.assert_allclose(lifted, values[i, : theta.n_lifted], atol=1e-14)


def test_the_lie_derivative_is_the_derivative_along_f() -> None:
    theta = rich()
    x, u, f = RNG.normal(size=(40, 2)), RNG.normal(size=(40, 2)), RNG.normal(size=(40, 2))
    exact = theta.lie_derivative(x, u, f)
    h = 1e-5
    difference = (theta.present(x + h * f) - theta.present(x - h * f)) / (2 * h)
    np.testing.assert_allclose(exact[:, : theta.n_present], difference, atol=1e-7)
    assert not exact[:, theta.n_present :].any()


def test_static_samples_have_the_present_as_their_past() -> None:
    theta = rich()
    x, u = RNG.normal(size=(4, 2)), RNG.normal(size=(4, 2))
    columns = dict(zip(theta.column_names, theta.evaluate_static(x, u).T, strict=True))
    np.testing.assert_array_equal(columns["x2[k-2]"], x[:, 1])
    np.testing.assert_array_equal(columns["u1[k-1]"], u[:, 0])


def test_the_inverse_reads_the_states_back() -> None:
    theta, pairs = rich(), episodes().pairs(2)
    selection = theta.invert
    assert selection is not None
    np.testing.assert_array_equal(theta.evaluate(pairs)[:, : theta.n_lifted] @ selection.T, pairs.x)
    assert Dictionary(ob.Polynomials(2), n_states=2, n_inputs=1).invert is None


def test_functions_of_the_user_may_hold_rootfinders_and_tables() -> None:
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    root = ca.rootfinder("root", "newton", ca.Function("g", [x, u], [x**3 + x - u]))
    v = ca.MX.sym("v")
    statics = ca.Function("statics", [v], [root(0, v)])
    theta = Dictionary(
        ob.Identity(),
        ob.Equilibrium(statics),
        ob.StateMap(table(), names=["sine"], quantities=["angle"]),
        n_states=1,
        n_inputs=1,
    )
    value = theta.features(np.array([[10.0], [2.0]]))[:, 1]
    np.testing.assert_allclose(value, [2.0, 1.0], atol=1e-8)
    slope = theta.lie_derivative(np.array([[0.3]]), np.zeros((1, 1)), np.array([[2.0]]))
    np.testing.assert_allclose(slope[0, 1], 2 * np.cos(0.3), atol=1e-3)
    assert theta.column_quantities[1] == "angle"


def test_names_come_from_the_episodes_unless_given() -> None:
    data = Episodes([np.zeros((3, 2))], [np.zeros((2, 1))], 0.1, state_names=("p", "q"), quantities=("length", "rate"))
    theta = Dictionary(ob.Identity(), n_states=2, n_inputs=1)
    assert theta.named_after(data).column_names == ("p", "q", "u1")
    assert theta.named_after(data).column_quantities == ("length", "rate", "u")
    with pytest.raises(ValueError, match="no states named a, b of the dictionary"):
        Dictionary(ob.Identity(), n_states=2, n_inputs=1, state_names=("a", "b")).named_after(data)
    with pytest.raises(ValueError, match="3 states"):
        Dictionary(ob.Identity(), n_states=3, n_inputs=1).named_after(data)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Dictionary(ob.Expression(lambda x, u: x[0] * u[0], name="b"), n_states=1, n_inputs=1), "Bilinear"),
        (lambda: Dictionary(ob.Expression(lambda x, u: x[9], name="b"), n_states=1, n_inputs=1), "Out of bounds"),
        (lambda: Dictionary(ob.Slack, n_states=1, n_inputs=1), "parentheses"),  # type: ignore[arg-type]
        (lambda: Dictionary(ob.Inputs(), n_states=1, n_inputs=1), "depends on the state"),
        (lambda: Dictionary(ob.States(), ob.Identity(), n_states=1, n_inputs=1), "more than once"),
        (lambda: Dictionary(ob.States(), ob.Delays(1), ob.Delays(2), n_states=1, n_inputs=1), "one, with the longest"),
        (lambda: Dictionary(ob.Polynomials(2), ob.Delays(1), n_states=1, n_inputs=1), "need the states"),
        (lambda: Dictionary(ob.States(), n_states=0, n_inputs=1), "n_states"),
        (lambda: Dictionary(ob.States(), n_states=2, n_inputs=1, state_names=["a"]), "expected 2"),
        (lambda: Dictionary(ob.States(), ob.Equilibrium(table()), n_states=2, n_inputs=2), "expected one: u"),
        (lambda: Dictionary(ob.StateMap(table(), names=["a", "b"]), n_states=1, n_inputs=1), "2 names"),
        (lambda: ob.Delays(states=-1), "states"),
        (lambda: ob.Polynomials(1), "at least 2"),
        (lambda: ob.Slack(width=-1), "width"),
    ],
)
def test_bad_dictionaries_are_refused_in_one_line(build: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


def test_a_function_finds_its_states_and_inputs_by_name() -> None:
    x, u = ca.SX.sym("x", 2), ca.SX.sym("u", 2)
    theta = Dictionary(
        ob.Identity(),
        ob.StateMap(ca.Function("f", [x], [x[0] - 2 * x[1]]), names="f", takes=("angle", "rate")),
        ob.Equilibrium(ca.Function("g", [u], [u[0] - 2 * u[1]]), names="g", takes=("left", "right")),
        n_states=2,
        n_inputs=2,
    )
    names = {"state_names": ("rate", "angle"), "input_names": ("right", "left")}
    data = Episodes([np.array([[3.0, 1.0]] * 3)], [np.array([[5.0, 7.0]] * 2)], 0.1, **names)
    found = theta.named_after(data).evaluate(data.pairs())
    columns = theta.named_after(data).column_names
    assert found[0, columns.index("f")] == 1.0 - 2 * 3.0
    assert found[0, columns.index("g")] == 7.0 - 2 * 5.0
    other = Episodes([np.zeros((3, 2))], [np.zeros((2, 2))], 0.1, state_names=("rate", "height"))
    with pytest.raises(ValueError, match="no states named angle of a function in it, but height"):
        theta.named_after(other)
