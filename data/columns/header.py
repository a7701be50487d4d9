"""`log.toml` of an open log folder, in format 1 or 2, checked key by key (docs/log-folder.md)."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from data.columns import poses, sensors
from data.columns.scans import KEYS, read_scanner
from data.errors import DataError, unknown
from data.inputs import Prior, Scanner
from data.motion.motion_prior import PRIORS, MotionPrior
from data.motion.velocity import MODELS, NOISES, WITH_ALPHAS, VelocityModel, VelocityNoise
from data.origin import QUANTITIES, Origin, Origins
from data.sensors import RangeBearing
from data.toml_table import Fault, TomlTable, finite, load_toml, not_negative

HEADER = "log.toml"
FORMAT, LATEST = 1, 2  # A log without parts of format 2 is written as format 1
KNOWN = {
    "": (
        *("format", "name", "time_is_index", "covariance_floor", "floored", "labels_are_sensed", "notes"),
        *("prior", "sensor", "scanner", "motion", "source", "origin", *poses.KEYS),
    ),
    "prior": ("mean", "sigma", "covariance"), "sensor": sensors.KEYS,
    "sensor.extrinsic": ("rotation", "translation"), "scanner": KEYS, **poses.KEYS,
    "motion": (
        *("model", "noise", "sigma", "alphas"),
        *("prior", *dict.fromkeys(f.name for kind in PRIORS.values() for f in fields(kind))),
    ),
}  # fmt: skip
"""Keys of each table."""


@dataclass(frozen=True)
class Header:
    """Contents of `log.toml`."""

    name: str
    format: int
    prior: Prior
    sensors: tuple[sensors.Stated, ...]  # with their default noise, none where none is stated
    motion: VelocityModel | None  # how odometry becomes increments
    time_is_index: bool
    covariance_floor: float
    floored: int
    labels_are_sensed: bool
    notes: tuple[str, ...]
    source: Mapping[str, object]
    origins: Origins
    motion_prior: MotionPrior | None = None  # model instead of odometry
    scanner: Scanner | None = None  # of a laser log
    fixes: tuple[poses.Stated, ...] = ()  # their sources
    closures: tuple[poses.Stated, ...] = ()  # their sources


def _prior(table: TomlTable) -> Prior:
    mean = table.numbers("mean", 3, "three numbers x [m], y [m], theta [rad] are", finite)
    if ("sigma" in table) == ("covariance" in table):
        both = "either sigma or covariance is needed, not both"
        raise table.error("sigma", both if "sigma" in table else "missing; sigma or covariance is needed")
    if "sigma" in table:
        return Prior(mean, np.diag(table.numbers("sigma", 3, "three numbers >= 0 [m, m, rad] are", not_negative) ** 2))
    rows, what = table.table["covariance"], "three rows of three numbers are"
    if not isinstance(rows, list) or len(rows) != 3:
        raise table.error("covariance", f"{what} needed")
    each = (TomlTable(table.fault, {"covariance": r}, KNOWN, "prior") for r in rows)
    P = np.stack([row.numbers("covariance", 3, what, finite) for row in each])
    if np.abs(P - P.T).max() > 1e-12 * np.trace(P):
        raise table.error("covariance", "not symmetric")
    P = 0.5 * (P + P.T)
    if (low := np.linalg.eigvalsh(P)[0]) < -1e-12 * np.trace(P):
        raise table.error("covariance", f"not positive semidefinite (smallest eigenvalue {low:.3g})")
    return Prior(mean, P)


def _motion(table: TomlTable) -> VelocityModel:
    model = table.one_of("model", MODELS, "unicycle")
    kind = table.one_of("noise", NOISES)
    wanted, other = ("alphas", "sigma") if kind in WITH_ALPHAS else ("sigma", "alphas")
    if other in table:
        raise table.error(other, f"noise = {kind!r} takes {wanted}, not {other}")
    if kind in WITH_ALPHAS:
        given, counts = table.table.get("alphas"), WITH_ALPHAS[kind]
        count = len(given) if isinstance(given, list) and len(given) in counts else counts[0]
        what = f"{' or '.join({4: 'four', 6: 'six'}[n] for n in counts)} numbers >= 0 are"
        alphas = tuple(table.numbers("alphas", count, what, not_negative))
        return VelocityModel(VelocityNoise(kind, alphas=alphas), model)
    s1, s2 = table.numbers("sigma", 2, "two numbers >= 0 are", not_negative).tolist()
    return VelocityModel(VelocityNoise(kind, sigma=(s1, s2)), model)


def _motion_prior(table: TomlTable) -> MotionPrior:
    kind = PRIORS[table.one_of("prior", PRIORS)]
    wanted = [f.name for f in fields(kind)]
    for key in table.table:
        if key != "prior" and key not in wanted:
            raise table.error(key, f"prior = {table.table['prior']!r} takes {', '.join(wanted)}")
    values = {}
    for key in wanted:
        fine, what = (not_negative, "a number >= 0") if "sigma" in key else (finite, "a finite number")
        values[key] = table.number(key, None, what, fine)
    return kind(**values)


def _origins(table: TomlTable) -> Origins:
    for quantity in table.table:
        if quantity.partition(".")[0] not in QUANTITIES:
            raise table.error(quantity, unknown(quantity, QUANTITIES))
    return {quantity: Origin(table.one_of(quantity, list(Origin))) for quantity in table.table}


def read_header(path: Path) -> Header:
    """Read and check a `log.toml`; DataError names file and key."""
    fault = partial(DataError.at, path)
    missing = "no such file; a log folder needs it, and slamref convert writes one from other files"
    return header_of(load_toml(path, fault, missing), fault)


def header_of(table: dict[str, Any], fault: Fault) -> Header:
    """The header that the tables of a `log.toml` state."""
    number = table.get("format")
    if isinstance(number, bool) or number not in (FORMAT, LATEST):
        what = "no format number" if number is None else f"format = {number!r}: unknown format number"
        raise fault(f"{what}; format = {FORMAT} or {LATEST} is needed")
    for name in poses.KEYS:
        if name in table and number != LATEST:
            raise fault(f"[[{name}]] in format {number}; format = {LATEST} is needed")
    top = TomlTable(fault, table, KNOWN)
    lasers = top.optional_table("scanner")
    scanner = None if lasers is None else read_scanner(lasers)
    found = sensors.stated(top, first_format=number == FORMAT)
    if not found and scanner is not None:
        found = (sensors.Stated(RangeBearing(scanner.max_range), None),)
    elif not found and number == FORMAT:
        top.table_of("sensor")
    motion = top.optional_table("motion")
    notes = table.get("notes", [])
    if not isinstance(notes, list) or not all(isinstance(n, str) for n in notes):
        raise top.error("notes", "a list of sentences is needed")
    source = table.get("source", {})
    if not isinstance(source, dict):
        raise top.error("source", "this must be a table")
    value = top.table.get("name")
    if not isinstance(value, str) or not value.strip():
        raise top.error("name", "a name (text) is needed")
    if value in (".", "..") or any(c in "/\\" or not c.isprintable() for c in value):
        raise top.error("name", "the name becomes a folder name: no slashes, no line ends")
    return Header(
        name=value, format=LATEST if number == LATEST else FORMAT, prior=_prior(top.table_of("prior")), sensors=found,
        motion=None if motion is None or "prior" in motion else _motion(motion),
        time_is_index=top.flag("time_is_index"),
        covariance_floor=top.number("covariance_floor", 1e-10, "a number >= 0", not_negative),
        floored=int(top.number("floored", 0, "a whole number >= 0", lambda v: not_negative(v) and v.is_integer())),
        labels_are_sensed=top.flag("labels_are_sensed"), notes=tuple(notes), source=source,
        origins=_origins(top.table_of("origin")) if "origin" in top else {},
        motion_prior=_motion_prior(motion) if motion is not None and "prior" in motion else None, scanner=scanner,
        fixes=poses.stated(top, poses.FIX), closures=poses.stated(top, poses.CLOSURE),
    )  # fmt: skip
