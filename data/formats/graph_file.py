"""Files of factor graphs, in the plane and in space: g2o, Toro, iSAM. Lines are kept for writing.
docs/notes/audit.md lists the lines that are read. Vertices and edges may lie in two files, with or without tags.

I: information, upper triangle row by row; in space translation first. As gtsam's reader, and unlike g2o, the rotation's
information is, by default, of the angle, not of the quaternion's half angle. Poses and points have ids of their own. An
edge without information is assumed to have the identity. Measurements of sensors with an offset become the robot's.

Programs disagree on the noise N of text: gtsam reads covariances, iSAM the root R of an information R'R, upper
triangle. Where a reader does not say, numbers below 1 are covariances, larger ones roots: a position is known to less
than a metre. So are EDGE2 in the order of rows, which iSAM writes; in Toro's order they are information.
"""

import math
import re
import tomllib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from data.columns.named import definite
from data.csv_table import bytes_of, is_number, symmetric
from data.errors import LARGEST, DataError
from data.origin import Origin
from data.se2 import Array, compose, inverse

POSE2, POSE3, POINT2, POINT3 = "pose2", "pose3", "point2", "point3"
LINES: dict[str, Any] = tomllib.loads(Path(__file__).with_name("graph_lines.toml").read_text(encoding="utf-8"))
VERTICES, EDGES, PRIORS = ({tag: tuple(of) for tag, *of in LINES[part]} for part in ("vertices", "edges", "priors"))
SWITCHED = ("EDGE_SE2_SWITCHABLE", "EDGE_SE3_SWITCHABLE")
BEARING, RANGE = "EDGE_BEARING_SE2_XY", "EDGE_RANGE_SE2_XY"
IN_SPACE, POSE_IN_SPACE = "EDGE_SE3_PRIORXYZ", "EDGE_SE3_PRIOR"
OFFSETS = {"PARAMS_SE3OFFSET": 7, "PARAMS_SE2OFFSET": 3}
TEXT = ("ODOMETRY", "CONSTRAINT", "CONSTRAINT2", "LANDMARK")  # in any case
TAGS, UNTAGGED = {*VERTICES, *EDGES, *PRIORS, *OFFSETS, "FIX"}, LINES["untagged"]
SUFFIXES = (".g2o", ".graph", ".toro", ".txt", ".dat", ".csv")  # of graphs in a folder
NAMED = re.compile("[A-Za-z][0-9]{1,16}")  # a name, as of gtsam's keys
INFORMATION, COVARIANCE, ROOT = NOISES = ("information", "covariance", "root")  # What the noise of text states
IN_SPACE_AS = {"half-angle": np.diag([1.0, 1, 1, 0.5, 0.5, 0.5]), "rotation-first": np.eye(6)[[3, 4, 5, 0, 1, 2]]}
"""What else the information in space states: the error that it is of, from that of the angle, translation first."""
TORO = [0, 1, 4, 2, 5, 3]  # places of I11 I12 I13 I22 I23 I33 among the six of an EDGE2
MOST_TAGS = 8  # of a file's own that a refusal lists
LONG = 40  # characters; Python reads no whole number of thousands
MOST_IDS = 2**63  # ids are below: keys of gtsam, too
HUGE = 1e30  # the largest number: the information of a sigma of 1e-15
UNIT = 1e-3  # largest difference of a quaternion's norm from 1


class IndefiniteError(DataError):
    """An information matrix or covariance that is none."""


@dataclass(frozen=True, eq=False)
class Edge:
    """One factor."""

    tag: str
    ends: tuple[int, int]
    measured: Array
    information: Array  # (d, d)
    line: int  # in the file
    parameter: int = -1  # -1: none
    carried: Array | None = None  # (d, d) from the stated error, of a sensor with an offset, to that of the robot
    origin: Origin = Origin.STATED  # of the information; where no line states it, it is assumed to be the identity
    whole: Array | None = None  # stated information of a relation of poses, one of which is taken for a point


