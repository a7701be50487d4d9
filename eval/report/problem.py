"""`slamref report-problem`: a small, anonymous copy of an input that still shows its notices, for its owner to send.

One rigid motion moves path, map, truth and fixes, so that the first pose is the origin. Stamps begin at 0, names are
replaced. Rows without which the same notices appear are left out (delta debugging, Zeller and Hildebrandt 2002).
"""

import csv
import re
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from shutil import copytree, rmtree
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from data import se2
from data.columns.header import HEADER
from data.errors import DataError, UsageError
from data.formats.g2o import log_of, read_graph
from data.formats.open_log import write_folder
from data.formats.results.lines import POSE
from data.formats.results.reading import PLANE, read_path
from data.formats.tables.files import QUATERNION
from data.log import shortened
from data.logs import open_log
from data.notice import Notice, Severity
from data.questions.asked import ask
from data.se2 import Array
from data.toml_table import load_toml
from data.whole import whole_file
from eval.plan.flags.table import Scoring
from eval.plan.provenance import versions
from eval.report.results import scored
from eval.report.words import say

Tables = dict[Path, Any]  # fields (rows, columns) of each file as texts or numbers, the header first
PAIR, LOG = ("estimate.csv", "truth.csv"), "log"
PLACED, WHOLE = (*PAIR, "landmarks.csv", "fixes.csv"), ("frames.csv", "odometry.csv", "truth.csv")
"""Files with poses or places of the world; files of a log whose rows all stay."""
SOURCE = ("kind", "odometry_kind", "odometry_period", "integration", "hold")
"""Keys of a log's source that questions read; others may tell of its owner."""
FIRST, TRIES, APART = 16, 200, 1000.0
"""Fewest frames of a log, doubled until its notices appear; most reductions that are tried; largest distance [m] of two
first poses: beside the frame of a country another one tells where it lies there."""


def pack(names: Sequence[str], out: Path) -> str:
    """Write the copy of a log, or of an estimate and its truth, to a zip; returns what its owner should know."""
    with TemporaryDirectory() as temporary:
        raw, folder = Path(temporary, "raw"), Path(temporary, "problem")
        raw.mkdir()
        start, notices = _pair(names[0], names[1], raw) if len(names) == 2 else _log(names[0], raw)
        wanted = _codes(notices)

        def shown(tables: Tables) -> set[str]:
            for file, table in tables.items():
                with file.open("w", encoding="utf-8", newline="") as text:
                    csv.writer(text, lineterminator="\n").writerows(table.tolist())
            try:
                return _codes(_notices(folder))
            except DataError:  # of too few rows
                return set()

        for origin in (start, start * [1.0, 1.0, 0.0]):
            whole = anonymous(raw, folder, origin)
            if not (lost := wanted - shown(whole)):
                break
        kept = reduced(whole, lambda part: wanted - lost <= shown(part)) if wanted - lost else whole
        shown(kept)
        text = say(
            "problem#readme", versions=versions(), notices=_notices(folder), lost=sorted(lost), turned=bool(origin[2]),
            rows=[(file.name, len(kept[file]) - 1, len(whole[file]) - 1) for file in whole],
            command=f"score {' '.join(PAIR)}" if len(names) == 2 else f"inspect {LOG}",
        ).replace(f"{folder}/", "")  # fmt: skip
        (folder / "README.txt").write_text(text, encoding="utf-8")
        with whole_file(out) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(p for p in folder.rglob("*") if p.is_file()):
                archive.write(file, file.relative_to(folder))
    return text


def _codes(found: Iterable[Notice]) -> set[str]:
    return {n.code.value for n in found if n.severity is not Severity.INFO}


def _pair(estimate: str, truth: str, folder: Path) -> tuple[Array, Iterable[Notice]]:
    """Write an estimate and its truth as tables; returns the first true pose (3,) and the notices of the files."""
    paths = [read_path(estimate), read_path(truth)]
    start, height = np.nan_to_num(paths[1].pose[0]), 0.0 if paths[1].space is None else paths[1].space.position[0, 2]
    away = np.nan_to_num(paths[0].pose[0, :2]) - start[:2]
    excess = away * max(0.0, 1.0 - APART / max(float(np.hypot(*away)), 1.0))
    for name, path, off in zip(PAIR, paths, (excess, 0.0 * excess), strict=True):
        time, place = path.time - np.floor(min(p.time[0] for p in paths)), path.pose[:, :2] - off
        names: tuple[str, ...] = PLANE
        table = np.column_stack([time, place, path.pose[:, 2]])
        if path.space is not None and np.isfinite(path.space.rotation).all():
            q = Rotation.from_matrix(path.space.rotation.copy()).as_quat()
            names, table = POSE, np.column_stack([time, place, path.space.position[:, 2] - height, q])
        known = np.isfinite(table).any(axis=0)
        np.savetxt(folder / name, table[:, known], "%.12g", ",", header=",".join(np.array(names)[known]), comments="")
    return start, scored(estimate, truth, Scoring()).run.notes


