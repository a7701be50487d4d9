"""`slamref report-problem`: a small, anonymous copy of an input that still shows its notices, for its owner to send.

One rigid motion moves path, map, truth and fixes, so that the first pose is the origin. Stamps begin at 0, names are
replaced. Rows without which the same notices appear are left out (delta debugging, Zeller and Hildebrandt 2002).
"""

import zipfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from shutil import copytree, rmtree
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from scipy.spatial.transform import Rotation

from data import se2
from data.columns.header import HEADER
from data.columns.named import COVARIANCE, UPPER
from data.errors import DataError, UsageError
from data.formats.g2o import log_of, read_graph
from data.formats.open_log import write_folder
from data.formats.results.reading import read_path
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

Tables = dict[Path, pd.DataFrame]
PAIR, LOG = ("estimate.csv", "truth.csv"), "log"
PLACED, WHOLE = (*PAIR, "landmarks.csv", "fixes.csv"), ("frames.csv", "odometry.csv", "truth.csv")
"""Files with poses or places of the world; files of a log whose rows all stay."""
IDS, NAMES = ("id", "true_id", "label"), ("source", "sensor", "kind", "class")
SOURCE = ("kind", "odometry_kind", "odometry_period", "integration", "hold")
"""Keys of a log's source that questions read; others may tell of its owner."""
APART = 1000.0
"""m, largest distance of two first poses: if one frame is that of a country, the other tells where it lies there."""
FIRST, TRIES = 16, 200
"""Fewest frames of a log, doubled until its notices appear; most reductions that are tried."""


def pack(names: Sequence[str], out: Path, code: str | None) -> str:
    """Write the copy of a log, or of an estimate and its truth, to a zip; returns what its owner should know.

    Kept is what shows all questions and warnings, or those of one code.
    """

    def codes(found: Iterable[Notice]) -> set[str]:
        return {n.code.value for n in found if n.severity is not Severity.INFO and code in (None, n.code.value)}

    with TemporaryDirectory() as temporary:
        raw, folder = Path(temporary, "raw"), Path(temporary, "problem")
        raw.mkdir()
        start, notices = _pair(names[0], names[1], raw) if len(names) == 2 else _log(names[0], raw)
        if code is not None and not codes(notices):
            raise UsageError(f"--code {code}: no such notice; there are: {', '.join(n.code.value for n in notices)}")

        def shown(tables: Tables) -> set[str]:
            for file, table in tables.items():
                table.to_csv(file, index=False)
            try:
                return codes(_notices(folder))
            except DataError:  # of too few rows
                return set()

        for origin in (start, start * [1.0, 1.0, 0.0]):
            whole = anonymous(raw, folder, origin)
            lost = codes(notices) - shown(whole)
            if not lost:
                break
        wanted = codes(notices) - lost
        kept = reduced(whole, lambda part: wanted <= shown(part)) if wanted else whole
        shown(kept)
        text = say(
            "problem#readme", versions=versions(), notices=_notices(folder), lost=sorted(lost), turned=origin is start,
            rows=[(file.name, len(kept[file]), len(whole[file])) for file in whole],
            command=f"score {' '.join(PAIR)}" if len(names) == 2 else f"inspect {LOG}",
        ).replace(f"{folder}/", "")  # fmt: skip
        (folder / "README.txt").write_text(text, encoding="utf-8")
        with whole_file(out) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(p for p in folder.rglob("*") if p.is_file()):
                archive.write(file, file.relative_to(folder))
    return text


def _pair(estimate: str, truth: str, folder: Path) -> tuple[Array, Iterable[Notice]]:
    """Write an estimate and its truth as tables; returns the first true pose (3,) and the notices of the files."""
    paths = [read_path(estimate), read_path(truth)]
    height = 0.0 if paths[1].space is None else paths[1].space.position[0, 2]
    away = np.nan_to_num(paths[0].pose[0, :2] - paths[1].pose[0, :2])
    excess = away * max(0.0, 1.0 - APART / max(float(np.hypot(*away)), 1.0))
    for name, path in zip(PAIR, paths, strict=True):
        table = pd.DataFrame(np.column_stack([path.time, path.pose]), columns=["t", "x", "y", "theta"])
        table["t"] -= np.floor(min(p.time[0] for p in paths))
        table[["x", "y"]] -= excess if path is paths[0] else 0.0
        if path.covariance is not None:
            table[[*COVARIANCE]] = path.covariance[:, *UPPER]
        elif path.space is not None:
            table = table.drop(columns="theta").assign(z=path.space.position[:, 2] - height)
            table[[*QUATERNION]] = Rotation.from_matrix(path.space.rotation.copy()).as_quat()
        table.dropna(axis=1, how="all").to_csv(folder / name, index=False)
    return np.nan_to_num(paths[1].pose[0]), scored(estimate, truth, Scoring()).run.notes


