"""The examples of the guide to statics, energy and fixed steps run as printed."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from pisplit.models import rod


def test_the_examples_run_as_printed() -> None:
    text = (Path(__file__).parents[1] / "docs" / "rod.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    setup = blocks[0].split("sim = ")[0]
    names: dict[str, Any] = {"rod": rod}
    exec(setup, names)
    names["U"] = np.linspace([0.010, -0.005, -0.005], [0.004, 0.001, -0.002], 4)
    for part in ("statics.sweep", "arm.stepper"):
        exec(next(block for block in blocks if part in block), names)
    assert names["path"].success.all() and names["pinned"].success
    assert names["found"].success and np.allclose(names["found"].equilibrium.tip[:2], (0.1, -0.05), atol=1e-7)
    assert names["traj"].success and names["low"].frequency.shape == (4,)
    assert np.abs(names["account"].imbalance).max() <= 1e-2 * np.abs(names["account"].work["Tendons"]).max()
    assert names["one"].d_input.shape == (33, 3) and names["lin"].B.shape == (30, 3)
