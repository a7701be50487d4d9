"""Recordings that can be converted to logs, and the command to type."""

import shlex
import tomllib
from pathlib import Path

from data.wing import recording_in

MOST = 8  # Most names of variables in a message
KINDS: dict[str, str] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""By suffixes: what a file is that is no log, and the command that takes it."""

GRAPHS = (".g2o", ".graph", ".toro", ".txt")  # suffixes of files of graphs


def what_to_type(path: Path) -> str:
    """Of a file or folder that is no log: what it is, and the command that takes it; empty if that is unknown."""
    from data.formats.arrays import suffix_of
    from data.formats.matlab import variables
    from data.formats.mrclam import is_mrclam, robots
    from data.formats.recordings.ros import is_bag

    file = shlex.quote(str(path))
    if is_mrclam(path):
        of = robots(path)
        numbers = f"{of[0]} (of {', '.join(map(str, of))})" if len(of) > 1 else f"{of[0]}"
        return f"a UTIAS MRCLAM dataset; type slamref convert mrclam {file} LOG --robot {numbers}"
    if is_bag(path):
        return KINDS[".bag .mcap .db3"].format(file=file)
    if path.is_dir():
        own = f"a result folder; type slamref report {file}, or name one of its logs"
        return own if (path / "provenance.json").is_file() else _tables(path)
    if path.suffix.lower() == ".mat":
        folder = path.absolute().parent
        if (recording := recording_in(folder)) is not None:
            return f"a file of {recording.what}, whose folder is a log; type slamref inspect {shlex.quote(str(folder))}"
        names = list(variables(path))
        listed = ", ".join(names[:MOST]) + (", ..." if len(names) > MOST else "")
        return f"a MATLAB file with {listed}; type slamref convert table {file} LOG (--help names its flags)"
    from data.formats.recordings.tagged import is_course

    if is_course(path):
        return f"the log of a SLAM course; type slamref convert course {file} LOG --map world.dat"
    relations, landmarks = edges_of(path)
    if relations and not landmarks:
        return f"a pose graph; slamref audit {file} optimizes it, slamref convert g2o {file} LOG makes it a log"
    ours = (said for of, said in KINDS.items() if suffix_of(path) in of.split())
    return (KINDS[".g2o .graph .toro"] if landmarks else next(ours, "")).format(file=file)


def _tables(folder: Path) -> str:
    """The command that takes the tables of a folder, whose names tell their parts; empty where none is of odometry."""
    from data.formats.results.reading import words_of
    from data.formats.tables.files import PARTS

    words = {"map": MAP, "observations": PARTS["observations"] | RANGES, "odometry": PARTS["odometry"] | MOTION}
    words = {**words, "fixes": PARTS["fixes"], "truth": PARTS["truth"]}
    found: dict[str, str] = {}
    for file in sorted(f for f in folder.iterdir() if f.suffix.lower() in TABLES):
        own = {word.rstrip("s") for word in words_of(file.stem)[0]}
        role = next((role for role, of in words.items() if own & of), "")
        found.setdefault(role, shlex.quote(str(file)))
    odometry, others = found.pop("odometry", ""), sorted(found.keys() - {""})
    flags = " ".join(f"--{role} {found[role]}" for role in others)
    return f"a folder of tables; type slamref convert table {odometry} LOG {flags}".rstrip() if odometry else ""


TABLES = (".csv", ".tsv", ".txt", ".dat", ".xlsx", ".parquet")
MOTION = frozenset(("motion", "control", "command", "cmd", "velocity", "speed"))
RANGES = frozenset(("uwb", "range", "bearing"))
MAP = frozenset(("map", "landmark", "anchor", "beacon", "marker"))


def edges_of(path: Path) -> tuple[int, int]:
    """Numbers of relations of poses and of observations of landmarks in a file of a graph; zeros for any other."""
    from data.formats.graph_file import EDGES, words_of

    if path.suffix.lower() not in GRAPHS or not path.is_file():
        return 0, 0
    with path.open(errors="replace") as lines:
        tags = (words_of(line)[0] for line in lines)
        ends = [EDGES[tag][2:] for tag in tags if tag in EDGES]
    relations = sum(first == second for first, second in ends)
    return relations, len(ends) - relations
