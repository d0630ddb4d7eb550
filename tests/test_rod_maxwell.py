"""Maxwell branches against closed forms of the standard linear solid, at rest, in time and over frequency."""

import numpy as np
import pytest
from scipy.linalg import expm

from pisplit.models import rod
from pisplit.models.rod.analysis.cost import instructions

L, E = 0.4, 4e6
SECTION = rod.Circle(4e-3)
EI = E * np.pi * 4e-3**4 / 4.0


def body(density: float = 1100.0, young: float = E, **kwargs: object) -> rod.Rod:
    return rod.Rod(
        length=L, section=SECTION, material=rod.Elastic(young, young / 2.8, density), **{"strains": "planar", **kwargs}
    )


MOMENT = rod.TipWrench(moment=rod.Input("moment", 3))


def turn(u: list[float]) -> np.ndarray:
    """Inputs of a tip moment about y."""
    return np.array([[0.0, m, 0.0] for m in u])


def test_without_a_branch_nothing_of_it_is_left_and_at_rest_nothing_with_it():
    """Instructions, residuals to the last bit and fingerprints; equilibria are those of the relaxed rod."""
    plain = rod.Scene(body(strains="kirchhoff"), rod.Gravity((0, -0.3, 0)), nodes=3)
    branch = rod.Maxwell(0.3, 0.5)
    with_branch = plain + branch
    again = with_branch - branch
    assert instructions(again) == instructions(plain) and again.fingerprint(1) == plain.fingerprint(1)
    none = plain + rod.Maxwell(0.0, 0.5) + rod.Maxwell(0.0, 0.5)
    assert none.n_states == plain.n_states and instructions(none) == instructions(plain)
    x = np.random.default_rng(0).standard_normal((3, 9))
    made, wanted = (np.asarray(s.motion_residual(*x, [])) for s in (again, plain))
    assert np.array_equal(made, wanted)
    assert instructions(with_branch).static_residual == instructions(plain).static_residual
    rest, relaxed = plain.statics().solve(), with_branch.statics().solve()
    assert np.array_equal(rest.strains, relaxed.strains) and not relaxed.state[9:].any()
    assert relaxed.state.shape == (with_branch.n_states,) == (3 * 9,)
    digests = {(plain + rod.Maxwell(f, t)).fingerprint(1) for f, t in ((0.3, 0.5), (0.3, 0.6), (0.4, 0.5))}
    assert len(digests | {plain.fingerprint(1)}) == 4


@pytest.mark.parametrize("branches", [((0.5, 1.0),), ((0.5, 0.2), (2.0, 3.0))])
@pytest.mark.parametrize(("mover", "options"), [("simulator", {"rtol": 1e-6}), ("fast_stepper", {})])
def test_creep_under_a_tip_moment(branches, mover, options):
    """A light rod under a moment that grows over the first interval and stays bends as the linear solid does."""
    terms = [rod.Maxwell(*b) for b in branches]
    tau, dt, steps, moment = 1e-4, 0.1, 12, 2e-3
    scene = rod.Scene(body(density=1e-3), MOMENT, *terms, rod.Retardation(tau), nodes=2)
    run = getattr(scene, mover)(dt, **options).run(turn([moment] * steps), check=False)
    assert run.success
    # kappa + tau kappa_t + sum s = M/EI,  s_t = f kappa_t - s / T: an exponential, M a ramp of rate 1/dt, then none
    f, t = np.array(branches).T
    pull = np.concatenate([[1.0], f]) / tau
    flow = np.zeros((len(f) + 3, len(f) + 3))
    flow[:-2, :-1] = np.outer(pull, [-1.0, *[-1.0] * len(f), 1.0]) - np.diag([0.0, *(1.0 / t), 0.0])[:-1]
    flow[-2, -1] = 1.0 / dt
    state, wanted = np.zeros(len(flow)), []
    for k in range(steps):
        state[-1] = float(k == 0)
        state = expm(flow * dt) @ state
        wanted.append(state[:-2] * moment / EI)
    found = np.hstack([run.x[1:, :1], scene.layout.split(run.x[1:]).overstress[:, ::2]])
    assert np.abs(found - wanted).max() < 3e-4 * moment / EI
    assert np.abs(run.x[:, :2] - run.x[:, :1]).max() < 3e-4 * moment / EI


def test_gauss_steps_keep_their_order():
    """Strains, rates and overstress of a moving rod: fourth order in the step."""
    scene = rod.Scene(body(), MOMENT, rod.Maxwell(0.5, 0.1), rod.Retardation(2e-3), nodes=2)
    start = scene.state([0.5, 0.2], [1.0, -2.0], np.zeros(3), [0.3, -0.1])
    ends = [
        scene.stepper(0.08, step=step, tolerance=1e-12).run(turn([1e-3] * 2), start, check=False).x[-1, :6]
        for step in (0.02, 0.01, 0.0025)
    ]
    coarse, fine = (np.abs(end - ends[2]) for end in ends[:2])
    assert (coarse > 11.0 * fine).all() and fine[4:].max() < 1e-4


