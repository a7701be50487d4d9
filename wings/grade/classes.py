"""One submission, or a class: several at a time, and what is finished is kept."""

import argparse
import csv
import hashlib
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path

from data.digest import program_digest
from data.errors import DataError, UsageError, unknown
from wings.grade.pages import JSON, Facts, facts_of, similar, table_of, write_class, write_submission
from wings.grade.parts import Outcome
from wings.grade.sandbox import outcomes, read_scheme

PACKAGES, LIBRARIES = ("association", "data", "ekf", "eval", "wings"), ("numpy", "scipy")


def grade(options: argparse.Namespace) -> None:
    """Grade what the options of the command name, print and write it."""
    assignment, data = options.assignment, options.data
    scheme = read_scheme(options.weights, assignment)
    chosen = options.part or list(scheme.weights)
    if strange := [part for part in chosen if part not in scheme.weights]:
        raise UsageError(f"--part {strange[0]}: {unknown(strange[0], scheme.weights)}")
    weights = {part: points for part, points in scheme.weights.items() if part in chosen}
    scheme = replace(scheme, seeds=options.seeds or scheme.seeds, weights=weights)
    if data is not None and assignment != "utias":
        raise UsageError("--data: for --assignment utias")
    files, one = submissions(options.place, assignment)
    out: Path | None = options.out if one else options.out or Path("results/grade")
    depends = f"{assignment} {asdict(scheme)} {data} {program_digest(PACKAGES, LIBRARIES)}"

    def graded(name: str, file: Path) -> Facts:
        """The facts of a submission, from its folder if nothing that they depend on has changed."""
        digest, done = hashlib.sha256(depends.encode()), (out or Path()) / ("" if one else name) / JSON
        for path in sorted(file.parent.glob("*.py")):
            digest.update(path.name.encode() + path.read_bytes())
        if out is not None and done.is_file():
            before: Facts = json.loads(done.read_text(encoding="utf-8"))
            if before["key"] == digest.hexdigest():
                return before
        absent = [Outcome(part, stopped=f"no {file.name}") for part in scheme.weights]
        found = outcomes(file, assignment, scheme, data) if file.is_file() else absent
        facts = facts_of(name, assignment, found, scheme, digest.hexdigest())
        if out is not None:
            write_submission(done.parent, facts)
        sys.stdout.write(f"{name}: {facts['points']:.1f} of {facts['most']:g} points\n")
        return facts

    with ThreadPoolExecutor(max(options.jobs, 1)) as threads:
        every = list(threads.map(graded, *zip(*files.items(), strict=True)))
    if one or out is None:
        shown = table_of(every[0])
    else:
        alike = similar(files, assignment, scheme.similar)
        shown = write_class(out, every, alike)
        sys.stdout.write(f"{len(alike)} near-identical pairs (similar.csv)\n")
    sys.stdout.write(f"\n{shown.to_string(index=False)}\n" + (f"written: {out}\n" if out else ""))


def submissions(place: Path, assignment: str) -> tuple[dict[str, Path], bool]:
    """Files by name, and whether it is a single submission and no class. DataError for none, or a wrong list."""
    own = f"{assignment}.py"
    if place.suffix == ".csv":
        try:
            rows = list(csv.DictReader(place.read_text(encoding="utf-8").splitlines()))
            found = {row["name"].strip(): place.parent / row["path"].strip() for row in rows}
        except (KeyError, AttributeError, OSError):
            raise DataError.at(place, "a file with the columns name and path is needed") from None
        if not rows or len(found) < len(rows) or any(Path(name).name != name for name in found):
            raise DataError.at(place, "names are needed that differ, and can be names of folders")
        return {name: path / own if path.is_dir() else path for name, path in found.items()}, False
    if place.is_file() or (place / own).is_file():
        return {place.absolute().stem: place if place.is_file() else place / own}, True
    folders = sorted(p for p in place.iterdir() if p.is_dir()) if place.is_dir() else []
    if not any((p / own).is_file() for p in folders):
        raise DataError.at(place, f"no {own}, nor folders with one")
    return {p.name: p / own for p in folders}, False
