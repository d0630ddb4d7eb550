"""The columns of every observable hold what their names say, and their derivatives are exact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import comb

from pisplit import Dictionary
from pisplit import observables as ob

RNG = np.random.default_rng(0)
X, U = RNG.uniform(-1.5, 1.5, (40, 3)), RNG.uniform(-1.5, 1.5, (40, 2))


def dictionary(*observables: Any) -> Dictionary:
    return Dictionary(ob.States(), *observables, n_states=3, n_inputs=2)


def state_columns(*observables: Any) -> dict[str, np.ndarray]:
    """Columns by name, the states themselves left out."""
    theta = dictionary(*observables)
    return dict(list(zip(theta.column_names, theta.present(X).T, strict=False))[3:])


def input_columns(*observables: Any) -> dict[str, np.ndarray]:
    theta = dictionary(*observables)
    return dict(zip(theta.feature_names, theta.features(U).T, strict=True))


def says(name: str) -> np.ndarray:
    """The value that a polynomial, trigonometric or hinge name stands for."""
    values = {f"x{i + 1}": X[:, i] for i in range(3)} | {f"u{i + 1}": U[:, i] for i in range(2)}
    functions = {"cos": np.cos, "sin": np.sin, "max": np.maximum}
    return np.asarray(eval(name.replace("^", "**"), {"__builtins__": {}}, values | functions))


ALL = [
    ob.Polynomials(4),
    ob.Polynomials(3, each=2),
    ob.Polynomials(each=(0, 2, 1)),
    ob.Polynomials(3, variables=("x1", "x3")),
    ob.Polynomials(3, of="inputs"),
    ob.Fourier(3, period=(1.0, 2.0, 3.0)),
    ob.Fourier(1, of="inputs", variables=(1,)),
    ob.Hinge([[1, -2, 0], [0, 0.5, 1]], offsets=[0.1, -0.2]),
    ob.Hinge([[1, 1]], of="inputs"),
    ob.Polynomials(2) * ob.States(),
    ob.Fourier(1, variables=("x1",)) * ob.Fourier(1, variables=("x2",)),
    ob.States() * ob.States(),
    ob.Inputs() * ob.Inputs(),
]


@pytest.mark.parametrize("observable", ALL, ids=repr)
def test_columns_are_what_their_names_say(observable: Any) -> None:
    found = state_columns(observable) | input_columns(observable)
    assert found
    for name, values in found.items():
        # Names of frequencies are printed with six digits.
        np.testing.assert_allclose(values, says(name), rtol=1e-4, atol=1e-4, err_msg=name)


def test_the_number_of_monomials_is_the_binomial() -> None:
    for n, d in ((2, 5), (3, 4), (1, 6)):
        theta = Dictionary(ob.Constant(), ob.States(), ob.Polynomials(d), n_states=n, n_inputs=0)
        assert theta.n_columns == comb(n + d, d, exact=True)


def test_each_variable_has_its_own_degree() -> None:
    assert set(state_columns(ob.Polynomials(each=(0, 2, 1)))) == {"x2^2", "x2*x3", "x2^2*x3"}
    assert set(state_columns(ob.Polynomials(2, each=1))) == {"x1*x2", "x1*x3", "x2*x3"}


def test_random_fourier_columns_approach_the_gaussian_kernel() -> None:
    theta = Dictionary(ob.RandomFourier(4000, width=(0.7, 1.0, 2.0), seed=3), n_states=3, n_inputs=0)
    values = theta.present(X)
    distance = ((X[:, None] - X) / np.array([0.7, 1.0, 2.0])) ** 2
    np.testing.assert_allclose(values @ values.T, np.exp(-0.5 * distance.sum(axis=2)), atol=0.08)


def test_seeds_repeat_and_differ() -> None:
    one, again, other = (Dictionary(ob.RandomFourier(5, seed=s), n_states=3, n_inputs=0).present(X) for s in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.1
    state_columns(ob.RandomFourier(3, seed=1), ob.RandomFourier(3, seed=2))  # names differ too


@pytest.mark.parametrize("kind", ["gaussian", "thin_plate"])
def test_radial_columns_are_functions_of_the_scaled_distance(kind: str) -> None:
    centres, width = X[:4], np.array([0.5, 1.0, 2.0])
    values = np.array(list(state_columns(ob.Radial(centres, width, kind)).values())).T
    r = np.sqrt((((X[:, None] - centres) / width) ** 2).sum(axis=2))
    expected = np.exp(-0.5 * r**2) if kind == "gaussian" else r**2 * np.log(np.where(r > 0, r, 1.0))
    np.testing.assert_allclose(values, expected, atol=1e-12)
    slopes = Dictionary(ob.Radial(centres, width, kind), n_states=3, n_inputs=0).present_derivative(X, np.ones_like(X))
    assert np.isfinite(slopes).all()


def test_centres_from_separated_clusters_are_their_means() -> None:
    rng = np.random.default_rng(4)
    means = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 1e-3]]) * np.array([1.0, 1e3])
    data = np.concatenate([m + rng.normal(size=(50, 2)) * np.array([0.01, 1e-3]) for m in means])
    found = np.array(ob.Radial.from_data(data, 3, seed=1).centres)
    exact = data.reshape(3, 50, 2).mean(axis=1)
    order = np.lexsort(np.round(found / data.std(axis=0), 3).T)
    np.testing.assert_allclose(found[order], exact[np.lexsort(np.round(exact / data.std(axis=0), 3).T)], rtol=1e-9)
    drawn = np.array(ob.Radial.from_data(data, 7, method="random").centres)
    assert all((np.abs(data - row).max(axis=1) < 1e-9).any() for row in drawn)
    assert ob.Radial.from_data(data, 7, seed=2) == ob.Radial.from_data(data, 7, seed=2)


def test_softplus_approaches_the_hinge_and_its_derivative_is_its_slope() -> None:
    directions = [[1.0, -1.0, 0.5]]
    sharp, soft = (
        Dictionary(ob.Hinge(directions, width=w), n_states=3, n_inputs=0).present(X)[:, 0] for w in (0.0, 1e-3)
    )
    assert (soft - sharp).min() >= 0 and (soft - sharp).max() <= 1e-3 * np.log(2) * (1 + 1e-9)
    theta = Dictionary(ob.Hinge(directions, width=0.2), n_states=3, n_inputs=0)
    v = RNG.normal(size=X.shape)
    slope = 1.0 / (1.0 + np.exp(-(X @ directions[0]) / 0.2)) * (v @ directions[0])
    np.testing.assert_allclose(theta.present_derivative(X, v)[:, 0], slope, atol=1e-12)


def test_sums_are_the_columns_of_their_parts() -> None:
    total = ob.Constant() + ob.Identity() + ob.Delays(1, 1) + ob.Polynomials(2) + ob.Bilinear(("x1",))
    one = Dictionary(total, n_states=3, n_inputs=2)
    parts = (ob.Constant(), ob.Identity(), ob.Delays(1, 1), ob.Polynomials(2), ob.Bilinear(("x1",)))
    other = Dictionary(*parts, n_states=3, n_inputs=2)
    assert one.column_names == other.column_names and one.fingerprint() == other.fingerprint()
    assert one.constant_column == 0 and one.state_columns is not None


def test_products_distribute_over_sums() -> None:
    a, b, c = ob.Fourier(1), ob.Polynomials(2), ob.Constant()
    left, right = state_columns((a + b) * c), state_columns(a * c + b * c)
    assert left.keys() == right.keys()
    for name in left:
        np.testing.assert_allclose(left[name], right[name])


def test_a_product_with_itself_takes_each_pair_once() -> None:
    assert set(state_columns(ob.States() * ob.States())) == set(state_columns(ob.Polynomials(2)))


def test_a_composition_is_the_outer_function_of_the_inner_columns() -> None:
    inner = ob.Fourier(1, variables=("x1",)) + ob.Expression(lambda x, u: u[0] - 2 * u[1], name="d")
    outer = ob.Polynomials(2) + ob.Polynomials(3, of="inputs") + ob.Expression(lambda y, v: y[0] - y[1], name="e")
    states, inputs = state_columns(ob.compose(outer, inner)), input_columns(ob.compose(outer, inner))
    c, s, d = np.cos(X[:, 0]), np.sin(X[:, 0]), U[:, 0] - 2 * U[:, 1]
    for name, value in {"cos(x1)^2": c**2, "cos(x1)*sin(x1)": c * s, "sin(x1)^2": s**2, "e": c - s}.items():
        np.testing.assert_allclose(states[name], value, atol=1e-14)
    assert set(inputs) == {"d^2", "d^3"}
    np.testing.assert_allclose(inputs["d^3"], d**3, atol=1e-13)


def test_compositions_associate() -> None:
    f, g, h = ob.Polynomials(2), ob.Fourier(1), ob.Polynomials(2, variables=("x1", "x2"))
    left, right = state_columns(ob.compose(f, ob.compose(g, h))), state_columns(ob.compose(ob.compose(f, g), h))
    assert left.keys() == right.keys()
    for name in left:
        np.testing.assert_allclose(left[name], right[name], atol=1e-13)


@pytest.mark.parametrize(
    "observable",
    [
        *ALL,
        ob.RandomFourier(6),
        ob.Radial(X[:3], 0.7),
        ob.Radial(X[:3] + 0.01, 0.7, "thin_plate"),
        ob.Hinge([[1, 2, 3]], width=0.3),
        ob.compose(ob.Radial([[0.1, 0.2]], 0.5), ob.Fourier(1, variables=("x2",))),
    ],
    ids=repr,
)
def test_derivatives_along_a_field_are_those_of_the_columns(observable: Any) -> None:
    theta, f, h = dictionary(observable), RNG.normal(size=X.shape), 1e-5
    difference = (theta.present(X + h * f) - theta.present(X - h * f)) / (2 * h)
    np.testing.assert_allclose(theta.present_derivative(X, f), difference, atol=1e-5)


def test_the_derivative_of_a_bilinear_dictionary_multiplies_by_the_held_input() -> None:
    theta = Dictionary(ob.Constant(), ob.Identity(), ob.Bilinear(), ob.Polynomials(2), n_states=3, n_inputs=2)
    f = RNG.normal(size=X.shape)
    columns = dict(zip(theta.column_names, theta.lie_derivative(X, U, f).T, strict=True))
    np.testing.assert_allclose(columns["u2*x1*x3"], U[:, 1] * (f[:, 0] * X[:, 2] + X[:, 0] * f[:, 2]), atol=1e-12)
    values = dict(zip(theta.column_names, theta.evaluate_static(X, U).T, strict=True))
    np.testing.assert_allclose(values["u1*x2^2"], U[:, 0] * X[:, 1] ** 2, atol=1e-13)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ob.Polynomials(), "neither degree nor each"),
        (lambda: dictionary(ob.Polynomials(each=(1, 2))), "expected 3, one a variable"),
        (lambda: dictionary(ob.Polynomials(2, variables=("x9",))), "variables"),
        (lambda: dictionary(ob.Polynomials(2, variables=())), "variables"),
        (lambda: dictionary(ob.Polynomials(2, of="outputs")), "of = 'outputs'"),
        (lambda: ob.Fourier(0), "order"),
        (lambda: ob.Fourier(1, period=-1.0), "period"),
        (lambda: dictionary(ob.Fourier(1, period=(1.0, 2.0))), "period has 2"),
        (lambda: ob.RandomFourier(5, seed=-1), "seed"),
        (lambda: ob.Radial([]), "centres"),
        (lambda: dictionary(ob.Radial([[0.0, 1.0]])), "expected 3, one a variable"),
        (lambda: ob.Radial([[0.0]], kind="cubic"), "kind"),
        (lambda: ob.Radial.from_data(np.zeros((9, 2)), 2), "different rows"),
        (lambda: ob.Radial.from_data(X, 2, method="grid"), "method"),
        (lambda: dictionary(ob.Hinge([[1.0, 2.0]])), "directions have 2"),
        (lambda: ob.Hinge([[1.0]], offsets=[0.0, 1.0]), "offsets"),
        (lambda: dictionary(ob.States() * ob.Inputs()), "BilinearEDMDc"),
        (lambda: ob.States() * ob.Delays(1), "give it to the dictionary"),
        (lambda: ob.compose(ob.Polynomials(2), ob.Bilinear()), "give it to the dictionary"),
        (lambda: ob.compose(ob.Polynomials, ob.States()), "parentheses"),
    ],
)
def test_bad_observables_are_refused_in_one_line(build: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        build()
    assert "\n" not in str(error.value)


def test_large_products_are_kept_whole_and_give_the_same_columns() -> None:
    few = Dictionary(
        ob.Identity(), ob.RandomFourier(10, seed=3), ob.Polynomials(2, variables=[0, 1]), n_states=140, n_inputs=1
    )
    many = Dictionary(
        ob.Identity(), ob.RandomFourier(150, seed=3), ob.Polynomials(2, variables=[0, 1]), n_states=140, n_inputs=1
    )
    assert few.lift_function.is_a("SXFunction") and many.lift_function.is_a("MXFunction")
    x, v = RNG.normal(size=(7, 140)), RNG.normal(size=(7, 140))
    draw = np.random.default_rng(3)
    w, b = draw.standard_normal((150, 140)), draw.uniform(0.0, 2.0 * np.pi, 150)
    first = many.column_names.index("rff3[1]")
    waves, slopes = (part[:, first : first + 150] for part in (many.present(x), many.present_derivative(x, v)))
    np.testing.assert_allclose(waves, np.sqrt(2 / 150) * np.cos(x @ w.T + b), atol=1e-12)
    np.testing.assert_allclose(slopes, -np.sqrt(2 / 150) * np.sin(x @ w.T + b) * (v @ w.T), atol=1e-10)
    rest = [i for i, name in enumerate(few.column_names) if "rff" not in name]
    same = [many.column_names.index(few.column_names[i]) for i in rest]
    u = np.zeros((7, 1))
    np.testing.assert_array_equal(many.evaluate_static(x, u)[:, same], few.evaluate_static(x, u)[:, rest])


def test_principal_components_are_uncorrelated_and_of_unit_variance() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(500, 2)) @ rng.normal(size=(2, 5)) + 3.0
    theta = Dictionary(ob.Principal.of(x, 2), n_states=5, n_inputs=0)
    columns = theta.present(x)
    np.testing.assert_allclose(columns.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(columns.T @ columns / 500, np.eye(2), atol=1e-10)
    quadratic = Dictionary(ob.compose(ob.Polynomials(2), ob.Principal.of(x, 2)), n_states=5, n_inputs=0)
    np.testing.assert_allclose(quadratic.present(x)[:, 1], columns[:, 0] * columns[:, 1], atol=1e-12)


def test_principal_components_that_the_data_do_not_have_are_refused() -> None:
    x = np.outer(np.arange(6.0), np.ones(3))
    with pytest.raises(ValueError, match="vary in 1 directions"):
        ob.Principal.of(x, 2)
    with pytest.raises(ValueError, match="have fewer"):
        ob.Principal.of(x, 4)
