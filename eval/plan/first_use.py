"""The first use after an installation: all kernels are compiled, with progress, before anybody waits in silence.

What is compiled is kept by numba beside the modules (or in the user's cache, where those cannot be written to). A mark
beside it says for which versions all is there, so that every later start is spared the look.
"""

from __future__ import annotations

import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def mark() -> Path | None:
    """The file that stands for compiled kernels; None where numba keeps nothing, or compiles nothing."""
    import llvmlite.binding  # type: ignore[import-untyped]
    import numba

    from ekf.kernels import predict

    stats = getattr(predict, "stats", None)  # a plain function where compilation is switched off
    if stats is None or not stats.cache_path:
        return None
    try:
        ours = version("slamref")
    except PackageNotFoundError:  # a checkout that was never installed
        ours = "checkout"
    python = f"{sys.implementation.name}{sys.version_info.major}.{sys.version_info.minor}"
    machine = f"{platform.machine()}-{llvmlite.binding.get_host_cpu_name()}"
    return Path(stats.cache_path) / f".slamref-{ours}-{python}-numba-{numba.__version__}-{machine}"


def compile_if_needed(quiet: bool = False) -> None:
    """On the first use, compile everything and say so on stderr; afterwards nothing at all."""
    place = mark()
    if place is None or (place.exists() and any(place.parent.glob("*.nbi"))):
        return
    if not quiet:
        sys.stderr.write("first use: compiling the numerical kernels, once; this takes a minute or two\n")
    compile_all(quiet)
    if not quiet:
        sys.stderr.write("compiled; later runs start at once\n")


def compile_all(quiet: bool = False) -> None:
    """Compile every kernel, with a bar on a terminal and a line for each part elsewhere, and leave the mark."""
    from tqdm import tqdm

    from eval.plan.warming import PARTS

    with tqdm(desc="compiling", total=len(PARTS), disable=quiet or not sys.stderr.isatty(), leave=False) as bar:
        for done, (what, part) in enumerate(PARTS.items()):
            if bar.disable and not quiet:
                sys.stderr.write(f"compiling, part {done + 1} of {len(PARTS)}: {what}\n")
            bar.set_postfix_str(what)
            part()
            bar.update()
    place = mark()
    if place is not None:
        place.parent.mkdir(parents=True, exist_ok=True)
        place.touch()