@dataclass(frozen=True, eq=False)
class GraphFile:
    """A graph as written."""

    path: Path
    lines: list[str]
    poses: dict[int, tuple[str, Array]]  # kind and values by id
    points: dict[int, tuple[str, Array]]  # the same
    edges: list[Edge]  # in order
    fixed: list[int]  # ids
    offsets: dict[int, Array]
    other: Counter[str]  # number of lines that are not read, by tag
    parts: list[tuple[int, Path, bool]]  # of each file the lines before it, and whether its rows have no tags
    priors: list[Edge] = field(default_factory=list)  # measured poses and positions, both ends the same
    noise: str = ""  # what text states, one of `NOISES`, or "" without text
    rows: bool = False  # EDGE2 are in the order of rows
    named: bool = False  # PyFG: variables have names, and all noise is stated as that of text
    space: str = ""  # what the information in space states, one of `IN_SPACE_AS`, or ""

    @property
    def listed(self) -> bool:
        """Whether poses have lines, not one that edges lead from alone: the others begin where these put them."""
        return len(self.poses) > any(self.poses.keys() & set(e.ends) for e in self.edges)

    def kind(self, edge: Edge) -> tuple[str, str]:
        """Kinds of the variables at both ends."""
        return EDGES[edge.tag][2:]

    def states(self, edge: Edge) -> str:
        """What the noise of an edge states, one of `NOISES`."""
        return self.noise if self.named or edge.tag in TEXT or (edge.tag == "EDGE2" and self.rows) else INFORMATION

    def wrong(self, line: int, what: str) -> DataError:
        """The error at a line, in its own file."""
        before, path, _ = [part for part in self.parts if part[0] < line][-1]
        return DataError.at(path, what, line=line - before)


def read_graph_file(
    path: Path, noise: str | None = None, *, bare: bool = False, more: Sequence[Path] = ()
) -> GraphFile:
    """Read a graph from a file, or a folder of its one or two files, and `more` files; a vertex of several counts as in
    the first. `noise`: one of `NOISES`, `IN_SPACE_AS`; None: as the numbers suggest. `bare`: vertices suffice.

    Raises DataError with line and value: wrong fields, a number that is none, an information matrix that is not
    positive definite, a quaternion that is no rotation, an id that is repeated, or of two kinds, a pose without its
    vertex where the file has some; for a file without an edge, and a folder that may hold several graphs.
    """
    inside = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES) if path.is_dir() else [path]
    texts = [(p, bytes_of(p).decode("utf-8-sig", "replace")) for p in (*inside, *more)]
    graph = None if len(inside) not in (1, 2) else graph_file_of(*texts[0], noise, bare=bare, more=texts[1:])
    if graph is None or (len(inside) == 2 and len({e.line > graph.parts[1][0] for e in graph.edges}) == 2):
        raise DataError.at(path, UNTAGGED["folder"].format(len(inside), ", ".join(p.name for p in inside[:MOST_TAGS])))
    return graph


def _tagged(path: Path, text: str) -> tuple[list[str], bool]:
    """Lines of a file, and whether it has no tags: then those by the number of its columns."""
    lines = text.splitlines()
    if any(words_of(line)[0] in TAGS for line in lines):
        return lines, False
    rows = [re.split(r"[\s,;]+", line.split("#")[0].strip(" \t,;")) for line in lines]
    tags = [UNTAGGED["tags"].get(str(len(row))) if all(map(is_number, row)) else None for row in rows]
    first = next((i for i, tag in enumerate(tags) if tag), 0)
    if first and rows[first - 1] != [""]:
        if not re.match(UNTAGGED["names"], " ".join(rows[first - 1]), re.IGNORECASE):
            raise DataError.at(path, UNTAGGED["needed"].format(", ".join(rows[first - 1])), line=first)
        lines[first - 1] = f"# {lines[first - 1]}"
    return [" ".join([t, *row]) if t else line for t, row, line in zip(tags, rows, lines, strict=True)], any(tags)


