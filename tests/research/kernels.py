"""Processor time of compilation by kernel, exclusive of the kernels that it calls, in a cache of its own.

`python -m tests.research.kernels [-v]`: a row for each kernel: s, how often it was compiled, its signatures. Last,
which of ours were compiled more than once: for read-only arrays, another layout, a literal number.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from typing import Any


def measure() -> tuple[dict[str, float], dict[str, list[Any]], float]:
    """Exclusive processor time [s] and signatures by kernel, and the total, of compiling everything."""
    os.environ["NUMBA_CACHE_DIR"] = tempfile.mkdtemp()
    from numba.core.dispatcher import _FunctionCompiler

    from eval.plan.warming import PARTS

    seconds: dict[str, float] = defaultdict(float)
    signatures: dict[str, list[Any]] = defaultdict(list)
    inner: list[float] = []
    plain = _FunctionCompiler._compile_core

    def timed(self: Any, args: Any, return_type: Any) -> Any:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        inner.append(0.0)
        begin = time.process_time()
        try:
            return plain(self, args, return_type)
        finally:
            took = time.process_time() - begin
            seconds[name] += took - inner.pop()
            signatures[name].append(args)
            if inner:
                inner[-1] += took

    _FunctionCompiler._compile_core = timed  # type: ignore[method-assign]
    begin = time.process_time()
    for part in PARTS.values():
        part()
    return seconds, signatures, time.process_time() - begin


def main(argv: list[str]) -> int:
    """Print the table, the costliest first."""
    seconds, signatures, total = measure()
    for name, took in sorted(seconds.items(), key=lambda item: -item[1]):
        print(f"{took:7.2f} s  {len(signatures[name]):3d} x  {name}")
        for args, times in Counter(map(str, signatures[name])).items():
            if "-v" in argv:
                print(f"{'':18}{times} x {args}")
    twice = [name for name, args in signatures.items() if len(args) > 1 and not name.startswith("numba.")]
    print(f"compiled more than once: {', '.join(twice) or 'none'}")
    print(f"{sum(seconds.values()):7.1f} s of compilation, {total:.1f} s in all, {len(seconds)} kernels")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
