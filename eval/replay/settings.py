"""What a person chooses beside the log: the names of tasks, estimators and ways of association, and their settings.

Names are listed once, in the order of tables; whoever gives one of them a meaning (filter options, methods, losses) is
checked against these lists by a test. Imports nothing heavy, so that `--help` answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol

from data.errors import UsageError
from data.motion.priors import AUTO, read_errors
from eval.replay.flag import positive, positive_or_none, probability, probability_or_auto, row, share_or_none, switch

if TYPE_CHECKING:
    from data.inputs import LandmarkMap, Prior, Systematic
    from data.sensors import Sensor

SENSED_GATE = 0.9999
"""Gate for labels that a sensor read, where nobody says otherwise: one right reading in 10 000 is lost by it, and a
misread barcode puts an ungated estimate off by decimetres. Compared with gates from 0.99 to 0.99999 and with robust
losses on simulated logs with up to 5 % of wrong labels, and on recordings (docs/results.md)."""


@dataclass(frozen=True)
class Setup:
    """Gates are chi-square probabilities, None for no gate; spans are seconds (frames in a log without stamps).

    Attributes:
        gate: of the association methods' tests.
        new_gate: outside which of every landmark an observation may start a new one.
        gate_known: of pairings by label; `auto`: `SENSED_GATE` where a sensor read the labels, which can be misread,
            none where they are the truth (see `settled`). In a laser log that of the EKF's loop closures.
        gate_smoothers: what that gate leaves out is left out for the smoothers, too.
        in_view: the EKF offers only landmarks in range and view as candidates, as iSAM2 always does.
        maintain: remove landmarks seen once and more than two frames ago.
        forget_after: the EKF drops landmarks unseen for so long.
        deactivate_after: the EKF parks landmarks unseen for so long, and takes them back when they may be seen again.
        lag: a fixed-lag smoother keeps poses for so long.
        keyframe_distance: m between the key poses of a laser log.
        least_information: share of a key scan in what is known of the places it sees, below which its key pose leaves
            the graph.
        calibrate: systematic errors that are estimated with everything else, `NAME[=SIGMA]`, or `auto`: those that a
            log's residuals name, else all; empty: none.
    """

    gate: float | None = row(
        0.99,
        probability,
        "P",
        "chi-square probability of the association gate, or none (default: 0.99; known is not gated)",
    )
    new_gate: float | None = row(
        0.99999,
        probability,
        "P",
        "an observation starts a landmark only outside this gate of every other, which is not inside --gate (default: "
        "0.99999; the lab: 0.99; ml-ratio decides by itself)",
    )
    gate_known: float | Literal["auto"] | None = row(
        "auto",
        probability_or_auto,
        "P",
        f"gate for readings paired by label: a probability, none, or auto (default): {SENSED_GATE} where a sensor read "
        "the labels, else none; laser logs: of the EKF's loop closures",
    )
    gate_smoothers: bool = row(True, switch, "", "what the gate for labels leaves out, only filters leave out")
    in_view: bool = row(False, switch, "", "the EKF offers only landmarks in range and view")
    maintain: bool = row(False, switch, "", "SLAM: remove landmarks seen once and more than two frames ago")
    forget_after: float | None = row(
        None, positive_or_none, "S", "EKF-SLAM drops landmarks unseen for S seconds (frames without stamps)"
    )
    deactivate_after: float | None = row(
        None, positive_or_none, "S", "EKF-SLAM parks such landmarks, and takes them back when seen again"
    )
    lag: float = row(30.0, positive, "S", "fixed-lag keeps poses for S seconds (frames without stamps; default: 30)")
    keyframe_distance: float = row(0.4, positive, "M", "laser logs: a key pose every M metres (default: 0.4)")
    least_information: float | None = row(
        None,
        share_or_none,
        "SHARE",
        "laser logs: key poses whose scans have less than this share in what is known of the places they see leave the "
        "graph (default: none)",
    )
    calibrate: tuple[str, ...] = row(
        (),
        read_errors,
        "NAMES",
        "filters and smoothers estimate systematic errors of odometry and sensor along: NAME[=SIGMA],... of scale, "
        "curvature, left, right, drift, range, bearing (SIGMA: known so well before); alone or auto: those that the "
        "log's residuals name, else all with tight priors",
        bare=AUTO,
    )

    def settled(self, sensed: bool) -> Setup:
        """The same, `auto` settled for a log whose labels were sensed or not."""
        return replace(self, gate_known=SENSED_GATE if sensed else None) if self.gate_known == "auto" else self

    @property
    def label_gate(self) -> float | None:
        """The gate of pairings by label; none as long as `auto` is not settled."""
        return None if isinstance(self.gate_known, str) else self.gate_known

    @property
    def manages_map(self) -> bool:
        """Whether landmarks may leave the map or the state."""
        return self.maintain or self.forget_after is not None or self.deactivate_after is not None


def check_gates(gate: float | None, new_gate: float | None, labels: tuple[str, str] = ("--gate", "--new-gate")) -> None:
    """The two-gate rule: the gate of new landmarks is not inside the one of pairings; equal gates are the lab's.

    None is no gate: the second one is then outside of any, and without a first one there is nothing to be inside of.

    Raises:
        UsageError: an observation could be compatible with a landmark and start a new one at the same place.
    """
    if gate is not None and new_gate is not None and new_gate < gate:
        raise UsageError(
            f"{labels[1]} {new_gate}: must not be less than {labels[0]} {gate}, or an observation compatible with a "
            "landmark could start another one"
        )


TASKS = ("localization", "slam")
FILTERS = ("ekf", "ekf-iterated", "ekf-fej", "ekf-invariant")
INCREMENTAL = ("isam2", "fixed-lag")
STEPPING = (*FILTERS, *INCREMENTAL)
HINDSIGHT = "jcbb-hindsight"
"""The way of association whose decisions may be revised later (`eval.replay.hindsight`)."""
BATCH = ("batch", "batch-huber", "batch-cauchy", "gnc")
ESTIMATORS = ("dead-reckoning", *STEPPING, *BATCH)
ASSOCIATIONS = ("known", "nn", "ml", "ml-ratio", "singles", "jcbb", "jcbb-first", "gnn", HINDSIGHT, "scan")


def steps(name: str) -> bool:
    """Whether an estimator, ours or not, works frame by frame."""
    return name not in BATCH and name != "dead-reckoning"


class Given(Protocol):
    """Prior, sensor, for localization the map, and errors to estimate. `Inputs` has them, and so has a robot."""

    @property
    def prior(self) -> Prior:
        """Belief about the pose at the first frame."""
        ...

    @property
    def sensor(self) -> Sensor:
        """The measurement model."""
        ...

    @property
    def map(self) -> LandmarkMap | None:
        """Known landmarks; None: SLAM."""
        ...

    @property
    def systematic(self) -> Systematic | None:
        """Errors of odometry and sensor that are estimated along; None: there are none."""
        ...


class Beginning(NamedTuple):
    """Just that, without a log; fields as in `Given`."""

    prior: Prior
    sensor: Sensor
    map: LandmarkMap | None = None
    systematic: Systematic | None = None
