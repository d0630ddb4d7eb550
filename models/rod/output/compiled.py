"""Machine code of a scene: C of its functions, built by the system compiler and kept in a user cache folder."""

from __future__ import annotations

import copy
import hashlib
import logging
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from pathlib import Path

import casadi as ca
from numpy.typing import ArrayLike

from pisplit.files import replacing
from pisplit.models.rod.equations.equations_of_motion import equations_of_motion
from pisplit.models.rod.equations.residuals import THROUGH_JACOBIAN
from pisplit.models.rod.output.processor import native, processor
from pisplit.models.rod.scene import Scene

log = logging.getLogger(__name__)

#: ``-O1`` runs as fast as ``-O2`` on these straight-line functions and compiles 2 to 14 times faster. With the
#: instructions of this processor, where it is known, Jacobians take a quarter less time. Nothing is rounded less often
#: than by the virtual machine (no fused multiply-add): numbers are the same to the last bit.
FLAGS = ("-O1", "-ffp-contract=off", "-fPIC", "-shared")
#: Seconds after which a compiler counts as failed; the largest residuals here take half a minute.
COMPILER_PATIENCE = 600.0
_DIGEST = hashlib.sha256().digest_size


class NoMachineCode(RuntimeError):
    """There is no compiler, it failed, or its product cannot be kept or loaded."""


class CompiledScene(Scene):
    """A scene whose residuals, Jacobians and fields are machine code: see ``Scene.compile``.

    Whatever a solver asks for later (fields at other stations) is built when it is first used. Where building fails the
    virtual machine evaluates the scene, with the same results. ``scene + term`` and its relatives give interpreted
    scenes: compile them again.
    """

    @classmethod
    def of(cls, scene: Scene) -> CompiledScene:
        """The compiled twin of a scene; nothing is built yet."""
        made = cls.__new__(cls)
        made.__dict__.update(copy.copy(scene).__dict__)  # a copy holds no graphs of the original
        return made

    def __reduce__(self) -> tuple[object, ...]:
        return _recompile, super().__reduce__()

    @cached_property
    def motion_residual(self) -> ca.Function:
        """``(xi, xi_t, xi_tt, u) -> residual``: what it shares is found before it becomes machine code."""
        return self.shared_motion_residual

    def variational(self) -> CompiledScene:
        """The twin that keeps energy (see ``Scene.variational``), as machine code too."""
        if "_variational_machine_code" not in self.__dict__:
            self.__dict__["_variational_machine_code"] = CompiledScene.of(super().variational())
        found: CompiledScene = self.__dict__["_variational_machine_code"]
        return found

    @property
    def machine_code(self) -> bool:
        """Whether every function asked for so far runs as machine code."""
        built = self._native.values()
        return bool(built) and all(made is not given for given, made in built)

    def to_compile(self, stations: int | ArrayLike) -> list[tuple[CompiledScene, list[ca.Function]]]:
        """What ``Scene.compile`` builds with fields at ``stations``: functions of this scene, and of what moves it."""
        moving = self if equations_of_motion(self) is self else self.variational()
        found = []
        for scene in (self,) if moving is self else (self, moving):
            functions = [scene.statics().residual_function, scene.field_map(stations).function]
            found.append((scene, [*functions, scene.motion_residual] if scene is moving else functions))
        return found

    def native(self, function: ca.Function) -> ca.Function:
        """``function`` as machine code, or itself where there is none to be had."""
        return self.build([function])[0]

    def build(self, functions: Sequence[ca.Function]) -> list[ca.Function]:
        """Machine code of several functions, built side by side."""
        known = self._native
        missing = [f for f in functions if f.__hash__() not in known]
        for given, made in zip(missing, compiled_functions(missing), strict=True):
            known[given.__hash__()] = (given, made)
        return [known[f.__hash__()][1] for f in functions]

    @property
    def _native(self) -> dict[int, tuple[ca.Function, ca.Function]]:
        """Function and its machine code by the identity of the function, which stays alive with it."""
        found: dict[int, tuple[ca.Function, ca.Function]] = self.__dict__.setdefault("_machine_code", {})
        return found


def _recompile(rebuild: Callable[..., Scene], arguments: tuple[object, ...]) -> CompiledScene:
    return CompiledScene.of(rebuild(*arguments))