def graph_file_of(
    path: Path, text: str, noise: str | None = None, *, bare: bool = False, more: Sequence[tuple[Path, str]] = ()
) -> GraphFile:
    """The graph of a text, and of `more` files with theirs; errors, as of `read_graph_file`, name the path."""
    lines, parts = list[str](), list[tuple[int, Path, bool]]()
    for file, each in ((path, text), *more):
        some, untagged = _tagged(file, each)
        parts.append((len(lines), file, untagged))
        lines += some
    words = [(number, words_of(line)) for number, line in enumerate(lines, start=1)]
    words = [(number, w) for number, w in words if w[0]]
    rows, meant = _layout(words)
    if named := any(NAMED.fullmatch(word) for line in lines if line.startswith("EDGE") for word in line.split()[2:3]):
        meant = COVARIANCE
    space, noise = (noise or "", None) if noise in IN_SPACE_AS else ("", noise)
    noise = (noise or meant) if meant else ""
    graph = GraphFile(
        path, lines, {}, {}, [], [], {}, Counter(), parts, noise=noise, rows=rows, named=named, space=space
    )
    for number, (tag, *fields) in words:  # before the edges that name them
        if tag in OFFSETS:
            (key,), values = _fields(graph, number, tag, fields, 1, OFFSETS[tag])
            graph.offsets[key] = _pose(graph, number, tag, values)
    seen, indefinite, own = dict[tuple[str, int], int](), list[IndefiniteError](), list[Edge]()
    for number, (tag, *fields) in words:
        if tag in VERTICES:
            kind, count = VERTICES[tag]
            (key,), values = _fields(graph, number, tag, fields, 1, count)
            known = graph.poses if kind in (POSE2, POSE3) else graph.points
            file_number = sum(before < number for before, *_ in parts)
            if seen.setdefault((kind, key), file_number) < file_number:
                graph.other[f"{tag} again"] += 1
            elif key in known:
                raise graph.wrong(number, f"{tag}: vertex {key} is repeated; ids must be unique")
            else:
                known[key] = kind, _pose(graph, number, tag, values)
        elif tag in EDGES:
            try:
                edge = _edge(graph, number, tag, fields)
                (own if edge.ends[0] == edge.ends[1] and EDGES[tag][2] == EDGES[tag][3] else graph.edges).append(edge)
            except IndefiniteError as error:
                indefinite.append(error)
        elif tag in PRIORS:
            graph.priors.append(_prior(graph, number, tag, fields))
        elif tag == "FIX":
            graph.fixed.extend(_fields(graph, number, tag, fields, len(fields), 0)[0])
        elif tag not in OFFSETS:
            graph.other[tag] += 1
    if own:
        graph.other[f"{own[0].tag} from a vertex to itself (line {own[0].line}{' first' * (len(own) > 1)})"] = len(own)
    if indefinite:
        n, total = len(indefinite), len(indefinite) + len(graph.edges)
        so = f"; so are those of {n} of {total} edges" * (n > 1)
        raise DataError(f"{indefinite[0]}{so}")
    if not graph.edges and not (bare and graph.poses):
        tags = Counter(w[0][:LONG] for _, w in words if w[0].isascii() and w[0][0].isalpha()).most_common(MOST_TAGS)
        has = f"no edge of a graph among {', '.join(f'{n} {tag}' for tag, n in tags)}" if tags else "no edge of a graph"
        has += "; if another file has them, name both: slamref audit A B" * bool(graph.poses)
        has += "; a graph of gtsam's is what a function returns: slamref audit FILE.py:FUNCTION" * ("\0" in text)
        raise DataError.at(path, f"{has}; lines of g2o or Toro are needed, with a tag of {', '.join(EDGES)}")
    turns = np.abs([e.measured[2] for e in graph.edges if graph.kind(e) == (POSE2, POSE2)])
    if 2 * (turns > 2.0 * math.pi).sum() > np.count_nonzero(turns):
        raise DataError.at(path, "turns of most edges exceed 2 pi, as in degrees; rad, in their noise too, are needed")
    _check(graph)
    return graph


def words_of(line: str, *, plain: bool = True) -> list[str]:
    """Words of a line, also in brackets, without its comment; the tag as known; `plain`: PyFG's names as keys."""
    text = line.split("#")[0]
    divided = "(" in text or re.match(r"\s*[\w:]+[,;]", text)
    tag, *fields = (re.sub("[,;(){}]", " ", text) if divided else text).split() or [""]
    upper = tag.upper().rstrip(":")
    if plain and any(map(NAMED.fullmatch, fields[:2])):
        fields = fields[NAMED.fullmatch(fields[0]) is None :]  # without its stamp
        fields = [str((ord(f[0]) << 56) + int(f[1:])) if NAMED.fullmatch(f) else f for f in fields]
    return [LINES["aliases"].get(upper, upper), *fields]


