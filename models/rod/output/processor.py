"""The kind of processor that machine code is made for."""

from __future__ import annotations

import platform
import subprocess
from functools import cache
from pathlib import Path


@cache
def processor() -> str:
    """Machine and instructions of this processor; the machine alone where nobody tells which instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    known = next((line for line in lines if line.split(":")[0].strip() in ("flags", "Features")), "")
    return f"{platform.machine()} {known}".strip()


@cache
def native(compiler: str) -> tuple[str, ...]:
    """What tells the ``compiler`` to use all instructions of this processor; nothing where it does not know how."""
    if " " not in processor():  # the instructions are unknown: so is where else this machine code would run
        return ()
    flag = "-march=native"
    try:
        asked = [compiler, flag, "-x", "c", "-E", "-o", "-", "-"]
        done = subprocess.run(asked, input="", capture_output=True, text=True, timeout=60.0, check=False)
    except (OSError, subprocess.SubprocessError):
        return ()
    return () if done.returncode else (flag,)
