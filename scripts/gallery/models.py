"""Pictures of models: what the split is worth, eigenvalues, errors, reduction, actuators."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import pisplit as ps
from pisplit import observables as ob
from pisplit.models import systems
from pisplit.pictures.figures import below, new_figure, tidy

DT = 0.05


@cache
def _duffing(number: int = 8, steps: int = 120) -> ps.Episodes:
    """Recordings of a Duffing oscillator under random steps."""
    draws = [np.random.default_rng(k) for k in range(number)]
    runs = [np.repeat(g.uniform(-1.0, 1.0, (steps // 6, 1)), 6, axis=0) for g in draws]
    starts = np.array([g.uniform(-1.0, 1.0, 2) for g in draws])
    return ps.Episodes.from_system(systems.duffing(stiffness=1.0), starts, runs, DT)


def _theta(degree: int = 3) -> ps.Dictionary:
    return ps.Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(degree), n_states=2, n_inputs=1)


@cache
def _fitted() -> ps.LinearEDMDc:
    return ps.LinearEDMDc(_theta(), alpha=1e-6).fit(_duffing()[:6])


def phase_portrait() -> Any:
    """Free motions of the Duffing oscillator with two wells (grey) and roll-outs of six seconds of a linear model
    with monomials up to degree five, from the same starts (blue). A linear model cannot hold two wells: inner
    starts end in the wrong place.
    """
    spring = systems.duffing()
    draws = [np.random.default_rng(k) for k in range(60)]
    data = ps.Episodes.from_system(
        spring, np.array([g.uniform(-1.8, 1.8, 2) for g in draws]), [np.zeros((120, 1))] * 60, DT
    )
    theta = ps.Dictionary(ob.Constant(), ob.Identity(), ob.Polynomials(5), n_states=2, n_inputs=1)
    model = ps.LinearEDMDc(theta, alpha=1e-9).fit(data[:50])
    figure = new_figure(6.4, 5.2)
    axis: Any = figure.subplots()
    for k, x in enumerate(data.xs[50:]):
        axis.plot(*x.T, color="#9aa7b5", lw=2.6, label="truth" if k == 0 else None)
        found = model.predict(x[0], np.zeros((120, 1)))
        axis.plot(*np.asarray(found).T, color="#1b6ca8", lw=1.1, label="model" if k == 0 else None)
        axis.plot(*x[0], "k.", ms=5)
    axis.set(xlabel="x", ylabel="v", title="two wells")
    below(axis)
    tidy(axis)
    return figure


def eigenvalues_to_believe() -> Any:
    """Eigenvalues of the generator of the slow manifold on monomials up to degree four, coloured by their
    residuals (`generator_spectrum(...).plot()`): at 0 there is an eigenfunction of the system, light ones
    belong to the dictionary.
    """
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (600, 2))
    samples = ps.PhaseSamples.from_system(systems.slow_manifold(), x, np.zeros((600, 1)))
    theta = _theta(4)
    return ps.generator_spectrum(theta, samples, np.ones(theta.n_columns)).plot()


def known_half_step() -> Any:
    """The half step of what is known of the Duffing oscillator, exp(dt/2 L_f), and its generator
    (`half_step(...).plot()`).
    """
    x = np.random.default_rng(0).uniform(-1.5, 1.5, (600, 2))
    samples = ps.PhaseSamples.from_system(systems.duffing(), x, np.zeros((600, 1)), dt=DT)
    theta = _theta()
    return ps.half_step(theta, samples, DT, np.ones(theta.n_columns)).plot()


def learning_curves() -> Any:
    """Median error of roll-outs over the number of recorded pairs, five draws: EDMDc, and the split in which the
    spring is known and only the input is learned (`learning_curve(...).plot()`). With few pairs the split is
    ahead; with many its bias shows, for cubic monomials are not closed under the spring.
    """
    spring = systems.duffing(stiffness=1.0)
    x = np.random.default_rng(1).uniform(-1.5, 1.5, (500, 2))
    d2 = ps.PhaseSamples.from_system(spring, x, np.zeros((500, 1)))
    split = ps.PIEDMDc(_theta(), alpha=1e-6, penalty="ridge", rows="inputs", half_step="generator")
    plain = ps.LinearEDMDc(_theta(), alpha=1e-6)
    d1, test = _duffing()[:6], _duffing()[6:]
    return ps.learning_curve({"L-EDMDc": plain, "PI-EDMDc": split}, d1, test, [12, 24, 48, 96, 192], d2=d2).plot()


def comparison() -> Any:
    """Three models of one oscillator on the same test recordings: median and quartiles, and errors by horizon
    (`compare(...).plot()`).
    """
    d1, test = _duffing()[:6], _duffing()[6:]
    linear = ps.Dictionary(ob.Constant(), ob.Identity(), n_states=2, n_inputs=1)
    delayed = ps.Dictionary(ob.Constant(), ob.Identity(), ob.Delays(states=4, inputs=4), n_states=2, n_inputs=1)
    models = {"linear": linear, "four delays": delayed, "cubic": _theta()}
    fitted = {name: ps.LinearEDMDc(theta, alpha=1e-6).fit(d1) for name, theta in models.items()}
    return ps.compare(fitted, test, horizons=[1, 3, 10, 30, 100], stride=5).plot()


def errors_over_time() -> Any:
    """Squared errors of open-loop roll-outs of the cubic model, one line a test recording
    (`model.score(test).plot()`).
    """
    return _fitted().score(_duffing()[6:]).plot()


def errors_ahead() -> Any:
    """How far ahead the cubic model may be trusted: errors by horizon in parts of the spread
    (`horizon_errors(...).plot()`).
    """
    return ps.horizon_errors(_fitted(), _duffing()[6:], [1, 3, 10, 30, 100]).plot()


def errors_foretold() -> Any:
    """What the errors will be under commands that nobody recorded, from residuals of recorded pairs alone
    (`predicted_error(...).plot()`).
    """
    return ps.predicted_error(_fitted(), _duffing()[6:]).plot()


def koopman_modes() -> Any:
    """Eigenvalues, frequencies and time constants of the cubic model (`modes(model.lifted).plot()`)."""
    return ps.modes(_fitted().lifted).plot()


def the_model_itself() -> Any:
    """Eigenvalues and step responses of the cubic model (`model.lifted.plot()`)."""
    return _fitted().lifted.plot()


def reduction() -> Any:
    """Hankel singular values of the cubic model and what six lifted states may miss (`balanced_truncation(model,
    6).plot()`).
    """
    return ps.balanced_truncation(_fitted().lifted, 6).plot()


def identified() -> Any:
    """All that `identify` tries on recordings of a Duffing oscillator, by horizon, and a held-out recording beside
    its prediction (`identify(d1).plot()`).
    """
    return ps.identify(_duffing(), progress=False).plot()


def lag_and_play() -> Any:
    """Lag and play of servos found from recorded commands alone: the true ones are 60 ms and 0.1
    (`find_actuator(d1).plot()`).
    """
    spring, actuator = systems.duffing(stiffness=1.0), ps.Actuator(lag=0.06, play=0.1)
    commands = [np.repeat(np.random.default_rng(k).uniform(-1.0, 1.0, (25, 1)), 8, axis=0) for k in range(3)]
    blank = ps.Episodes([np.zeros((len(u) + 1, 2)) for u in commands], commands, DT)
    moved = blank.through(actuator)
    xs = [spring.simulate([0.0, 0.0], u[:, :1], DT) for u in moved.us]
    return ps.find_actuator(ps.Episodes(xs, commands, DT)).plot()