def _layout(words: list[tuple[int, list[str]]]) -> tuple[bool, str]:
    """Whether EDGE2 are in the order of rows, and what the noise of text states ("": there is none)."""
    sixes = np.array([_six(w[6:]) for _, w in words if w[0] == "EDGE2" and len(w) == 12]).reshape(-1, 6)
    rows = bool(sixes[:, [0, 3, 5]].all()) and not definite(symmetric(sixes[:, TORO])).all()
    text = [_six(w[6:])[[0, 3, 5]] for _, w in words if w[0] in TEXT[:-1] and len(w) == 12]
    text += [_six(w[5:])[[0, 2]] for _, w in words if w[0] == TEXT[-1] and len(w) == 8]
    text += [v[[0, 3, 5]] for v in sixes if rows]
    if not text:
        return rows, ""
    return rows, COVARIANCE if float(np.median(np.abs(np.concatenate(text)))) < 1.0 else ROOT


def _six(fields: list[str]) -> Array:
    return np.array([float(f) if is_number(f) else 0.0 for f in fields])


def _check(graph: GraphFile) -> None:
    """Raise DataError for ends that are missing or of two kinds."""
    kinds: dict[tuple[bool, int], str] = {(False, k): kind for k, (kind, _) in graph.poses.items()}
    kinds |= {(True, k): kind for k, (kind, _) in graph.points.items()}
    for edge in graph.edges:
        for key, kind in zip(edge.ends, graph.kind(edge), strict=True):
            point, what = kind in (POINT2, POINT3), ""
            if graph.listed and not point and key not in graph.poses:
                what = f"vertex {key} is missing; each pose needs its line, or none has one"
            elif kinds.setdefault((point, key), kind) != kind:
                what = f"{key} is a {kinds[point, key]}, where a {kind} is needed"
            if what:
                raise graph.wrong(edge.line, f"{edge.tag}: {what}")
    for prior in graph.priors:
        where, kind = ("space", POSE3) if prior.tag in (IN_SPACE, POSE_IN_SPACE) else ("the plane", POSE2)
        if kinds.get((False, prior.ends[0])) != kind:
            raise graph.wrong(prior.line, f"prior of {prior.ends[0]}: no pose in {where} has this id")
    missing = next((key for key in graph.fixed if not kinds.keys() & {(False, key), (True, key)}), None)
    if missing is not None:
        raise DataError.at(graph.path, f"FIX {missing}: vertex {missing} is missing")


def _fields(graph: GraphFile, line: int, tag: str, fields: list[str], ids: int, count: int) -> tuple[list[int], Array]:
    if len(fields) != ids + count:
        more = " (of matrices the upper triangle)" if len(fields) > ids + count else ""
        more += f"; as gtsam and iSAM write it, {tag} has two ids, a place or pose, and its noise" * (tag in TEXT)
        more += "".join(f"; {word!r} is no number" for word in fields if not is_number(word))[:LONG]
        raise graph.wrong(line, f"{tag} with {len(fields)} numbers; {ids + count} are needed{more}")
    keys = []
    for word in fields[:ids]:
        value = float(word) if is_number(word) else math.nan
        whole = word.isdecimal() and len(word) < LONG
        key = int(word) if whole else int(value) if 0.0 <= value <= LARGEST and value.is_integer() else -1
        if not 0 <= key < MOST_IDS:
            wanted = "an id, a whole number from 0 up" + f" and below {MOST_IDS}" * (key >= MOST_IDS)
            raise graph.wrong(line, f"{tag}: {word[:40]!r} is not {wanted}")
        keys.append(key)
    for word in fields[ids:]:
        value = float(word) if is_number(word) else math.nan
        if not abs(value) <= HUGE:
            wanted = f"a number of at most {HUGE:g}" if math.isfinite(value) else "a number"
            if is_number(point := word.replace(",", ".", 1)):
                wanted += f"; write a point: {point[:40]}"
            raise graph.wrong(line, f"{tag}: {word[:40]!r} is not {wanted}")
    return keys, np.array([float(f) for f in fields[ids:]])


