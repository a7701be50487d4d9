"""Kernels compiled by numba, kept on disk by what they were compiled from, so that an old one never runs.

numba looks at the file of a kernel only: a caller does not notice that a kernel or a constant of another file changed.
So a module's kernels have a folder named by a digest: of the module and all modules of ours that it imports, of the
versions of Python, numba, llvmlite and NumPy, and of the processor. numba is loaded with the first kernel, not before.
"""

import hashlib
import os
import platform
import re
import shutil
import time
from collections.abc import Callable, Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from data.digest import ROOT

PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")
IMPORT = re.compile(r"^(?:from|import) ([\w.]+)(?: import (?:\(([^)]*)|(.*)))?", re.MULTILINE)
KEPT, UNUSED = 3, 86_400.0  # folders of a module that stay in any case; s, after which others are removed
Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def njit(function: Kernel) -> Kernel:
    """The function, compiled at its first call with arguments of these types, or loaded from its folder."""
    os.environ.setdefault("NUMBA_OPT", "2")  # is read by the import. 3 takes a sixth longer, for kernels just as fast
    import numba
    from numba.core import config

    settings = vars(config)
    before = settings["CACHE_DIR"]
    settings["CACHE_DIR"] = str(folder_of(Path(function.__code__.co_filename)))  # is read while decorating
    try:
        # without an entry for C, which nobody calls; numba's types do not know the option
        return numba.njit(cache=True, no_cfunc_wrapper=True)(function)  # type: ignore[call-overload,no-any-return]
    finally:
        settings["CACHE_DIR"] = before


@cache
def base() -> Path:
    """The folder of all folders: beside this module, or the user's where that is read-only, or in `NUMBA_CACHE_DIR`."""
    if own := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(own) / "slamref"
    beside = Path(__file__).parent / "__pycache__"
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return beside / "kernels"
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(user).expanduser() / "slamref"


@cache
def folder_of(module: Path) -> Path:
    """The folder of a module's kernels; older ones, of other digests, are removed."""
    name = f"{module.parent.name}.{module.stem}"
    folder = base() / f"{name}-{digest_of([module])}"
    if folder.is_dir() and os.access(folder, os.W_OK):
        os.utime(folder)
    used = {old: old.stat().st_mtime for old in base().glob(f"{name}-*") if old != folder}
    for old in sorted(used, key=used.__getitem__)[: 1 - KEPT]:
        if used[old] < time.time() - UNUSED:
            shutil.rmtree(old, ignore_errors=True)
    return folder


@cache
def mark() -> Path:
    """The file that says that all kernels are compiled."""
    files = (f for package in PACKAGES for f in (ROOT / package).rglob("*.py"))
    return base() / f"all.{digest_of(f for f in files if b'njit' in f.read_bytes())}"


def digest_of(modules: Iterable[Path]) -> str:
    """Digest of modules and all modules of ours that they import, directly or not, and of what compiles them."""
    import llvmlite.binding  # type: ignore[import-untyped]

    found, waiting = set[Path](), list(modules)
    while waiting:
        if (module := waiting.pop()) not in found:
            found.add(module)
            waiting += _source(module)[1]
    versions = [platform.python_version(), *map(version, ("numba", "llvmlite", "numpy"))]
    digest = hashlib.sha256(" ".join([*versions, llvmlite.binding.get_host_cpu_name()]).encode())
    for module in sorted(found):
        digest.update(_source(module)[0])
    return digest.hexdigest()[:16]


@cache
def _source(module: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Content of a module, and the modules of ours that it imports when it is loaded."""
    content, names = module.read_bytes(), list[str]()
    for package, *inside in IMPORT.findall(content.decode()):
        if package.partition(".")[0] in PACKAGES:
            names += [package, *(f"{package}.{word}" for word in re.findall(r"\w+", " ".join(inside)))]
    places = [ROOT.joinpath(*name.split(".")) for name in names]
    return content, tuple(f for p in places for f in (p.with_suffix(".py"), p / "__init__.py") if f.is_file())
