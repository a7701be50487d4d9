"""Replay, referee, experiments, tables, figures, report and the command line."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[1]


def _require_ours() -> None:
    """Nothing works with somebody else's `data`: `python -m` looks into the working directory first."""
    for package in ("association", "data", "ekf", "graph"):
        spec = find_spec(package)
        places = [] if spec is None else [*(spec.submodule_search_locations or ()), spec.origin or ""]
        if not any(p and Path(p).resolve() == (ROOT / package).resolve() for p in places):
            where = next((p for p in reversed(places) if p), "nowhere")
            said = (
                f"the package {package!r} found first is {where}, not that of slamref in {ROOT}; start from another "
                "folder, or use the command `slamref`, which does not look into the working directory"
            )
            if sys.argv[:1] == ["-m"]:  # as a command: Python is still looking for the module
                sys.stderr.write(f"slamref: {said}\n")
                raise SystemExit(2)
            raise ImportError(said)


_require_ours()
