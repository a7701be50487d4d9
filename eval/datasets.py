"""`slamref datasets`: public data sets (`datasets.toml`), where they are, and the commands. Nothing is fetched."""

import hashlib
import shlex
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from data.command import Command
from data.errors import UsageError
from data.terminal import INTERRUPTED, ending, in_columns
from eval.run_all import main as run_main

PROG = "python -m eval.datasets"
RUN = "--task localization,slam --estimator ekf,isam2,batch --association known,jcbb-hindsight"
SHOWN = ("rmse_position_m", "rmse_landmark_m", "rms_from_batch_m", "nees_pose", "landmarks")
ABOUT = "List public data sets: page, licence as stated there, digest of our copy, commands. Nothing is fetched."
ALL = "Run every public data set that a folder has, and write one table, datasets.csv."


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    Command(prog, PROG, ABOUT, f"example:\n  {PROG}").read(argv)
    for entry in datasets():
        lines = [entry["title"], f"page: {entry['page']}", f"licence: {entry['licence']}"]
        lines += [f"sha256 of our copy: {entry['sha256']}"] if "sha256" in entry else []
        for convert, run in list(commands(entry, entry.get("file", ""), "logs"))[:1]:
            lines += [f"slamref convert {shlex.join(convert)}"] if convert else []
            lines += [f"slamref run {shlex.join(run)}"]
        sys.stdout.write("\n  ".join([entry["name"], *lines]) + "\n")


@ending()
def study(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """`slamref study`: positional words are values of `--scenario`, but for `datasets FOLDER`."""
    if list(argv or ())[:1] != ["datasets"]:
        return run_main(argv, prog, "scenario")
    parser = Command(f"{prog} datasets", PROG, ALL, f"example:\n  {PROG} downloads")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="has the files that slamref datasets names")
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("results/datasets"), help="%(default)s")
    return _reproduce(**vars(parser.read(list(argv or ())[1:])))


def datasets() -> list[dict[str, Any]]:
    """The entries of `datasets.toml`, each with what it shares with another one."""
    found = dict[str, dict[str, Any]]()
    for entry in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["dataset"]:
        found[entry["name"]] = {k: v for k, v in found.get(entry.get("like"), {}).items() if k != "sha256"} | entry
    return list(found.values())


def commands(entry: dict[str, Any], file: str, out: str) -> Iterator[tuple[list[str], list[str]]]:
    """Words of `slamref convert`, if needed, and of `slamref run`, for each log of a data set with its file."""
    for each in entry.get("each", [""]):
        log = f"{out}/{entry['name']}{f'-{each}' if each else ''}"
        places = {"file": file, "log": log, "each": each}
        convert = [word.format(**places) for word in entry.get("convert", "").split()]
        yield convert, [log if convert else entry.get("log", file), *entry.get("run", RUN).split()]


def _reproduce(folder: Path, out: Path) -> int:
    import pandas as pd

    from data.convert.__main__ import main as convert_main

    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    tables, failed = list[Any](), list[str]()
    for entry in datasets():
        files = sorted(folder.rglob(entry["file"])) if "file" in entry else [folder]
        if not files:
            sys.stderr.write(f"{entry['name']}: {entry['file']} is not in {folder}; get it from {entry['page']}\n")
            continue
        ours = [f for f in files if f.is_file() and hashlib.sha256(f.read_bytes()).hexdigest() == entry.get("sha256")]
        if "sha256" in entry and not ours:
            sys.stderr.write(f"{entry['name']}: {files[0].name} is another copy than ours\n")
        for convert, run in commands(entry, str([*ours, *files][0]), str(out / "logs")):
            log = Path(run[0]).name
            sys.stderr.write(f"{entry['name']}: {log}\n")
            status = convert_main(convert) if convert and not Path(run[0]).exists() else 0
            status = status or run_main([*run, "--no-plots", "--quiet", "--out", str(out / "reports" / log)])
            if status == INTERRUPTED:
                return status
            if status:
                failed.append(log)
            else:
                tables.append(pd.read_csv(out / "reports" / log / "metrics.csv").assign(dataset=entry["name"]))
    if not tables:
        raise UsageError(f"{folder}: none of the data sets could be run; slamref datasets lists them")
    table = pd.concat(tables).set_index("dataset")
    table.to_csv(out / "datasets.csv", lineterminator="\n")
    keys = ["log", "task", "association", "estimator", "phase", "status", *SHOWN]
    rows = [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in row] for row in table[keys].to_numpy()]
    lines = in_columns([keys, *(["" if v == "nan" else v for v in row] for row in rows)])
    sys.stdout.write("\n".join([*lines, *(f"not run: {log}" for log in failed), f"{out / 'datasets.csv'}\n"]))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
