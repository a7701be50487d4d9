"""One submission, or a class, several at a time and what is finished is kept: as facts, as JSON, as a page."""

import argparse
import ast
import csv
import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd

from data.digest import program_digest
from data.errors import DataError, UsageError, unknown
from data.whole import whole_file
from data.words import environment
from eval.checks.exactness import Bug
from eval.report.page.blocks import Report, Section, Table
from eval.report.render import write_report
from eval.report.words import paragraph, say
from wings.grade import handout
from wings.grade.parts import Outcome
from wings.grade.sandbox import Scheme, outcomes, read_scheme

PACKAGES, LIBRARIES = ("association", "data", "ekf", "eval", "wings"), ("numpy", "scipy")
JSON = "grade.json"
SHINGLE = 8  # nodes of a syntax tree in a piece
BARS = "▁▂▃▄▅▆▇█"
Facts = dict[str, Any]  # of a graded submission, as in its JSON


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


def facts_of(name: str, assignment: str, found: Sequence[Outcome], scheme: Scheme, key: str) -> Facts:
    """All facts of a submission; `key` is a digest of what they depend on."""
    points = {o.part: scheme.points(o) for o in found}
    more = [{"points": points[o.part], "weight": scheme.weights[o.part], "likely": causes(o)} for o in found]
    parts = [asdict(o) | {"first": o.first and o.first._asdict()} | m for o, m in zip(found, more, strict=True)]
    return {"name": name, "assignment": assignment, "points": round(sum(points.values()), 1),
            "most": sum(part["weight"] for part in parts), "seeds": list(scheme.seeds),
            "public_seeds": scheme.seeds == read_scheme(None, assignment).seeds,
            "with_fault": scheme.with_fault, "parts": parts, "key": key}  # fmt: skip


def causes(outcome: Outcome) -> list[str]:
    """Names of likely causes, each with its words."""
    known: Any = environment("eval.checks").get_template("checks.j2").module
    words = {name: str(known.bug(name)) if name in list(Bug) else "" for name in outcome.causes}
    each = outcome.causes.items()
    return [f"{name}: {detail or paragraph('grade#cause', name=name, known=words[name])}" for name, detail in each]


def table_of(facts: Facts) -> pd.DataFrame:
    """A row for each part of a submission."""
    return pd.DataFrame([
        {"part": p["part"], "points": p["points"], "of": p["weight"], "right": p["right"], "questions": p["of"],
         "likely wrong": "; ".join([*filter(None, [p["stopped"], p["first"] and p["first"]["why"]]), *p["likely"]])}
        for p in facts["parts"]
    ])  # fmt: skip


def write_submission(folder: Path, facts: Facts) -> None:
    """Write report.html, report.md and grade.json."""
    folder.mkdir(parents=True, exist_ok=True)
    sections = [Section("Parts", (Table(table_of(facts), paragraph("grade#rule", f=facts)),))]
    for part in facts["parts"]:
        if part["first"] is not None:
            likely = (f"* {each}" for each in part["likely"])
            sections.append(Section(part["part"], (say("grade#first", f=part["first"]), *likely)))
    _report(folder, facts, facts["name"], sections)
    with whole_file(folder / JSON) as file:  # last: a folder with it is finished
        file.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


def _report(folder: Path, facts: Facts, name: str, sections: Sequence[Section]) -> None:
    said = [paragraph(f"grade#{what}", f=facts) for what in ("points", "seeds", "sandbox")]
    command = f"slamref grade {name} --assignment {facts['assignment']}"
    write_report(folder, Report(f"{facts['assignment']}: {name}", command, tuple(filter(None, said)), tuple(sections)))


def distributions(table: pd.DataFrame, weights: Mapping[str, float]) -> pd.DataFrame:
    """A row for the points and for each part: mean, quartiles, how many have all and none, a histogram in tenths."""
    rows = []
    for part, most in weights.items():
        values, last = table[part], len(BARS) - 1
        tenths = (values * 10 // max(most, 1e-9)).clip(0, 9).value_counts()
        low, middle, high = values.quantile([0.25, 0.5, 0.75])
        rows.append({"part": part, "of": most, "mean": round(float(values.mean()), 1),
                     "25 %": low, "median": middle, "75 %": high, "full": int((values >= most).sum()),
                     "zero": int((values <= 0.0).sum()),
                     "histogram": "".join(BARS[-(-last * tenths.get(n, 0) // tenths.max())] for n in range(10)),
                     })  # fmt: skip
    return pd.DataFrame(rows)


def pieces(source: str) -> frozenset[tuple[str, ...]]:
    """Sequences of `SHINGLE` nodes of a program, depth first, without names, constants, arguments and docstrings."""

    def walk(node: ast.AST) -> list[str]:
        below = [n for n in ast.iter_child_nodes(node) if not isinstance(n, ast.expr_context | ast.arguments)]
        said = [n for n in below if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)]
        return [type(node).__name__, *(name for n in below if n not in said for name in walk(n))]

    try:
        nodes = walk(ast.parse(source))
    except (SyntaxError, ValueError, RecursionError):
        return frozenset()
    return frozenset(tuple(nodes[i : i + SHINGLE]) for i in range(len(nodes) - SHINGLE + 1))


def similar(files: Mapping[str, Path], assignment: str, least: float) -> pd.DataFrame:
    """Pairs of submissions whose pieces, those of the handout left out, are equal to a share of `least` or more."""
    given = pieces(handout(assignment)[1])
    own = {n: pieces(f.read_text(encoding="utf-8", errors="replace")) - given for n, f in files.items() if f.is_file()}
    rows = [(a, b, len(own[a] & own[b]) / len(own[a] | own[b])) for a, b in combinations(own, 2) if own[a] | own[b]]
    found = pd.DataFrame([r for r in rows if r[2] >= least], columns=["one", "other", "similarity"])
    return found.sort_values("similarity", ascending=False, ignore_index=True).round({"similarity": 3})


def write_class(folder: Path, every: Sequence[Facts], alike: pd.DataFrame) -> pd.DataFrame:
    """Write class.csv, similar.csv and the page of the class; returns its distributions."""
    rows = [{"name": f["name"], "points": f["points"], **{p["part"]: p["points"] for p in f["parts"]}} for f in every]
    table, first = pd.DataFrame(rows), every[0]
    spread = distributions(table, {"points": first["most"], **{p["part"]: p["weight"] for p in first["parts"]}})
    for name, frame in (("class", table), ("similar", alike)):
        frame.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    facts = first | {"points": None, "submissions": len(table)}
    shown = {"distributions": spread, "submissions": table, "similarity": alike.head(100)}
    sections = [Section(n, (Table(t, paragraph(f"grade#{n}", f=facts)),)) for n, t in shown.items()]
    _report(folder, facts, "CLASS", sections)
    return spread
