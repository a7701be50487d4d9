"""Replay, referee, experiments, tables, figures, report and the command line.

Commands import only their parsers first, so that `--help` answers at once.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]


def _require_ours() -> None:
    """Refuse to start where another package hides one of ours: `python -m` searches the working directory first."""
    for package in ("association", "data", "ekf", "graph", "wings"):
        spec = find_spec(package)
        places = [] if spec is None else [*(spec.submodule_search_locations or ()), spec.origin or ""]
        if not any(p and Path(p).resolve() == (ROOT / package).resolve() for p in places):
            where = next((p for p in reversed(places) if p), "nowhere")
            message = (
                f"the package {package!r} found first is {where}, not that of slamref in {ROOT}; start in another "
                "folder, or use the command `slamref`, which does not search the working directory"
            )
            if sys.argv[:1] == ["-m"]:  # as a command: Python is still looking for the module
                sys.stderr.write(f"slamref: {message}\n")
                raise SystemExit(2)
            raise ImportError(message)


_require_ours()
