"""Figures on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from pisplit.files import replacing


def save_figure(figure: Any, path: Path, dpi: float | None = None) -> None:
    """Write a figure whole or not at all, then close it; ``dpi`` in dots per inch (default: of the rcParams)."""
    with replacing(path, make_folders=True) as part:
        figure.savefig(part, dpi=dpi)
    plt.close(figure)
