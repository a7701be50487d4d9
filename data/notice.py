"""A finding about a log or a run as typed values: code, severity, and the log or run it concerns.

A notice holds no sentence; `data.words` renders it for terminal, Markdown and HTML.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

Value = float | int | str | bool | tuple[float, ...] | tuple[int, ...] | tuple[str, ...] | None


class Severity(StrEnum):
    """Fact, warning, or reason not to use the result."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


class Code(StrEnum):
    """Every possible finding about a log or a run; `templates/notices.j2` holds their words."""

    # about a log, for its author
    MAP_ROWS = "map-rows"
    BAD_TRUTH = "bad-truth"
    TRUTH_RATE = "truth-rate"
    LABELS = "labels"
    LABEL_NAMES = "label-names"
    BEARING_UNIT = "bearing-unit"
    TURN_RATE = "turn-rate"
    TURN_RATES = "turn-rates"
    TIME_UNIT = "time-unit"
    MAX_RANGE = "max-range"
    FIELD_OF_VIEW = "field-of-view"
    PRIOR = "prior"
    TRUTH_FRAME = "truth-frame"
    INTEGRATION = "integration"
    MIRRORED = "mirrored"
    # about a laser log, for its author
    NO_ODOMETRY = "no-odometry"
    ODOMETRY_UNIT = "odometry-unit"
    HEADING_UNIT = "heading-unit"
    RANGE_UNIT = "range-unit"
    FEW_RETURNS = "few-returns"
    MOUNTING = "mounting"
    BEAM_ANGLES = "beam-angles"
    STAMPS_BACK = "stamps-back"
    STAMPS_BROKEN = "stamps-broken"
    # about a run: how it was made
    NOTE = "note"
    DECIDED_BY = "decided-by"
    OUT_OF_NODES = "out-of-nodes"
    NO_COVARIANCE = "no-covariance"
    NO_LANDMARKS = "no-landmarks"
    NIS_STATED = "nis-stated"
    NIS_UNCHECKED = "nis-unchecked"
    FILTER_ONLY = "filter-only"
    MAP_AS_EXACT = "map-as-exact"
    PARKED = "parked"
    NOT_PARKED = "not-parked"
    POSES_UNUSED = "poses-unused"
    REMOVED = "removed"
    OBSERVATIONS_REJECTED = "observations-rejected"
    AGAINST_WHEELS = "against-wheels"
    CHAIN_WIDENED = "chain-widened"
    CLOSURES_REFUSED = "closures-refused"
    DOUBLED_WALLS = "doubled-walls"
    BEYOND_CLAIMS = "beyond-claims"
    SIZES_DISAGREE = "sizes-disagree"
    TOO_MANY_KEYS = "too-many-keys"
    CLOSURES_GATED = "closures-gated"
    CLOSURES_REJECTED = "closures-rejected"
    CLOSURES_LOST = "closures-lost"
    CORNERS = "corners"
    READ_FROM = "read-from"
    MATCHED = "matched"
    TIME_OFFSET = "time-offset"
    NO_TRUTH = "no-truth"
    ALIGNED = "aligned"
    LANDMARKS_GONE = "landmarks-gone"
    # about the files of a result and its truth
    TILT = "tilt"
    PARTLY_KNOWN = "partly-known"
    FRAMES_DIFFER = "frames-differ"
    PATH_AXES = "path-axes"
    PATH_TURNS = "path-turns"
    PATH_DEGREES = "path-degrees"
    PATH_SWAPPED = "path-swapped"
    PATH_ORDER = "path-order"
    PATH_SCALE = "path-scale"
    PATH_TILT = "path-tilt"
    PATH_MIRRORED = "path-mirrored"
    # about a run of hindsight
    LARGER_SIGMAS = "larger-sigmas"
    REVISED = "revised"
    REVISED_POSES = "revised-poses"
    REASSOCIATED_AT_END = "reassociated-at-end"
    NO_REASSOCIATION = "no-reassociation"
    MERGED = "merged"
    MOVED_UNSEEN = "moved-unseen"
    FOUND_AGAIN = "found-again"
    PLACED = "placed"
    MAP_RESTARTED = "map-restarted"
    RETRACTED = "retracted"
    MAP_FOLDED = "map-folded"
    PLAIN_LIKELIER = "plain-likelier"
    # diagnostics of a run
    COST = "cost"
    LABELS_LEFT_OUT = "labels-left-out"
    UNUSED = "unused"
    LANDMARKS = "landmarks"
    AMBIGUOUS = "ambiguous"
    DOUBLE = "double"
    TWO_MINIMA = "two-minima"
    DISPUTED = "disputed"
    NAMING = "naming"
    SOURCE_UNUSED = "source-unused"
    SOURCE_NIS = "source-nis"
    SOURCE_REJECTED = "source-rejected"
    SOURCE_OUTLIERS = "source-outliers"
    # implausible, and where it began
    NIS = "nis"
    PATH_TOO_FAR = "path-too-far"
    LANDMARKS_TOO_FAR = "landmarks-too-far"
    LANDMARKS_UNSEEN = "landmarks-unseen"
    COVARIANCE_TOO_LARGE = "covariance-too-large"
    ORIGIN = "origin"
    # lost
    HARDLY_USED = "hardly-used"
    UNPAIRED = "unpaired"
    MISSED = "missed"
    TEN_SIGMA = "ten-sigma"
    BY_CHANCE = "by-chance"
    # missing results
    STOPPED = "stopped"
    FRONT_END_STOPPED = "front-end-stopped"
    OUT_OF_MEMORY = "out-of-memory"
    MISSING = "missing"
    # consistency without ground truth, and twins
    EXACT_PRIOR = "exact-prior"
    NOT_MEASURED = "not-measured"
    NOT_MEASURED_ON_TWINS = "not-measured-on-twins"
    STOOD_IN = "stood-in"
    NO_TWINS = "no-twins"
    TOO_FEW_TWINS = "too-few-twins"