def _prior(graph: GraphFile, line: int, tag: str, fields: list[str]) -> Edge:
    """A measured pose or position; of a pose in space whose rotation has no information, the position in the world."""
    measured, d = PRIORS[tag]
    count = measured + d * (d + 1) // 2
    sensor = tag == POSE_IN_SPACE and len(fields) != 1 + count
    keys, values = _fields(graph, line, tag, fields, 1 + sensor, count)
    key, offset = keys[0], keys[1] if sensor else -1
    if sensor and offset not in graph.offsets:
        raise graph.wrong(line, f"{tag}: no PARAMS_SE3OFFSET {offset}, the sensor's place on it")
    z, information = _pose(graph, line, tag, values[:measured]), symmetric(values[None, measured:])[0]
    A = IN_SPACE_AS.get(graph.space, np.eye(6))
    information = np.asarray(A.T @ information @ A) if d == 6 else information
    if d == 6 and not information[3:].any() and not (sensor and graph.offsets[offset][:3].any()):
        R = Rotation.from_quat(z[3:]).as_matrix()
        tag, z, information, offset = IN_SPACE, z[:3], R @ information[:3, :3] @ R.T, -1
    _require_definite(graph, line, tag, information)
    information = np.asarray(np.linalg.inv(information)) if graph.named else information
    return Edge(tag, (key, key), z, information, line, offset)


def _edge(graph: GraphFile, line: int, tag: str, fields: list[str]) -> Edge:
    measured, d, *_ = EDGES[tag]
    ids = LINES["ids"].get(tag, 2)
    entries = 2 if tag == "BR" else d * (d + 1) // 2
    bare = tag != "BR" and len(fields) == ids + measured
    keys, values = _fields(graph, line, tag, fields, ids, measured + entries * (not bare))
    origin = Origin.ASSUMED if bare else Origin.STATED
    edge = Edge(tag, (keys[0], keys[1]), _pose(graph, line, tag, values[:measured]), np.eye(d), line, origin=origin)
    if tag == "BR":
        stated = values[measured:]
        if not (stated > 0.0).all():
            raise graph.wrong(line, f"{tag}: sigma {stated.min():g} is not positive")
        edge = replace(edge, information=np.diag(1.0 / stated**2))
    elif not bare:
        edge = replace(edge, information=_stated(graph, edge, values[measured:]))
    if tag == "EDGE_SE3_TRACKXYZ":
        return replace(edge, parameter=keys[2])
    if d == 6 and graph.space:
        A = IN_SPACE_AS[graph.space]
        edge = replace(edge, information=np.asarray(A.T @ edge.information @ A), carried=np.linalg.inv(A))
    if tag in SWITCHED:
        return edge
    for key in keys[2:]:
        if key not in graph.offsets:
            raise graph.wrong(line, f"{tag}: no PARAMS_SE2OFFSET {key}, the sensor's place on the robot")
    return _of_robot(edge, [graph.offsets[key] for key in keys[2:]]) if keys[2:] else edge


def _stated(graph: GraphFile, edge: Edge, entries: Array) -> Array:
    """The information (d, d) that the entries of an edge's line state."""
    d, states = EDGES[edge.tag][1], graph.states(edge)
    if states == ROOT:
        root = np.triu(symmetric(entries[None])[0])
        if not np.diagonal(root).all():
            what = f"{edge.tag}: the root of its information has a zero on its diagonal; a triangle of full rank"
            raise graph.wrong(edge.line, f"{what} is needed")
        return np.asarray(root.T @ root)
    toro = edge.tag == "EDGE2" and not graph.rows
    matrix = symmetric((entries[TORO] if toro else entries)[None])[0]
    hint = ""
    if d == 3 and EDGES[edge.tag][2] == POSE2 and not toro and definite(symmetric(entries[None, TORO])).all():
        hint = "; it would be in Toro's order I11 I12 I22 I33 I13 I23, as of an EDGE2"
    tag = f"{edge.tag} {edge.ends[0]} {edge.ends[1]}"
    _require_definite(graph, edge.line, tag, matrix, hint, "covariance" * (states == COVARIANCE))
    return np.asarray(np.linalg.inv(matrix), float) if states == COVARIANCE else matrix