def test_stress_relaxes_where_the_tip_is_held():
    """Reaction of a rod bent to a circle: EI (theta/L + sum sigma e^(-t/T)), and its shape does not move."""
    scene = rod.Scene(
        body(), rod.HeldTip(rotation=(0.0, 0.6, 0.0)), rod.Maxwell(0.4, 0.1), rod.Maxwell(0.2, 0.7), nodes=3
    )
    rest = scene.statics().solve()
    start = scene.state(rest.strains, np.zeros(3), [], np.repeat([0.5, 0.2], 3))
    run = scene.simulator(0.05, rtol=1e-7).run(np.empty((10, 0)), start, check=False)
    assert run.success
    wanted = EI * (0.6 / L + 0.5 * np.exp(-run.t / 0.1) + 0.2 * np.exp(-run.t / 0.7))
    assert np.abs(run.reactions()[:, 4] - wanted).max() < 1e-5 * EI
    assert np.abs(run.x[:, :3] - rest.strains).max() < 1e-5


@pytest.mark.parametrize("branches", [((0.3, 1e-3),), ((0.3, 0.1),), ((2.0, 1e3),), ((0.3, 0.02), (0.5, 2.0))])
def test_eigenvalues_are_the_roots_of_the_linear_solid(branches):
    """lambda^2 + w^2 (1 + sum f lambda / (lambda + 1/T)) = 0 for every elastic mode w: loss and relaxation."""
    plain = rod.Scene(body(), nodes=3)
    scene = rod.Scene(body(), *(rod.Maxwell(*b) for b in branches), nodes=3)
    wanted: list[complex] = []
    for w in np.abs(plain.linearise(np.zeros(6)).eigenvalues)[::2]:
        poly = np.array([1.0, 0.0, w**2])
        for _, t in branches:
            poly = np.polymul(poly, [1.0, 1.0 / t])
        for f, t in branches:
            others = np.array([1.0])
            for _, other in branches:
                others = np.polymul(others, [1.0, 1.0 / other]) if other != t else others
            poly = np.polyadd(poly, w**2 * f * np.polymul([1.0, 0.0], others))
        wanted += list(np.roots(poly))
    found = scene.linearise(np.zeros(scene.n_states)).eigenvalues
    assert len(found) == len(wanted) == scene.layout.n_moving
    for value in wanted:
        assert np.abs(found - value).min() < 1e-6 * abs(value)
    modes = scene.modes(np.zeros(scene.n_states))
    assert np.sum(modes.eigenvalues.imag == 0.0) == 3 * len(branches) and (modes.damping > 0.0).all()


def test_energy_is_dissipated_by_the_dashpots_alone():
    """A bent rod that is let go: what it stores falls by what the dashpots take."""
    plane = rod.Scene(body(), rod.Maxwell(0.5, 0.05), nodes=2)
    start = plane.state([1.0, 0.5], np.zeros(2), [], [0.2, -0.3])
    run = plane.stepper(0.02, step=0.005).run(np.empty((30, 0)), start, energy=True, check=False)
    account = run.energy()
    whole = account.stored.total[0]
    assert np.abs(account.imbalance).max() < 1e-4 * whole
    assert (np.diff(account.dissipated) > 0.0).all() and account.dissipated[-1] > 0.2 * whole
    scene = rod.Scene(body(strains="kirchhoff"), rod.Maxwell(0.5, 0.05), nodes=2)
    spring = scene.energies(scene.state(np.zeros(6), np.zeros(6), [], np.full(6, 2.0))[None]).elastic[0]
    gj = E / 2.8 * np.pi * 4e-3**4 / 2.0
    assert spring == pytest.approx((2 * EI + gj) * 4.0 / (2 * 0.5) * L, rel=1e-12)


def test_limits_of_the_relaxation_time():
    """A branch of no time is Kelvin-Voigt damping with fraction x time, one of long time is stiffness."""
    rng = np.random.default_rng(1)
    start, u = 0.5 * rng.standard_normal(2), turn(list(2e-3 * rng.standard_normal(8)))

    def moved(young: float, *terms: object, mover: str = "stepper") -> np.ndarray:
        scene = rod.Scene(body(young=young), MOMENT, *terms, nodes=2)
        x0 = scene.state(start, np.zeros(2), np.zeros(3))
        step = {"step": 0.01} if mover == "stepper" else {}
        run = getattr(scene, mover)(0.02, **step).run(u, x0, check=False)
        assert run.success
        return run.x[:, :2]

    damped = moved(E, rod.Retardation(2e-3))
    assert np.abs(moved(E, rod.Maxwell(2e3, 1e-6)) - damped).max() < 1e-5 * np.abs(damped).max()
    by_idas = moved(E, rod.Maxwell(2e3, 1e-6), mover="simulator")
    assert np.abs(by_idas - damped).max() < 1e-3 * np.abs(damped).max()
    straight = rod.Scene(body(), MOMENT, rod.Maxwell(0.5, 1e6), nodes=2)
    other = rod.Scene(body(young=1.5 * E), MOMENT, nodes=2)
    runs = [s.stepper(0.02, step=0.01).run(u, check=False).x[:, :2] for s in (straight, other)]
    assert np.abs(runs[0] - runs[1]).max() < 1e-4 * np.abs(runs[1]).max()
