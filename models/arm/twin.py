"""Models of a simulated twin of the arm: dictionaries that suit its fields, and the model that knows the twin alone."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from pisplit import Dictionary, Episodes, TwinEDMDc
from pisplit import observables as ob
from pisplit.checks import Array

#: Numbers of principal components whose products are columns and of radial functions of the inputs (with slack
#: features), and ridges of the twin's regression: what rolls the twin's last episodes out best is taken, beside the
#: plain fields, which are the safer choice where the twin is wrong. Tuned on the twins of docs/ablation.md.
RICH, PLAIN = ((4, 0, 1e-6), (6, 0, 1e-6), (12, 0, 3e-5), (12, 0, 1e-4), (4, 100, 1e-5)), (0, 0, 1e-5)
#: The largest number of the twin's last episodes that are held out.
HELD_OUT = 6
#: Centres of radial functions are chosen from every seventh input, and there are some for each of them.
THINNED, ROWS_PER_CENTRE = 7, 4
#: Softplus width of slack features [m].
SLACK_WIDTH = 1e-4
#: Strains v of a backbone without shear and stretch are axial forces in the seventh digit: they predict nothing.
OMIT: tuple[str, ...] = ("v",)


def twin_dictionaries(twin: Episodes, excitation: Array) -> list[tuple[Dictionary, float]]:
    """The plain dictionary, and the rich one that rolls held-out episodes of the ``twin`` out best, with their ridges.

    twin        simulated recordings of the fields of an arm (:func:`pisplit.models.arm.make_episodes`), two or more
    excitation  (E, T, m) displacements [m]; ridges are raised until models stay bounded under them

    The ridges are ``twin_alpha`` of :class:`pisplit.TwinEDMDc`.

    Raises ValueError for a twin of fewer than two episodes.
    """
    if len(twin) < 2:
        raise ValueError(f"the twin has {len(twin)} episode; expected at least 2, one to learn from and one held out")
    out = max(1, min(HELD_OUT, len(twin) // 4))
    training, held = twin[:-out], twin[-out:]
    found: dict[tuple[int, int, float], tuple[bool, float, float]] = {}
    for components, centres, ridge in RICH:
        if ROWS_PER_CENTRE * centres > len(training.stacked_inputs()[::THINNED]):
            continue
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # what is not bounded or diverges is not taken
            fit = twin_alone(twin_dictionary(training, components, centres), ridge, training, excitation)
            error = np.nan_to_num(fit.score(held, "shape").median, nan=np.inf)
        found[components, centres, ridge] = not fit.bounded_, error, fit.twin_alpha_
    components, centres, _ = best = min(found, key=lambda key: found[key][:2])
    return [
        (twin_dictionary(twin, *PLAIN[:2]), PLAIN[-1]),
        (twin_dictionary(twin, components, centres), found[best][-1]),
    ]


def twin_dictionary(twin: Episodes, components: int = 0, centres: int = 0, delays: int = 0) -> Dictionary:
    """Bilinear dictionary of the fields and displacements of the ``twin``.

    components  number of principal components of the states whose squares and products are columns
    centres     number of radial functions of the inputs, which come with slack features; 0 for neither
    delays      of the states
    """
    inputs: list[Any] = []
    if centres:
        inputs = [ob.Slack(SLACK_WIDTH), ob.Radial.from_data(twin.stacked_inputs()[::THINNED], centres, of="inputs")]
    leading = [ob.Principal.of(twin.stacked_states(), components, twin.quantities, OMIT)] if components else []
    return Dictionary(
        ob.Constant(),
        ob.States(),
        *(ob.compose(ob.Polynomials(2), c) for c in leading),
        ob.Inputs(),
        ob.Polynomials(2, of="inputs"),
        *inputs,
        ob.Delays(states=delays, inputs=1),
        ob.Bilinear(),
        n_states=twin.n_states,
        n_inputs=twin.n_inputs,
        state_names=twin.state_names,
        input_names=twin.input_names,
    )


def twin_alone(theta: Dictionary, ridge: float, twin: Episodes, excitation: Array) -> TwinEDMDc:
    """The model of the ``twin`` with the dictionary ``theta``: recorded pairs have no weight.

    ``ridge`` (``twin_alpha``) is where the search begins for a model that stays bounded under the ``excitation``
    (E, T, m), displacements in m.
    """
    return TwinEDMDc(theta, alpha=1e8, twin_alpha=ridge, omit=OMIT).fit(twin[:1], twin, excitation=excitation)
