"""Physics-informed split Koopman identification and control of tendon-driven soft arms."""

from pathlib import Path as _Path

_root = _Path(__file__).resolve().parent.parent
if (_root / "models" / "__init__.py").exists() and (_root / "pyproject.toml").exists():
    __path__.append(str(_root))  # in a source tree `models` and `controllers` stand beside this folder