def compiled_functions(functions: Sequence[ca.Function]) -> list[ca.Function]:
    """Each function as machine code, residuals (functions in SX) with their Jacobian.

    Those that cannot be built come back as they are; one warning says why.
    """
    if not functions:
        return []
    try:
        found, folder = compiler(), _cache_folder()
        sources = [_source(f) for f in functions]
        with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
            libraries = list(pool.map(lambda source: _library(source, found, folder), sources))
        return [_load(f, library) for f, library in zip(functions, libraries, strict=True)]
    except NoMachineCode as reason:
        log.warning("%s; the CasADi virtual machine evaluates the scene instead, five to ten times slower", reason)
        return list(functions)


def _source(function: ca.Function) -> str:
    """C of a function; residuals (in SX) come with their Jacobian, which solvers look up as ``jac_NAME``."""
    generator = ca.CodeGenerator("machine_code")
    try:
        generator.add(function)
        if function.is_a("SXFunction"):
            generator.add(function.jacobian())
        return str(generator.dump())
    except RuntimeError as error:
        raise NoMachineCode(f"{function.name()} has no C: {str(error).strip().splitlines()[-1]}") from error


def compiler() -> str:
    """Path of the C compiler: ``$CC``, cc, gcc or clang. Raises NoMachineCode where there is none."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        found = shutil.which(name) if name else None
        if found:
            return found
    raise NoMachineCode("no C compiler (cc, gcc or clang) on the PATH")


def _cache_folder() -> Path:
    """``$XDG_CACHE_HOME/pisplit`` or ``~/.cache/pisplit``; what is in it may be deleted at any time."""
    try:
        base = os.environ.get("XDG_CACHE_HOME", "")
        folder = (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "pisplit"
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError) as error:
        raise NoMachineCode(f"no folder for machine code: {error}") from error
    return folder


def kept(functions: Sequence[ca.Function]) -> bool:
    """Whether the machine code of all ``functions`` is in the cache.

    Raises NoMachineCode without a compiler, or a folder for what it makes.
    """
    flags, folder = (*FLAGS, *native(compiler())), _cache_folder()
    return all(_intact(_place(_digest(f), flags, folder)) for f in functions)


@lru_cache(maxsize=32)
def _digest(function: ca.Function) -> str:
    """That of the C of a function, which is asked for again and again."""
    return hashlib.sha256(_source(function).encode()).hexdigest()


def _place(digest: str, flags: Sequence[str], folder: Path) -> Path:
    """Where the library of a source with this ``digest`` is, or would be."""
    key = "\0".join([digest, *flags, processor()])
    return folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.so"


def _library(source: str, compiler: str, folder: Path) -> Path:
    """Shared library of a source, from the cache where it is there and intact."""
    flags = (*FLAGS, *native(compiler))
    path = _place(hashlib.sha256(source.encode()).hexdigest(), flags, folder)
    if not _intact(path):
        _build(source, [compiler, *flags], path)
    return path


def _intact(path: Path) -> bool:
    """Whether a library ends with its seal: loading a truncated one would kill the process."""
    try:
        content = path.read_bytes()
    except OSError:
        return False
    return _seal(content[:-_DIGEST], path) == content[-_DIGEST:]


def _seal(content: bytes, path: Path) -> bytes:
    """Digest of a library and of its name, which is the digest of its source: that of another scene does not pass."""
    return hashlib.sha256(path.name.encode() + content).digest()


def _build(source: str, compiler: Sequence[str], path: Path) -> None:
    """Compile into a folder of this process and move the whole library into place."""
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix="build-") as name:
            code, library = Path(name) / "scene.c", Path(name) / "scene.so"
            code.write_text(source)
            command = [*compiler, str(code), "-o", str(library), "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=COMPILER_PATIENCE, check=False)
            if done.returncode:
                reason = (done.stderr.strip().splitlines() or ["no message"])[0]
                raise NoMachineCode(f"{compiler[0]} failed with status {done.returncode}: {reason}")
            content = library.read_bytes()
        with replacing(path) as part:
            part.write_bytes(content + _seal(content, path))
    except subprocess.TimeoutExpired as error:
        raise NoMachineCode(f"{compiler[0]} took longer than {COMPILER_PATIENCE:g} s") from error
    except (OSError, ValueError) as error:
        raise NoMachineCode(f"machine code could not be written: {error}") from error


def _load(function: ca.Function, path: Path) -> ca.Function:
    options = THROUGH_JACOBIAN if function.is_a("SXFunction") else {"never_inline": True}
    try:
        return ca.external(function.name(), str(path), options)
    except RuntimeError as error:
        raise NoMachineCode(f"machine code does not load: {str(error).strip().splitlines()[-1]}") from error