def _require_definite(graph: GraphFile, line: int, tag: str, matrix: Array, hint: str = "", name: str = "") -> None:
    if not definite(matrix[None]).all():
        value = float(np.linalg.eigvalsh(matrix)[0])
        what = f"{tag}: its {name or 'information matrix'} is not positive definite (least eigenvalue {value:.3g})"
        root = np.sqrt(np.maximum(np.diagonal(matrix), 0.0))
        most = np.outer(root, root)
        i, j = np.unravel_index(np.argmax(np.abs(matrix) - most), matrix.shape)
        if not hint and abs(matrix[i, j]) > most[i, j]:  # it stands in the wrong place, or its diagonal does
            hint = f"; entry ({i + 1}, {j + 1}) is {matrix[i, j]:g}, at most {most[i, j]:.4g} beside its diagonal"
        raise IndefiniteError(str(graph.wrong(line, what + (hint or "; all eigenvalues must be above 0"))))


def _of_robot(edge: Edge, offsets: list[Array]) -> Edge:
    """A measurement of sensors at `offsets` as one of the robot, with its error turned to first order."""
    c, s = math.cos(offsets[-1][2]), math.sin(offsets[-1][2])
    if len(offsets) == 1:
        A = np.array([[c, -s], [s, c]])
        z = offsets[0][:2] + A @ edge.measured
    else:
        A = np.array([[c, -s, offsets[1][1]], [s, c, -offsets[1][0]], [0.0, 0.0, 1.0]])
        z = compose(compose(offsets[0], edge.measured), inverse(offsets[1]))
    back = np.linalg.inv(A)
    return replace(edge, measured=z, information=np.asarray(back.T @ edge.information @ back), carried=A)


def _pose(graph: GraphFile, line: int, tag: str, values: Array) -> Array:
    """The values; a quaternion normalized, roll, pitch and yaw as a quaternion."""
    if len(values) == 7:
        norm = float(np.linalg.norm(values[3:]))
        if abs(norm - 1.0) > UNIT:
            raise graph.wrong(line, f"{tag}: quaternion of norm {norm:.6g}; 1 is needed (qx qy qz qw)")
        return np.concatenate([values[:3], values[3:] / norm])
    if len(values) == 6:
        (cr, cp, cy), (sr, sp, sy) = np.cos(values[3:] / 2), np.sin(values[3:] / 2)
        x, y, z = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
        return np.concatenate([values[:3], [x, y, z, cr * cp * cy + sr * sp * sy]])
    return values


def with_information(graph: GraphFile, information: dict[int, Array], left_out: set[int]) -> str:
    """The text of the graph with other information matrices of some edges, and without others, by number."""
    lines = list(graph.lines)
    for k, edge in enumerate(graph.edges):
        if k in left_out:
            lines[edge.line - 1] = f"# left out: {lines[edge.line - 1]}"
        elif k in information:
            words, plain = words_of(lines[edge.line - 1], plain=False), words_of(lines[edge.line - 1])
            measured, d, *_ = EDGES[tag := words[0]]
            keep = words[: len(words) - len(plain) + 1 + LINES["ids"].get(tag, 2) + measured]
            stated, states = information[k], graph.states(edge)
            if edge.carried is not None:
                stated = edge.carried.T @ stated @ edge.carried
            stated = stated if edge.whole is None else block_diag(stated, edge.whole[(n := len(stated)) :, n:])
            if states != INFORMATION:
                stated = np.asarray(np.linalg.inv(stated) if states == COVARIANCE else np.linalg.cholesky(stated).T)
            entries = stated[np.triu_indices(d)]
            if edge.tag == "BR":
                entries = 1.0 / np.sqrt(np.diagonal(information[k]))
            elif edge.tag == "EDGE2" and not graph.rows:
                entries = entries[np.argsort(TORO)]
            lines[edge.line - 1] = " ".join([*keep, *(repr(float(v)) for v in entries)])
    return "\n".join(lines) + "\n"
