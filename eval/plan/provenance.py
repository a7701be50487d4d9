"""Where a result came from: the command, the versions, and a digest of everything the estimators were given."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import version

import numpy as np

from data.log import Log
from eval.plan.options import Options

PACKAGES = ("gtsam", "numpy", "scipy", "numba", "pandas", "matplotlib", "opencv-python-headless")


def command_of(options: Options) -> str:
    """The command that makes the same numbers again (output folder and number of processes do not matter to them)."""
    parts = ["python -m eval.run_all"]
    default = Options()
    for name in ("log", "scenario", "data"):
        parts += [f"--{name} {v}" for v in getattr(options, name)]
    for name in ("task", "estimator", "association"):
        if getattr(options, name) != getattr(default, name) and getattr(options, name):
            parts.append(f"--{name} {','.join(getattr(options, name))}")
    parts += [f"--config {v.name}" for v in options.variants]
    for name in ("gate", "new_gate", "gate_known", "forget_after", "deactivate_after", "lag"):
        if getattr(options, name) != getattr(default, name):
            value = getattr(options, name)
            parts.append(f"--{name.replace('_', '-')} {'none' if value is None else format(value, 'g')}")
    parts += [f"--{name.replace('_', '-')}" for name in ("in_view", "maintain", "full") if getattr(options, name)]
    if options.runs is not None:
        parts.append(f"--runs {options.runs}")
    if options.seed:
        parts.append(f"--seed {options.seed}")
    parts += ["--quick"] * options.quick
    return " ".join(parts)


def provenance(options: Options, logs: Iterable[Log], arguments: Sequence[str]) -> str:
    """The text of provenance.json."""
    content = {
        "command": ["python", "-m", "eval.run_all", *arguments],
        "versions": {
            "slamref": version("slamref"), "python": platform.python_version(), **{p: version(p) for p in PACKAGES},
        },
        "platform": f"{sys.platform} {platform.machine()}",
        "seed": options.seed,
        "inputs": {log.name: {**_plain(log), "sha256": input_digest(log)} for log in logs},
    }  # fmt: skip
    return json.dumps(content, indent=2, sort_keys=True) + "\n"


def _plain(log: Log) -> dict[str, object]:
    return {
        str(k): v if isinstance(v, (str, int, float, bool, list)) or v is None else str(v)
        for k, v in log.source.items()
    }


def input_digest(log: Log) -> str:
    """sha256 over everything the estimators and the referee were given, whatever file it came from."""
    digest = hashlib.sha256()
    r, t = log.recorded, log.truth
    arrays: list[np.ndarray] = [r.prior.mean, r.prior.covariance, r.time, r.increments.mean, r.increments.covariance]
    arrays += [r.observations.frame, r.observations.z, r.observations.R]
    for extra in (log.label, t.pose, t.landmark_of):
        if extra is not None:
            arrays.append(extra)
    for landmarks in (r.map, t.landmarks):
        if landmarks is not None:
            arrays += [landmarks.id, landmarks.xy]
    for array in arrays:
        digest.update(str(array.shape).encode())
        digest.update(array.tobytes())
    digest.update(repr(r.sensor).encode())
    return digest.hexdigest()
