"""Exported models predict what the model predicts."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import dlsim

from pisplit import Dictionary, Episodes, LiftedModel, LinearEDMDc
from pisplit import observables as ob
from pisplit.lifted.formats import to_c_header, to_control, to_numpy, to_state_space
from pisplit.models import systems


@pytest.fixture(scope="module")
def fitted() -> tuple[LiftedModel, Episodes]:
    rng = np.random.default_rng(0)
    u = rng.normal(size=(200, 1))
    data = Episodes([systems.duffing().simulate([1.2, 0.0], u, 0.1, substeps=4)], [u], 0.1, state_names=("x", "v"))
    theta = Dictionary(
        ob.Constant(),
        ob.Identity(),
        ob.Delays(states=2, inputs=1),
        ob.Expression(lambda x, u: x[0] ** 3, name="x^3"),
        n_states=2,
        n_inputs=1,
    )
    return LinearEDMDc(theta, alpha=1e-8).fit(data).lifted, data


def test_scipy_simulates_the_same_motion(fitted: tuple[LiftedModel, Episodes]) -> None:
    model, data = fitted
    start = data.start(0, model.n_delays)
    z0, u = model.lift(start.x_history, start.u_history), start.inputs[:30]
    inputs = model.features(u)
    system = to_state_space(model)
    if system.inputs > model.n_features:
        inputs = np.column_stack([inputs, np.ones(len(u))])
    _, y, _ = dlsim(system, inputs, x0=z0)
    np.testing.assert_allclose(y, model.rollout(z0, u).x[:-1], rtol=1e-9, atol=1e-12)


def test_an_affine_term_becomes_an_input_of_one(fitted: tuple[LiftedModel, Episodes]) -> None:
    model = replace(fitted[0], c=np.ones(fitted[0].n_lifted), d=np.array([1.0, 2.0]))
    system = to_state_space(model)
    assert system.inputs == model.n_features + 1
    np.testing.assert_array_equal(system.D[:, -1], [1.0, 2.0])


def test_arrays_are_copies(fitted: tuple[LiftedModel, Episodes]) -> None:
    model, _ = fitted
    found = to_numpy(model)
    np.testing.assert_array_equal(found["A"], model.A)
    found["A"][:] = 0.0
    assert model.A.any() and found["state_names"] == ["x", "v"] and found["dt"] == model.dt


def test_python_control_gets_names_or_is_asked_for(fitted: tuple[LiftedModel, Episodes]) -> None:
    try:
        import control  # noqa: F401
    except ImportError:
        with pytest.raises(ValueError, match="pip install control"):
            to_control(fitted[0])
        return
    system = to_control(fitted[0])
    assert system.output_labels == ["x", "v"] and system.dt == fitted[0].dt
    np.testing.assert_array_equal(system.A, fitted[0].A)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("bilinear", [False, True])
def test_the_c_header_compiles_and_predicts(
    fitted: tuple[LiftedModel, Episodes], tmp_path: Path, bilinear: bool
) -> None:
    model, data = fitted
    if bilinear:
        model = replace(model, N=1e-3 * np.random.default_rng(1).normal(size=(1, model.n_lifted, model.n_lifted)))
        with pytest.raises(ValueError, match="bilinear"):
            to_state_space(model)
    to_c_header(model, tmp_path / "arm.h", name="arm")
    start = data.start(0, model.n_delays)
    u = start.inputs[:20]
    z0 = model.lift(start.x_history, start.u_history)
    truth = model.rollout(z0, u).x[-1]
    literal = {
        k: ", ".join(repr(float(v)) for v in a.reshape(-1))
        for k, a in {"xs": start.x_history, "us": start.u_history, "u": u}.items()
    }
    program = f"""
#include <stdio.h>
#include "arm.h"
int main(void) {{
  double xs[] = {{{literal["xs"]}}}, us[] = {{{literal["us"]}}}, u[] = {{{literal["u"]}}};
  double z[ARM_LIFTED], next[ARM_LIFTED], x[ARM_STATES];
  arm_lift(xs, us, z);
  for (int k = 0; k < {len(u)}; ++k) {{
    arm_step(z, u + k * ARM_INPUTS, next);
    for (int i = 0; i < ARM_LIFTED; ++i) z[i] = next[i];
  }}
  arm_read(z, x);
  for (int i = 0; i < ARM_STATES; ++i) printf("%.17g\\n", x[i]);
  return 0;
}}
"""
    (tmp_path / "main.c").write_text(program)
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-Wno-unused-function", "main.c", "-lm", "-o", "main"]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    printed = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    np.testing.assert_allclose([float(line) for line in printed.split()], truth, rtol=1e-9)


def test_bad_headers_are_refused(fitted: tuple[LiftedModel, Episodes], tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="C identifier"):
        to_c_header(fitted[0], tmp_path / "a.h", name="my arm")
    with pytest.raises(ValueError, match="does not exist"):
        to_c_header(fitted[0], tmp_path / "none" / "a.h")
    assert not list(tmp_path.iterdir())
