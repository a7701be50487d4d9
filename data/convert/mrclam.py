"""One robot of a UTIAS MRCLAM dataset as an open log, with flags for calibration and noise."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data.command import stretch
from data.convert import TEXTS, said_of
from data.errors import UsageError
from data.worlds.registry import number

if TYPE_CHECKING:
    from data.command import Add
    from data.log import Log
    from data.motion.velocity import VelocityModel

KINDS = ("mrclam",)
CALIBRATION: dict[str, tuple[str, str]] = TEXTS["mrclam"]["calibration"]
"""Fields of `data.formats.mrclam.Calibration` with a flag: metavar (none for a switch) and help."""


def add_parsers(add: Add, *, parameters: bool) -> None:
    """The parser of `mrclam`; `parameters` is unused."""
    sub = add("mrclam", **said_of("mrclam"))
    sub.add_argument("source", metavar="SOURCE", type=Path, help="folder with the .dat files, or the published zip")
    sub.add_argument("out", metavar="OUT", type=Path, help="log folder to write")
    sub.add_argument("--robot", type=int, metavar="N", required=True, help="robot, 1 to 5")
    sub.add_argument("--start", type=number, metavar="S", help="the log starts no earlier")
    sub.add_argument("--stop", type=number, metavar="S", help="the log ends no later")
    says = TEXTS["mrclam"]["says"]
    sub.add_argument("--landmarks", type=Path, metavar="FILE", help=says["landmarks"])
    every: dict[str, Any] = {"action": "append", "default": [], "metavar": "FROM:TO"}
    sub.add_argument("--exclude-truth", type=stretch, help=says["exclude-truth"], **every)
    sub.add_argument("--grid", type=number, metavar="S", help=says["grid"])
    two: dict[str, Any] = {"type": number, "nargs": 2, "metavar": ("M", "RAD")}
    sub.add_argument("--prior-sigma", default=(0.05, 0.05), help=says["prior-sigma"], **two)
    text = "defaults: the frozen numbers of data/formats/mrclam.py"
    group = sub.add_argument_group("calibration and noise", text)
    group.add_argument("--uncalibrated", action="store_true", help=says["uncalibrated"])
    for name, (unit, text) in CALIBRATION.items():
        flag = f"--{name.replace('_', '-')}"
        if unit:
            group.add_argument(flag, type=number, metavar=unit, help=text)
        else:
            group.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
    group.add_argument("--sigma", help=says["sigma"], **two)
    group.add_argument("--motion-model", choices=("unicycle", "half_angle"), help=says["motion-model"])
    noises = ("velocity", "displacement", "density", "textbook")
    group.add_argument("--motion-noise", choices=noises, help=says["motion-noise"])
    group.add_argument("--motion-sigma", help=says["motion-sigma"], **(two | {"metavar": ("V", "OMEGA")}))
    group.add_argument("--motion-alphas", type=number, nargs="+", metavar="A", help=says["motion-alphas"])


def convert(args: argparse.Namespace) -> Log:
    """The log of the robot asked for; corrected landmarks beside the dataset are taken unless others are given."""
    from data.formats.mrclam import FROZEN, Calibration, Treatment, corrected_landmarks, load_mrclam

    changes = {name: value for name in CALIBRATION if (value := getattr(args, name)) is not None}
    both = [name for name in changes if name.startswith("sigma_")]
    if args.sigma is not None and both:
        raise UsageError(f"--sigma and --{both[0].replace('_', '-')} contradict each other; give one of them")
    calibration = replace(Calibration() if args.uncalibrated else FROZEN, **changes)
    if args.sigma is not None:
        calibration = calibration.with_sigma(*args.sigma)
    calibration = replace(calibration, motion=_motion(args, calibration.motion))
    found = corrected_landmarks(args.source) if args.landmarks is None else None
    window = (args.start, args.stop, args.landmarks or found, args.exclude_truth)
    log = load_mrclam(args.source, args.robot, Treatment(*window, args.grid, calibration, tuple(args.prior_sigma)))
    if found is None:
        return log
    said = f"Landmarks are read from {found.name} beside the dataset; --landmarks names another file."
    return replace(log, notes=(*log.notes, said))


def _motion(args: argparse.Namespace, default: VelocityModel) -> VelocityModel:
    """The motion model with the flags' changes; a new noise convention needs its own numbers."""
    from data.motion.velocity import WITH_ALPHAS, VelocityModel, VelocityNoise

    kind = args.motion_noise or default.noise.kind
    if args.motion_noise is None and args.motion_alphas is not None:
        kind = "displacement"
    wanted, other = ("motion_alphas", "motion_sigma") if kind in WITH_ALPHAS else ("motion_sigma", "motion_alphas")
    numbers = getattr(args, wanted)
    flag = f"--{wanted.replace('_', '-')}"
    if getattr(args, other) is not None:
        raise UsageError(f"--{other.replace('_', '-')} does not go with {kind} noise, which takes {flag}")
    noise = default.noise
    if numbers is not None:
        if not all(0.0 <= n < math.inf for n in numbers):
            raise UsageError(f"{flag} {' '.join(f'{n:g}' for n in numbers)}: numbers from 0 up are needed")
        if kind in WITH_ALPHAS and len(numbers) not in WITH_ALPHAS[kind]:
            wanted_count = " or ".join(str(n) for n in WITH_ALPHAS[kind])
            raise UsageError(f"--motion-alphas: {kind} noise takes {wanted_count} numbers, not {len(numbers)}")
        key = "alphas" if kind in WITH_ALPHAS else "sigma"
        noise = VelocityNoise(kind, **{key: tuple(numbers)})
    elif kind != noise.kind:
        raise UsageError(f"--motion-noise {kind} needs {flag}")
    return VelocityModel(noise, args.motion_model or default.model)