def _log(name: str, folder: Path) -> tuple[Array, Iterable[Notice]]:
    """Write a log, or the first frames that show all its notices; returns its first pose (3,) and the notices."""
    log = log_of(LOG, read_graph(Path(name))) if name.endswith(".g2o") else open_log(name)
    if not log.recorded.sensor.sees_points:
        raise UsageError(f"{name}: a log of walls is not packed; describe what is wrong with it")
    notices, n, r = ask(log), FIRST, log.recorded
    log = replace(log, recorded=replace(r, time=r.time - np.floor(r.time[0])), truth=replace(log.truth, landmarks=None))
    while n < len(log.recorded) and {q.code for q in notices} - {q.code for q in ask(shortened(log, n))}:
        n *= 2
    write_folder(shortened(log, n) if notices else log, folder / LOG)
    # covariances of fixes are in the world's axes, which stay then
    return log.recorded.prior.mean * [1.0, 1.0, float(log.recorded.fixes is None)], notices


def _notices(folder: Path) -> Iterable[Notice]:
    if (folder / LOG).exists():
        return ask(open_log(folder / LOG))
    return scored(str(folder / PAIR[0]), str(folder / PAIR[1]), Scoring()).run.notes


def anonymous(source: Path, out: Path, start: Array) -> Tables:
    """Copy an input under other names, moved so that a pose (3,) becomes the origin; its tables by their new file."""
    rmtree(out, ignore_errors=True)
    copytree(source, out)
    T, names, tables = se2.inverse(start), set[str](), Tables()
    for file in out.rglob(HEADER):
        header: dict[str, Any] = load_toml(file, DataError)
        mean, P = (np.array(header["prior"][key]) for key in ("mean", "covariance"))
        J = se2.world_from_body(float(T[2]))
        header["prior"] = {"mean": se2.compose(T, mean).tolist(), "covariance": (J @ P @ J.T).tolist()}
        header["source"] = {key: value for key, value in header.get("source", {}).items() if key in SOURCE}
        file.write_text(tomli_w.dumps(header | {"name": LOG, "notes": []}), encoding="utf-8")
        parts = (each for part in ("sensor", "fix", "closure") for each in np.ravel(header.get(part, [])))
        names = {each[key] for each in parts for key in ("name", "sees") if each.get(key)}
    for file in sorted(p for p in out.rglob("*") if p.suffix in (".csv", ".toml")):
        text = file.read_text(encoding="utf-8")
        for k, name in enumerate(sorted(names)):
            text = re.sub(rf"(?<![\w.]){re.escape(name)}(?![\w.])", f"name{k}", text)
        file.write_text(text, encoding="utf-8")
        if file.suffix == ".csv":
            table = np.array(list(csv.reader(text.splitlines())), object)
            table = table[:, ~np.isin(table[0].astype(str), ("stamp", "stamp1", "stamp2"))]
            tables[file] = moved(table, T) if file.name in PLACED else table
    return tables


def moved(table: Any, T: Array) -> Any:
    """A table whose poses and places are moved by T (3,) from the left."""
    head = table[0].tolist()

    def columns(*names: str) -> tuple[list[int], Array]:
        at = [head.index(name) for name in names]
        return at, np.where(table[1:, at] == "", "nan", table[1:, at]).astype(float)

    made = table.copy()
    at, xy = columns("x", "y")
    made[1:, at] = se2.transform_points(T, xy)
    if "theta" in head:
        at, theta = columns("theta")
        made[1:, at] = se2.wrap_angle(theta + T[2])
    if "qw" in head:
        at, q = columns(*QUATERNION)
        made[1:, at] = (Rotation.from_rotvec([0.0, 0.0, T[2]]) * Rotation.from_quat(q)).as_quat()
    return np.where(made == made, made, "")


def reduced(tables: Tables, shows: Callable[[Tables], bool]) -> Tables:
    """Tables that still show it: of each in turn, pieces are left out that get smaller, until its tries end."""
    files = [file for file in tables if file.parent.name != LOG or file.name not in WHOLE]
    for file in files:
        left, piece = TRIES // len(files), len(tables[file]) - 1
        while piece and left:
            at = 1
            while at < len(tables[file]) and left:
                left -= 1
                trial = {**tables, file: np.delete(tables[file], slice(at, at + piece), axis=0)}
                if shows(trial):
                    tables = trial
                else:
                    at += piece
            piece //= 2
    return tables