def _log(name: str, folder: Path) -> tuple[Array, Iterable[Notice]]:
    """Write a log, or the first frames that show all its notices; returns its first pose (3,) and the notices."""
    log = log_of(LOG, read_graph(Path(name))) if name.endswith(".g2o") else open_log(name)
    if not log.recorded.sensor.sees_points:
        raise UsageError(f"{name}: a log of walls is not packed; describe what is wrong with it")
    notices, n = ask(log), FIRST
    while n < len(log.recorded) and {q.code for q in notices} - {q.code for q in ask(shortened(log, n))}:
        n *= 2
    write_folder(shortened(log, n) if notices else log, folder / LOG)
    return log.recorded.prior.mean, notices


def _notices(folder: Path) -> Iterable[Notice]:
    """The notices of an input in a folder of ours."""
    if (folder / LOG).exists():
        return ask(open_log(folder / LOG))
    estimate, truth = (str(folder / name) for name in PAIR)
    return scored(estimate, truth, Scoring()).run.notes


def anonymous(source: Path, out: Path, start: Array) -> Tables:
    """Copy an input under other names, moved so that a pose (3,) becomes the origin; its tables by their new file."""
    rmtree(out, ignore_errors=True)
    copytree(source, out)
    T, known, tables = se2.inverse(start), dict[Any, Any]({"": ""}), Tables()

    def renamed(value: Any) -> Any:
        if isinstance(value, str):
            return known.setdefault(value, f"name{len(known)}")
        return known.setdefault(value, len(known)) if value >= 0 else value

    for file in out.rglob(HEADER):
        header: dict[str, Any] = load_toml(file, DataError)
        for part in ("sensor", "fix", "closure"):
            for each in np.ravel(header.get(part, [])):
                each |= {key: renamed(each[key]) for key in ("name", "sees") if key in each}
        mean, P = (np.array(header["prior"][key]) for key in ("mean", "covariance"))
        J = se2.world_from_body(float(T[2]))
        header["prior"] = {"mean": se2.compose(T, mean).tolist(), "covariance": (J @ P @ J.T).tolist()}
        header["source"] = {key: value for key, value in header.get("source", {}).items() if key in SOURCE}
        header["origin"] = {key: value for key, value in header.get("origin", {}).items() if "." not in key}
        file.write_text(tomli_w.dumps(header | {"name": LOG, "notes": []}), encoding="utf-8")
    for file in sorted(out.rglob("*.csv")):
        table = pd.read_csv(file, dtype=dict.fromkeys(IDS, "Int64"))
        table = table.drop(columns=["stamp", "stamp1", "stamp2"], errors="ignore")
        for column in set(table) & {*IDS, *NAMES} - ({"kind"} if file.name == "fixes.csv" else set()):
            table[column] = table[column].map(renamed, na_action="ignore")
        tables[file] = moved(table, T) if file.name in PLACED else table
    return tables


def moved(table: pd.DataFrame, T: Array) -> pd.DataFrame:
    """Poses, places and covariances of a table moved by T (3,) from the left."""
    J = se2.world_from_body(float(T[2]))
    table[["x", "y"]] = se2.transform_points(T, table[["x", "y"]].to_numpy(float))
    if "theta" in table:
        table["theta"] = se2.wrap_angle(table["theta"].to_numpy(float) + T[2])
    if COVARIANCE[0] in table:
        triangle, P = table[[*COVARIANCE]].to_numpy(float), np.zeros((len(table), 3, 3))
        P[:, *UPPER] = P[:, UPPER[1], UPPER[0]] = np.nan_to_num(triangle)
        table[[*COVARIANCE]] = np.where(np.isnan(triangle), np.nan, (J @ P @ J.T)[:, *UPPER])
    if "qw" in table:
        turned = Rotation.from_rotvec([0.0, 0.0, T[2]]) * Rotation.from_quat(table[[*QUATERNION]])
        table[[*QUATERNION]] = turned.as_quat()
    return table


def reduced(tables: Tables, shows: Callable[[Tables], bool]) -> Tables:
    """Tables that still show it: of each in turn, pieces are left out that get smaller, until its tries end."""
    files = [file for file in tables if file.parent.name != LOG or file.name not in WHOLE]
    for file in files:
        left, piece = TRIES // len(files), len(tables[file])
        while piece and left:
            at = 0
            while at < len(tables[file]) and left:
                left -= 1
                trial = {**tables, file: tables[file].drop(tables[file].index[at : at + piece])}
                if shows(trial):
                    tables = trial
                else:
                    at += piece
            piece //= 2
    return tables
