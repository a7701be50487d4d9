"""Settings of a run besides the log: names of tasks, estimators and association methods, and their parameters.

Names are listed once, in the order of tables: of estimators in `ESTIMATOR_TABLE`, of association methods in
`association.names`. Imports nothing heavy, so that `--help` answers at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from association.names import METHOD_TABLE
from data.errors import UsageError
from data.motion.priors import AUTO, read_errors
from eval.replay.flag import positive, positive_or_none, probability, probability_or_auto, row, switch, text, whole

if TYPE_CHECKING:
    from data.inputs import Inputs, LandmarkMap, Prior, Systematic
    from data.pose_measurements import Closures, Fixes
    from data.result import Run
    from data.sensors import Sensor

SENSED_GATE = 0.9999
"""Default gate for labels read by a sensor: it loses one right observation in 10 000, and a misread barcode moves an
ungated estimate by decimetres. Chosen among gates from 0.99 to 0.99999 and robust losses (docs/results.md)."""

POSE_GATE = SENSED_GATE  # Default gate of fixes and closures: a false one, too, moves an ungated estimate by metres


@dataclass(frozen=True)
class Setup:
    """Gates are chi-square probabilities, None for no gate; spans are seconds (frames in a log without stamps).

    Example:
        >>> wide = slamref.Setup(gate=0.9999, new_gate=0.999999)
        >>> slamref.compare(log.inputs(), "slam", ["ekf"], "jcbb", wide)
    """

    gate: float | None = row(0.99, probability, "P")
    new_gate: float | None = row(0.99999, probability, "P")
    gate_known: float | Literal["auto"] | None = row("auto", probability_or_auto, "P")
    # apply the gate for labels to smoothers, too
    gate_smoothers: bool = row(True, switch)
    gate_poses: float | None = row(POSE_GATE, probability, "P")
    in_view: bool = row(False, switch)
    # association uses descriptors and classes, where the log has them
    appearance: bool = row(True, switch)
    maintain: bool = row(False, switch)
    maintain_by: str = row("", text("a FILE.py:NAME"), "FILE.py:NAME")
    forget_after: float | None = row(None, positive_or_none, "S")
    deactivate_after: float | None = row(None, positive_or_none, "S")
    lag: float = row(30.0, positive, "S")
    keyframe_distance: float = row(0.4, positive, "M")
    hypotheses: int = row(5, whole(1, "a whole number from 1 up is needed"), "N")
    calibrate: tuple[str, ...] = row((), read_errors, "NAMES", bare=AUTO)

    def __post_init__(self) -> None:
        for name in ("gate", "new_gate", "gate_known", "gate_poses"):
            if not isinstance(given := getattr(self, name), str | None):
                probability(name, given)

    def settled(self, sensed: bool) -> Setup:
        """The same with `auto` settled for a log with sensed labels or not."""
        return replace(self, gate_known=SENSED_GATE if sensed else None) if self.gate_known == "auto" else self

    @property
    def label_gate(self) -> float | None:
        """The gate of pairings by label; None while `auto` is not settled."""
        return None if isinstance(self.gate_known, str) else self.gate_known

    @property
    def manages_map(self) -> bool:
        """Whether landmarks may leave the map or the state."""
        return self.retracts or self.forget_after is not None or self.deactivate_after is not None

    @property
    def retracts(self) -> bool:
        """Whether landmarks may leave as if never seen."""
        return self.maintain or bool(self.maintain_by)


def check_gates(gate: float | None, new_gate: float | None, labels: tuple[str, str] = ("--gate", "--new-gate")) -> None:
    """The two-gate rule: the gate of new landmarks is not inside the one of pairings; None is no gate. Raises
    UsageError: an observation could be compatible with a landmark and start a new one at the same place.
    """
    if gate is not None and new_gate is not None and new_gate < gate:
        why = "or an observation compatible with a landmark could start another one"
        raise UsageError(f"{labels[1]} {new_gate}: must not be less than {labels[0]} {gate}, {why}")


TASKS = ("localization", "slam")


class EstimatorRow(NamedTuple):
    """One estimator of ours."""

    kind: str  # `reckoning`, `filter`, `incremental` or `batch`
    label: str  # in tables and figures
    colour: str  # colour, line, marker: in figures; `line` as of `eval.figures.style`
    line: str
    marker: str
    # of a filter: of its `FilterOptions`; of a batch smoother: its `loss`; of an incremental one: its `class`, and
    # whether this takes the `lag`
    options: Mapping[str, Any] = {}
    scans: bool = False  # whether it works on the key poses of scan matching, too


ISAM2 = {"class": "graph.incremental.Isam2Smoother"}
FIXED_LAG = {"class": "graph.fixed_lag.FixedLagSmoother", "lag": True}
ESTIMATOR_TABLE = {
    "dead-reckoning": EstimatorRow("reckoning", "dead reckoning", "#A6A6A6", "dotted", "x", scans=True),
    "ekf": EstimatorRow("filter", "EKF", "#D55E00", "solid", "o", scans=True),
    "ekf-iterated": EstimatorRow("filter", "iterated EKF", "#E69F00", "dashed", "p", {"iterations": 10}),
    "ekf-fej": EstimatorRow("filter", "first-estimates EKF", "#CC79A7", "dashdot", "^", {"first_estimates": True}),
    "ekf-invariant": EstimatorRow("filter", "invariant EKF", "#882255", "dashed", "v", {"invariant": True}),
    "isam2": EstimatorRow("incremental", "iSAM2", "#009E73", "solid", "D", ISAM2, scans=True),
    "fixed-lag": EstimatorRow("incremental", "fixed lag", "#999933", "long", "X", FIXED_LAG, scans=True),
    "batch": EstimatorRow("batch", "batch", "#0064A8", "solid", "s", {"loss": "gaussian"}, scans=True),
    "batch-huber": EstimatorRow("batch", "batch, Huber", "#56B4E9", "dashdotdot", "<", {"loss": "huber"}, scans=True),
    "batch-cauchy": EstimatorRow("batch", "batch, Cauchy", "#332288", "dashdot", ">", {"loss": "cauchy"}, scans=True),
    "gnc": EstimatorRow("batch", "GNC", "#117733", "long", "P", {"loss": "truncated"}, scans=True),
}
FILTERS, INCREMENTAL, BATCH = (
    tuple(name for name, e in ESTIMATOR_TABLE.items() if e.kind == kind) for kind in ("filter", "incremental", "batch")
)
STEPPING = (*FILTERS, *INCREMENTAL)
ESTIMATORS = tuple(ESTIMATOR_TABLE)
MHT = "mht"  # several hypotheses, of which the likeliest decides
HINDSIGHT = "jcbb-hindsight"  # decisions may be revised later (`eval.replay.hindsight`)
OF_SCANS = tuple(name for name, e in ESTIMATOR_TABLE.items() if e.scans)  # on loop closures of a laser log
ASSOCIATIONS = tuple(METHOD_TABLE)


def steps(name: str) -> bool:
    """Whether an estimator, ours or foreign, works frame by frame."""
    return name not in ESTIMATOR_TABLE or name in STEPPING


class Beginning(NamedTuple):
    """What an estimator knows before the first frame; a log states it in its `Inputs`, a robot alone in this."""

    prior: Prior  # belief about the pose at the first frame
    sensor: Sensor
    map: LandmarkMap | None = None  # None: SLAM
    systematic: Systematic | None = None  # errors to estimate
    fixes: Fixes | None = None
    closures: Closures | None = None
    sensors: tuple[Sensor, ...] = ()  # all of them where there are several, of which `sensor` is the first
    looks: tuple[int, int] = (0, 0)  # as of `Inputs.looks`


Given: TypeAlias = "Inputs | Beginning"


FIRST = ("known", "jcbb", "jcbb-first")  # association methods that come before all others


def associations(runs: Sequence[Run]) -> list[str]:
    """The association methods of some runs, those to be shown first in front: `known`, and those that are not ours."""
    given = list(dict.fromkeys(r.association for r in runs if r.association != "none"))
    first = (FIRST[0], *tuple(a for a in given if a not in ASSOCIATIONS), *FIRST[1:])
    return sorted(given, key=lambda a: first.index(a) if a in first else len(first))