QUESTIONS = frozenset(
    {
        Code.FRAMES_DIFFER,
        Code.PATH_AXES,
        Code.PATH_TURNS,
        Code.PATH_DEGREES,
        Code.PATH_SWAPPED,
        Code.PATH_ORDER,
        Code.PATH_SCALE,
        Code.PATH_TILT,
        Code.PATH_MIRRORED,
    }
)
"""Findings about the files of a result that the user has to answer."""


@dataclass(frozen=True)
class Notice:
    """A finding about a log or a run: code, values, severity, and what it concerns.

    Attributes:
        code: kind of finding.
        values: pairs of name and value, sorted by name (`named`: as a mapping).
        severity: fact, warning, or reason not to use the result.
        log, task, estimator, association: names; blank: not specific.
        frame: first frame concerned; None: not specific.

    Example:
        >>> [n.code for n in slamref.notices([trial]) if n.severity != "info"]
        >>> slamref.sentence(slamref.notices([trial])[0])  # in words
    """

    code: Code
    values: tuple[tuple[str, Value], ...] = ()
    severity: Severity = Severity.WARNING
    log: str = ""
    task: str = ""
    estimator: str = ""
    association: str = ""
    frame: int | None = None

    @property
    def named(self) -> Mapping[str, Value]:
        """Values by name."""
        return dict(self.values)

    def about(
        self,
        *,
        log: str | None = None,
        task: str | None = None,
        estimator: str | None = None,
        association: str | None = None,
        frame: int | None = None,
    ) -> Notice:
        """The same about a named log, task or run, or from a frame on; None keeps the value."""
        given = {"log": log, "task": task, "estimator": estimator, "association": association, "frame": frame}
        return replace(self, **{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]


def notice(code: Code, severity: Severity = Severity.WARNING, frame: int | None = None, **values: Value) -> Notice:
    """A notice with values by name."""
    return Notice(code, tuple(sorted(values.items())), severity, frame=frame)


def stopped(text: str) -> Notice:
    """The notice of an estimator stopped by an error, with its message."""
    return notice(Code.STOPPED, Severity.ERROR, text=text)
