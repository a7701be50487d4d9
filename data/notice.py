"""A finding about a log or a run as typed values, without a sentence: `data.words` renders it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

Value = float | int | str | bool | tuple[float, ...] | tuple[int, ...] | tuple[str, ...] | None


class Severity(StrEnum):
    """Fact, warning, or reason not to use the result."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


INFO, WARNING, ERROR = Severity


class Code(StrEnum):
    """Every possible finding about a log or a run, with its severity; `templates/notices.j2` holds their words.
    Warnings are what a person must act on, errors are reasons not to use a result, all else is a fact.
    """

    severity: Severity

    def __new__(cls, name: str, severity: Severity) -> Code:
        """A member whose value is the name alone."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.severity = severity
        return member

    # about a log, for its author
    CONTRADICTION = "contradiction", WARNING
    MAP_ROWS = "map-rows", WARNING
    BAD_TRUTH = "bad-truth", WARNING
    TRUTH_RATE = "truth-rate", WARNING
    LABELS = "labels", WARNING
    TIME_UNIT = "time-unit", WARNING
    MAX_RANGE = "max-range", WARNING
    FIELD_OF_VIEW = "field-of-view", WARNING
    PRIOR = "prior", WARNING
    TRUTH_FRAME = "truth-frame", WARNING
    # about a laser log, for its author
    NO_ODOMETRY = "no-odometry", WARNING
    ODOMETRY_UNIT = "odometry-unit", WARNING
    HEADING_UNIT = "heading-unit", WARNING
    FEW_RETURNS = "few-returns", WARNING
    FEW_BEAMS = "few-beams", WARNING
    MOUNTING = "mounting", WARNING
    BEAM_ANGLES = "beam-angles", WARNING
    STAMPS_BACK = "stamps-back", WARNING
    STAMPS_BROKEN = "stamps-broken", WARNING
    # about a run: how it was made
    NOTE = "note", INFO
    ASSUMED_NOISE = "assumed-noise", INFO
    DECIDED_BY = "decided-by", INFO
    BEGAN_ASTRAY = "began-astray", WARNING
    OBSERVATIONS_UNUSED = "observations-unused", WARNING
    OUT_OF_NODES = "out-of-nodes", WARNING
    NO_COVARIANCE = "no-covariance", INFO
    NO_LANDMARKS = "no-landmarks", INFO
    NIS_STATED = "nis-stated", WARNING
    NIS_UNCHECKED = "nis-unchecked", WARNING
    FILTER_ONLY = "filter-only", INFO
    MAP_AS_EXACT = "map-as-exact", INFO
    PARKED = "parked", INFO
    NOT_PARKED = "not-parked", INFO
    POSES_UNUSED = "poses-unused", WARNING
    REMOVED = "removed", INFO
    OBSERVATIONS_REJECTED = "observations-rejected", INFO
    AGAINST_WHEELS = "against-wheels", WARNING
    WHEELS_SCALE = "wheels-scale", WARNING
    WHEELS_TURN = "wheels-turn", WARNING
    SCANS_JUMP = "scans-jump", WARNING
    CHAIN_WIDENED = "chain-widened", INFO
    CLOSURES_REFUSED = "closures-refused", WARNING
    DOUBLED_WALLS = "doubled-walls", WARNING
    WAY_UNOBSERVED = "way-unobserved", WARNING
    WAY_BY_ODOMETRY = "way-by-odometry", INFO
    BEYOND_CLAIMS = "beyond-claims", WARNING
    CORNERS = "corners", INFO
    READ_FROM = "read-from", INFO
    MATCHED = "matched", INFO
    COVERAGE = "coverage", INFO
    TRACK_LOST = "track-lost", INFO
    TIME_OFFSET = "time-offset", INFO
    NO_TRUTH = "no-truth", INFO
    ALIGNED_FIRST = "aligned-first", INFO
    QUATERNION_ORDER = "quaternion-order", INFO
    INVERSE_POSES = "inverse-poses", INFO
    ALIGNED = "aligned", INFO
    LANDMARKS_GONE = "landmarks-gone", WARNING
    # about the files of a result and its truth
    TILT = "tilt", INFO
    FRAMES_DIFFER = "frames-differ", WARNING
    PATH_AXES = "path-axes", WARNING
    PATH_READING = "path-reading", WARNING
    PATH_SWAPPED = "path-swapped", WARNING
    PATH_ORDER = "path-order", WARNING
    PATH_TILT = "path-tilt", WARNING
    PATH_CLOCK = "path-clock", WARNING
    PATH_SHIFT = "path-shift", WARNING
    PATH_LEAP = "path-leap", WARNING
    PATH_OUTLIERS = "path-outliers", INFO
    PATH_FRAME = "path-frame", WARNING
    PATH_DRIFT = "path-drift", INFO
    PATH_QUATERNIONS = "path-quaternions", WARNING
    # about a run of hindsight
    LARGER_SIGMAS = "larger-sigmas", WARNING
    REVISED = "revised", INFO
    REVISED_POSES = "revised-poses", INFO
    REASSOCIATED_AT_END = "reassociated-at-end", INFO
    NO_REASSOCIATION = "no-reassociation", WARNING
    MERGED = "merged", INFO
    MOVED_UNSEEN = "moved-unseen", INFO
    FOUND_AGAIN = "found-again", INFO
    PLACED = "placed", WARNING
    MAP_RESTARTED = "map-restarted", WARNING
    RETRACTED = "retracted", WARNING
    MAP_FOLDED = "map-folded", WARNING
    PLAIN_LIKELIER = "plain-likelier", INFO
    # diagnostics of a run
    COST = "cost", WARNING
    LABELS_LEFT_OUT = "labels-left-out", WARNING
    UNUSED = "unused", WARNING
    LANDMARKS = "landmarks", WARNING
    AMBIGUOUS = "ambiguous", INFO
    TWO_MINIMA = "two-minima", INFO
    DISPUTED = "disputed", WARNING
    NAMING = "naming", INFO
    SOURCE_UNUSED = "source-unused", WARNING
    SOURCE_NIS = "source-nis", WARNING
    SOURCE_REJECTED = "source-rejected", WARNING
    SOURCE_OUTLIERS = "source-outliers", WARNING
    # implausible, and where it began
    NIS = "nis", ERROR
    PATH_TOO_FAR = "path-too-far", ERROR
    LANDMARKS_TOO_FAR = "landmarks-too-far", ERROR
    LANDMARKS_UNSEEN = "landmarks-unseen", ERROR
    COVARIANCE_TOO_LARGE = "covariance-too-large", ERROR
    ORIGIN = "origin", INFO
    # lost
    HARDLY_USED = "hardly-used", ERROR
    UNPAIRED = "unpaired", ERROR
    MISSED = "missed", ERROR
    TEN_SIGMA = "ten-sigma", ERROR
    BY_CHANCE = "by-chance", ERROR
    # missing results
    STOPPED = "stopped", ERROR
    FRONT_END_STOPPED = "front-end-stopped", ERROR
    OUT_OF_MEMORY = "out-of-memory", ERROR
    MISSING = "missing", ERROR
    # consistency without ground truth, and twins
    EXACT_PRIOR = "exact-prior", INFO
    NOT_MEASURED = "not-measured", INFO
    NOT_MEASURED_ON_TWINS = "not-measured-on-twins", INFO
    STOOD_IN = "stood-in", INFO
    NO_TWINS = "no-twins", INFO
    TOO_FEW_TWINS = "too-few-twins", INFO


@dataclass(frozen=True)
class Notice:
    """A finding about a log or a run: code, values, and what it concerns.

    Example:
        >>> [n.code for n in slamref.notices([trial]) if n.severity != "info"]
        >>> slamref.sentence(slamref.notices([trial])[0])  # in words
    """

    code: Code  # kind of finding
    values: tuple[tuple[str, Value], ...] = ()  # pairs of name and value, sorted by name (`named`: as a mapping)
    log: str = ""  # name, as of the next three; blank: not specific
    task: str = ""
    estimator: str = ""
    association: str = ""
    frame: int | None = None  # first frame concerned; None: not specific

    @property
    def severity(self) -> Severity:
        """Fact, warning, or reason not to use the result."""
        return self.code.severity

    @property
    def named(self) -> Mapping[str, Value]:
        """Values by name."""
        return dict(self.values)

    @property
    def run(self) -> tuple[str, str, str, str]:
        """Log, task, estimator and association."""
        return self.log, self.task, self.estimator, self.association

    def about(self, **of: Any) -> Notice:
        """The same about a named log, task, estimator or association, or from a frame on; None keeps the value."""
        return replace(self, **{name: value for name, value in of.items() if value is not None})


def ordered(found: Iterable[Notice]) -> list[Notice]:
    """Each notice once: errors, warnings, facts; otherwise as they come."""
    return sorted(dict.fromkeys(found), key=lambda n: list(Severity).index(n.severity), reverse=True)


def notice(code: Code, frame: int | None = None, **values: Value) -> Notice:
    """A notice with values by name."""
    return Notice(code, tuple(sorted(values.items())), frame=frame)


def stopped(text: str) -> Notice:
    """The notice of an estimator stopped by an error, with its message."""
    return notice(Code.STOPPED, text=text)
