"""Steel arms with free shear and stretch run with default settings, damped in full, in bending only, or not at all."""

import numpy as np
import pytest

from pisplit.models import rod
from pisplit.models.arm.tendon_arm import TendonArm

ARM = TendonArm.paper(nodes=4).scene
BENDING = rod.KelvinVoigt(bending=5e-4, torsion=5e-4)


def cosserat(*damping: rod.KelvinVoigt) -> rod.Scene:
    body = rod.Rod(ARM.rod.length, ARM.rod.section, ARM.rod.material, "cosserat")
    return rod.Scene(body, *ARM.without(rod.KelvinVoigt).terms, *damping, nodes=4)


def commands(steps: int) -> np.ndarray:
    t = 0.03 * np.arange(1, steps + 1)[:, None]
    return 1e-3 + 8e-3 * np.sin(3.0 * t) * np.cos(np.array([0.0, 2.1, 4.2]) + 2.0 * t)


def tips(scene: rod.Scene, states: np.ndarray) -> np.ndarray:
    return scene.fields(states, [ARM.rod.length])[:, 0, :3]


@pytest.mark.parametrize("stretch", [0.0, 50.0])
def test_damping_of_shear_and_stretch_does_not_matter_to_the_arm(stretch: float) -> None:
    """Defaults against tight tolerances with axial damping, 1e-3 L; axially undamped scenes fall back to order 2."""
    full = rod.KelvinVoigt(bending=5e-4, torsion=5e-4, shear=50.0, stretch=50.0)
    fine = cosserat(full).simulator(0.03, rtol=1e-6).run(commands(6), check=False)
    scene = cosserat(rod.KelvinVoigt(bending=5e-4, torsion=5e-4, shear=stretch, stretch=stretch))
    found = scene.simulator(0.03).run(commands(6), check=False)
    assert fine.success and found.success
    assert np.abs(tips(scene, found.x) - tips(scene, fine.x)).max() <= 1e-3 * ARM.rod.length


def test_an_undamped_cosserat_arm_finishes() -> None:
    trajectory = cosserat().simulator(0.03, rtol=1e-3).run(commands(3), check=False)
    assert trajectory.success and np.isfinite(trajectory.x).all()


def test_gauss_steps_move_it_too() -> None:
    """Steps of 5 ms: axial waves of 5 microseconds a period are passed over, 1e-3 L."""
    scene = cosserat(BENDING)
    found = scene.stepper(0.03, step=5e-3).run(commands(6), check=False)
    idas = scene.simulator(0.03).run(commands(6), check=False)
    assert found.success and found.stats["halvings"] == 0
    assert np.abs(tips(scene, found.x) - tips(scene, idas.x)).max() <= 1e-3 * ARM.rod.length


@pytest.mark.parametrize("strains", ["cosserat", "extensible"])
@pytest.mark.parametrize("after", [(0.003, 0.001, 0.001), (0.002, 0.002, 0.002)])
def test_a_jump_of_the_servos_moves_the_arm_as_small_fixed_steps_do(strains: str, after: tuple[float, ...]) -> None:
    """Tendons that pull 1 or 2 mm more at once: axial accelerations of 5e10 1/s^2 that last for microseconds."""
    body = rod.Rod(0.7144, rod.Circle(0.675e-3), rod.Elastic(207e9, 207e9 / 2.6, 33249.0), strains=strains)
    pulled = rod.Tendons.parallel(0.01506, (0, 120, 240), drive=rod.Displacement(1e-4))
    damping = rod.KelvinVoigt(bending=5e-4, torsion=5e-4), rod.QuadraticDrag(1e-4)
    scene = rod.Scene(body, rod.Gravity((-9.81, 0, 0)), *damping, pulled, nodes=3)
    rest, commands = scene.statics().solve([0.001] * 3), np.tile(after, (2, 1))
    start = scene.state(rest.strains, np.zeros(scene.n_strains), commands[0])
    exact = scene.stepper(0.03, step=2e-4).run(commands, start, check=False).fields([0.7144])[:, 0, :3]
    found = scene.simulator(0.03).run(commands, start, check=False)
    assert found.success
    assert np.linalg.norm(found.fields([0.7144])[:, 0, :3] - exact, axis=1).max() < 3e-4 * 0.7144
