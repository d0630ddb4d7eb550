"""Exported C computes what the scene computes, with no more than a C compiler; and what the parts of a scene cost."""

import shutil
import subprocess
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pisplit.models import rod
from pisplit.models.rod.output.codegen import board_step

COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
STEEL = rod.Elastic(207e9, 207e9 / 2.6, 8000.0)
GRAVITY, DAMPING = rod.Gravity((-9.81, 0.0, 0.0)), rod.KelvinVoigt(bending=5e-4, torsion=5e-4)
TENDONS = rod.Tendons([[0.015, 0.0], [-0.015, 0.0]], rod.Displacement(1e-4))
PULL = (0.004, -0.004)
DT = 0.03

MAIN = """
#include <stdio.h>
#include "arm.h"

static void print(const double *v, int n) { for (int i = 0; i < n; ++i) printf("%.17g\\n", v[i]); }

int main(void) {
  double x[ARM_N_STATES], next[ARM_N_STATES], left[1], y[48], residual[ARM_N_STRAINS];
  double d[3][ARM_N_STRAINS * ARM_N_STRAINS];
  for (int i = 0; i < ARM_N_STATES; ++i) x[i] = arm_rest[i];
  for (int k = 0; k < 3; ++k) {
    if (arm_step(x, PULL, next, left)) return 1;
    for (int i = 0; i < ARM_N_STATES; ++i) x[i] = next[i];
  }
  if (arm_fields(x, y)) return 1;
  if (arm_residual(x, x + ARM_N_STRAINS, x, PULL_OR_NOTHING residual)) return 1;
  if (arm_jacobian(x, x + ARM_N_STRAINS, x, PULL_OR_NOTHING d[0], d[1], d[2])) return 1;
  print(x, ARM_N_STATES); print(y, 48); print(residual, ARM_N_STRAINS); print(d[0], 3 * ARM_N_STRAINS * ARM_N_STRAINS);
  return 0;
}
"""


def scene(*terms: object, nodes: int = 3) -> rod.Scene:
    return rod.Scene(rod.Rod(0.5, rod.Circle(1e-3), STEEL, "planar"), GRAVITY, DAMPING, *terms, nodes=nodes)


def run_exported(arm: rod.Scene, folder: Path) -> NDArray[np.float64]:
    """What the exported C prints from a program of its own, built as strict C99."""
    assert COMPILER is not None
    exported = arm.codegen(folder / "arm.c", dt=DT, substeps=2, stations=2)
    pull = f"(const double[]){{{PULL[0]!r}, {PULL[1]!r}}}" if arm.n_inputs else ""
    main = MAIN.replace("PULL_OR_NOTHING", f"{pull}," if pull else "").replace("PULL,", f"{pull}," if pull else "")
    (folder / "main.c").write_text(main)
    assert exported.source.read_text().count("#include <") == 1
    command = [COMPILER, "-std=c99", "-pedantic", "-Werror", "-Wno-unused", "-O1"]
    files = [str(folder / "main.c"), str(exported.source), "-o", str(folder / "arm")]
    built = subprocess.run([*command, *files, "-lm"], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    printed = subprocess.run([str(folder / "arm")], capture_output=True, text=True, check=True, timeout=20)
    return np.array(printed.stdout.split(), dtype=float)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler on the PATH: nothing to compile the export with")
@pytest.mark.parametrize("terms", [(), (TENDONS,)])
def test_exported_c_computes_what_the_scene_computes(terms: tuple[object, ...], tmp_path: Path) -> None:
    arm = scene(*terms)
    step, u, n = board_step(arm, DT, 2), np.array(PULL[: arm.n_inputs]), arm.n_strains
    x = arm.statics().solve().state
    for _ in range(3):
        x = np.asarray(step(x, u)[0]).ravel()
    point = (x[:n], x[n : 2 * n], x[:n], u)
    blocks = arm.motion_residual.jacobian()(*point, np.zeros(n))[:3]
    wanted = [x, arm.fields(x, 2).ravel(), np.asarray(arm.motion_residual(*point)).ravel()]
    wanted += [np.asarray(block.full()).ravel(order="F") for block in blocks]
    assert np.allclose(run_exported(arm, tmp_path), np.concatenate(wanted), rtol=1e-10, atol=1e-12)


def test_the_step_of_the_board_converges_to_the_motion_with_order_two() -> None:
    arm = scene(TENDONS)
    rest = arm.statics().solve().state
    exact = arm.simulator(DT, rtol=1e-9).run([PULL], rest, check=False).x[-1]
    n = arm.n_strains
    errors = [np.abs(np.asarray(board_step(arm, DT, k)(rest, PULL)[0]).ravel() - exact)[:n].max() for k in (8, 16, 32)]
    assert errors[0] / errors[1] > 3.0 and errors[1] / errors[2] > 3.0
    assert errors[-1] < 1e-3 * np.abs(exact[:n]).max()


def test_a_scene_at_rest_stays_there() -> None:
    arm = scene(TENDONS)
    rest = arm.statics().solve(PULL).state
    after, left = board_step(arm, DT, 4)(rest, PULL)
    assert np.abs(np.asarray(after).ravel() - rest).max() < 1e-6 and float(left) < 1e-6


def test_the_header_tells_sizes_units_and_the_scene(tmp_path: Path) -> None:
    arm = scene(TENDONS)
    header = arm.codegen(tmp_path / "arm.c", dt=DT, stations=2).header.read_text()
    for line in str(arm).splitlines():
        assert line in header
    assert f"#define ARM_N_STATES {arm.n_states}" in header and "#define ARM_DT 0.03" in header
    assert "tendons[0], tendons[1]" in header and "1/m" in header and "EI/L" in header


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"path": "arm.cpp"}, "ending .c"),
        ({"path": "my arm.c"}, "C identifier"),
        ({"dt": 0.0}, "dt"),
        ({"substeps": 0}, "substeps"),
    ],
)
def test_bad_arguments_are_one_line(change: dict[str, object], told: str, tmp_path: Path) -> None:
    given: dict[str, object] = {"path": "arm.c", "dt": DT, "substeps": 2} | change
    with pytest.raises(ValueError, match=told) as error:
        scene(nodes=2).codegen(tmp_path / str(given.pop("path")), **given)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_cost_of_a_term_is_what_its_absence_saves() -> None:
    arm = scene(TENDONS)
    found = arm.cost()
    assert found.total.residual == arm.motion_residual.n_instructions()
    assert found.total.jacobian == arm.motion_residual.jacobian().n_instructions()
    assert [name for name, _ in found.terms] == [t.describe(arm.rod) for t in arm.terms]
    for (_, saved), term in zip(found.terms, arm.terms, strict=True):
        assert saved.residual == found.total.residual - (arm - term).motion_residual.n_instructions() > 0
    damping = found.terms[1][1]
    assert damping.static_residual == damping.static_jacobian == 0
    assert found.rod.residual < found.total.residual
    last = str(found).splitlines()[-1].split()[-4:]
    assert [int(v) for v in last] == list(astuple(found.total))
