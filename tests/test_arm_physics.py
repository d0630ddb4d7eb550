"""What is known of an arm: its backbone as a generator, its ports, its equilibria; PI-EDMDc with them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pisplit import Dictionary, Episodes, LinearEDMDc, PhaseSamples, PIEDMDc
from pisplit import observables as ob
from pisplit.generator import generator_edmd
from pisplit.models import rod
from pisplit.models.arm.phase_samples import deviations_from_equilibrium, make_phase_samples
from pisplit.models.arm.physics import ArmPhysics
from pisplit.models.arm.recording import make_episodes
from pisplit.models.arm.static_table import equilibrium_table
from pisplit.models.arm.tendon_arm import TendonArm
from pisplit.models.rod.equations.prestressed import prestressed_acceleration

STATIONS = 3


@pytest.fixture(scope="module")
def physics() -> ArmPhysics:
    return ArmPhysics(equilibrium_table(TendonArm.paper(nodes=3), 0.016, STATIONS, points=17), STATIONS)


@pytest.fixture(scope="module")
def options(physics: ArmPhysics) -> dict[str, Any]:
    return physics.options()


@pytest.fixture(scope="module")
def episodes(physics: ArmPhysics, tmp_path_factory: pytest.TempPathFactory) -> Episodes:
    path = tmp_path_factory.mktemp("d1") / "d1.h5"
    return make_episodes(physics.arm, path, 5, 80, stations=STATIONS, seed=1, workers=1, progress=False)


@pytest.fixture(scope="module")
def d2(physics: ArmPhysics, episodes: Episodes, tmp_path_factory: pytest.TempPathFactory) -> PhaseSamples:
    deviations, rates = deviations_from_equilibrium(physics.arm, episodes)
    path = tmp_path_factory.mktemp("d2") / "d2.h5"
    return make_phase_samples(
        physics.arm, path, 200, rates, deviations, stations=STATIONS, seed=1, workers=1, progress=False
    )


def by_differences(physics: ArmPhysics, move: np.ndarray) -> np.ndarray:
    """d[xi_t, xi_tt]/d[xi, xi_t] (2n, 2n) of the prestressed backbone at the equilibrium under a move."""
    arm = physics.arm
    scene, n = arm.scene, arm.scene.n_strains
    prestressed = prestressed_acceleration(arm.passive)
    xi = scene.statics().solve(physics.table.displacements(move)).state[:n]
    columns = []
    for k in range(2 * n):
        step = np.zeros(2 * n)
        step[k] = 1e-5 * np.tile(scene.nominal_strains, 2)[k]
        ends = [np.asarray(prestressed(xi + s * step[:n], s * step[n:], xi)).ravel() for s in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2 * step[k]))
    top = np.hstack([np.zeros((n, n)), np.eye(n)])
    return np.vstack([top, np.array(columns).T])


def test_tangent_samples_give_the_linearisation_of_the_prestressed_backbone(
    physics: ArmPhysics, options: dict[str, Any]
) -> None:
    theta = physics.dictionary()
    generator = generator_edmd(theta, options["tangent"], np.ones(theta.n_columns))
    learned = theta.learned_columns
    found = np.linalg.eigvals(generator[np.ix_(learned, learned)])
    exact = np.linalg.eigvals(by_differences(physics, np.zeros(2)))
    found, exact = (values[np.argsort(np.abs(values))][:8] for values in (found, exact))
    np.testing.assert_allclose(np.abs(found), np.abs(exact), rtol=2e-4)
    assert found.real.max() < 0.0


def test_an_arm_under_its_prestress_rests(physics: ArmPhysics) -> None:
    prestressed, n = prestressed_acceleration(physics.arm.passive), physics.arm.scene.n_strains
    xi = np.random.default_rng(0).normal(size=n)
    assert np.abs(np.asarray(prestressed(xi, np.zeros(n), xi))).max() < 1e-6
    with pytest.raises(ValueError, match="no inputs") as error:
        prestressed_acceleration(physics.arm.scene)
    assert "\n" not in str(error.value)


def test_tendons_act_through_the_ports_and_feel_the_loads(physics: ArmPhysics, options: dict[str, Any]) -> None:
    """The exact linearisation of the arm is that of the prestressed backbone plus ports G loads with four numbers G."""
    arm = physics.arm
    rest = arm.scene.statics().solve(arm.rest_inputs).state
    difference = arm.scene.linearise(rest).A - by_differences(physics, np.zeros(2))
    ports, loads = options["ports"], options["loads"]
    assert ports.shape == (18, 2) and loads.shape == (2, 18)
    gains = np.linalg.pinv(ports) @ difference @ np.linalg.pinv(loads)
    n = arm.scene.n_strains
    bending = [i for i in range(n) if i % 3 != 2]  # tension also resists twist, which is no port
    ends = np.ix_([n + i for i in bending], bending)
    left = (difference - ports @ gains @ loads)[ends]
    assert np.linalg.norm(left) < 1e-4 * np.linalg.norm(difference[ends])
    # Tendons at angles a_i add the stiffness sum r_i r_i^T / (c L) L = 1.5 offset^2 / c in both planes of bending.
    np.testing.assert_allclose(gains, 1.5 * 15.06e-3**2 / 1e-4 * np.eye(2), rtol=5e-3, atol=1e-6)


def test_the_equilibrium_of_the_options_is_that_of_the_dictionary(physics: ArmPhysics, options: dict[str, Any]) -> None:
    theta = physics.dictionary()
    for move in ([0.003, -0.006], [0.0, 0.012]):
        u = physics.table.displacements(np.array(move))
        state = physics.arm.scene.statics().solve(u).state
        fields = physics.arm.scene.fields(state, STATIONS).reshape(1, -1)
        psi = theta.present(fields)[0][theta.learned_columns]
        found = options["equilibrium"] @ theta.features(u[None])[0]
        np.testing.assert_allclose(found, psi, atol=2e-5 / physics.arm.scene.rod.length)


@pytest.fixture(scope="module")
def stiff_prior(physics: ArmPhysics, options: dict[str, Any], episodes: Episodes, d2: PhaseSamples) -> PIEDMDc:
    model = PIEDMDc(physics.dictionary(), alpha=1e14, penalty="ridge", split="hold", options=options)
    return model.fit(episodes[:2], d2)


@pytest.mark.parametrize("move", [(0.0, 0.0), (0.005, -0.004), (-0.012, 0.012)])
def test_every_equilibrium_is_a_fixed_point(
    physics: ArmPhysics, options: dict[str, Any], stiff_prior: PIEDMDc, move: tuple[float, float]
) -> None:
    lifted, theta = stiff_prior.lifted, stiff_prior.theta_
    phi = theta.features(physics.table.displacements(np.array(move))[None])
    z = np.concatenate([[1.0], options["equilibrium"] @ phi[0], phi[0]])
    found = z
    scale = np.concatenate([[1.0], np.repeat([1.0 / 0.7144, 10.0], 9), np.ones(len(phi[0]))])
    for _ in range(100):
        found = lifted.A @ found + lifted.B @ phi[0] + lifted.c
    assert np.abs((found - z) / scale).max() < 1e-8  # rounding of the exponential, whose argument is of size 1e6


def test_the_physical_map_is_stable_and_slower_than_the_backbone(stiff_prior: PIEDMDc) -> None:
    details = stiff_prior.fit_.details
    assert 0.5 < details["radius"] < 1.0
    gains = np.array(details["gains"])
    assert gains.shape == (2, 2) and np.isfinite(gains).all()


def test_from_one_short_episode_it_predicts_better_than_edmdc(
    physics: ArmPhysics, options: dict[str, Any], episodes: Episodes, d2: PhaseSamples
) -> None:
    plain = Dictionary(
        ob.Constant(), ob.Identity(), ob.Delays(inputs=1), n_states=24 * STATIONS, n_inputs=physics.arm.scene.n_inputs
    )
    shared: dict[str, Any] = {"alpha": "cv", "penalty": "ridge", "cv_states": "shape"}
    one, test = episodes[:1], episodes[1:]
    best = min(
        LinearEDMDc(theta, **shared).fit(one).score(test, "shape").median for theta in (plain, physics.dictionary())
    )
    split = PIEDMDc(physics.dictionary(), split="hold", options=options, alphas=np.logspace(-8, 3, 6), **shared).fit(
        one, d2
    )
    errors = split.score(test, "shape")
    assert errors.diverged_fraction == 0.0
    assert errors.median < 0.7 * best


def test_tangent_samples_stay_close_to_rest_and_repeat(physics: ArmPhysics, options: dict[str, Any]) -> None:
    tangent = options["tangent"]
    again = physics.tangent_samples()
    np.testing.assert_array_equal(tangent.x, again.x)
    assert np.abs(physics.tangent_samples(seed=1).x - again.x).max() > 0.0
    positions = [i for i, name in enumerate(physics.arm.scene.field_map(STATIONS).names) if name.startswith("p_")]
    assert np.ptp(tangent.x[:, positions], axis=0).max() < 1e-4
    np.testing.assert_array_equal(tangent.u, np.tile(physics.arm.rest_inputs, (len(tangent), 1)))


def test_the_order_of_the_measured_fields_does_not_matter(
    physics: ArmPhysics, options: dict[str, Any], episodes: Episodes, d2: PhaseSamples
) -> None:
    order = np.random.default_rng(0).permutation(episodes.n_states)
    turned = Episodes(
        [x[:, order] for x in episodes.xs],
        [u[:, ::-1] for u in episodes.us],
        episodes.dt,
        state_names=[(episodes.state_names or ())[i] for i in order],
        input_names=(episodes.input_names or ())[::-1],
        quantities=[(episodes.quantities or ())[i] for i in order],
    )
    models = [
        PIEDMDc(physics.dictionary(), alpha=1e-4, penalty="ridge", split="hold", options=options).fit(d1, d2)
        for d1 in (episodes, turned)
    ]
    np.testing.assert_allclose(models[1].lifted.A, models[0].lifted.A, rtol=0, atol=1e-9 * np.abs(models[0].K_).max())
    assert models[1].score(episodes).median == pytest.approx(models[0].score(turned).median, rel=1e-6)


def test_deviations_are_those_of_the_arm_that_moved(physics: ArmPhysics, episodes: Episodes) -> None:
    scene = physics.arm.scene
    stiffer = replace(physics.arm, scene=scene.replace(rod.QuadraticDrag(2e-4)))
    with pytest.raises(ValueError, match="made by another arm"):
        deviations_from_equilibrium(stiffer, episodes)
