"""The classic UTIAS tutorials on Dataset 1, robot 1, as their programs compute them, beside our estimators.

`python -m tests.research.tutorials MRCLAM_Dataset1.zip Landmark_Groundtruth.dat` prints a row for each run. The file of
landmarks is the corrected one, with which the original programs gave `original` in Octave 7 (with barcodes read as
numbers, `%f` for `%u`, as in MATLAB). What they do otherwise than the algorithms that they teach is done here, too:

* A frame moves with the odometry at its own instant, which is interpolated across gaps; frames are 0.02 s apart.
* Steps 1, 3, 4 leave out 599 frames "because earlier data was found to cause problems". Step 2 starts at the first true
  pose; the first odometry row is taken to hold until it comes (9.48 s).
* Their first frame moves, too, from the first true pose.
* All nine entries of the prior covariance are equal, a singular matrix (not in step 2).
* Steps 1 and 3 do not use a frame whose first observation is of landmark 6, their number 1.
* Step 1 forms the gain with the covariance from before the prediction.
* Step 4 takes for the second best candidate the running minimum's predecessor, which depends on the order of the map.

Not done: their bearing innovation is not wrapped, which changes nothing here. Step 2 multiplies likelihoods, which
underflow far from every landmark; here their logarithms are compared. Their last frame has no ground truth and is
compared with (0, 0), which adds 3.6, 14, 2.5 and 3.0 m^2; `original` is without it. Step 3 reads its landmark errors
one entry too early.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits

from association.decide import Decided
from association.expectation import Expectation
from association.methods import ALPHA, RATIO
from data.command import Parser
from data.csv_table import Table
from data.formats import mrclam
from data.formats.mrclam import Calibration, Files, Treatment, load_mrclam
from data.inputs import Frame, FrameObservations, Increment, IntArray, Prior
from data.log import Log
from data.motion.velocity import MAX_HOLD, VelocityModel, VelocityNoise, carried
from data.result import DISCARD, NEW, Run, Updated
from data.se2 import Array, wrap_angle
from ekf.filter import DEFAULT, FilterOptions
from ekf.localizer import EkfLocalizer
from eval.referee.score import metrics_row
from eval.replay.frontend import FrontEnd
from eval.replay.run import compare, driven
from eval.replay.settings import Setup

FARTHEST = 10.0  # initial squared distance of the running minimum
GRID, START = 0.02, 11.98  # s: of frames, and of 599 of them


@dataclass(frozen=True)
class Tutorial:
    name: str
    task: str
    alphas: tuple[float, float, float, float]  # of the control noise, convention `displacement`
    sigma: tuple[float, float]  # of range [m] and bearing [rad]
    prior: Array  # (3, 3) covariance
    original: tuple[float, float]  # sum of squared position errors [m^2], position RMSE [m]
    association: str = "known"
    start: float | None = START  # s after the first true pose
    skip_led_by: int | None = None
    options: FilterOptions = DEFAULT


FULL = np.ones((3, 3))
NOISE, SLAM = (0.2, 0.03, 0.09, 0.08), (0.1, 0.01, 0.18, 0.08)
STEPS = {
    1: Tutorial(
        "EKF localization", "localization", NOISE, (2.0, 3.0), 0.01 * FULL, (1854.026, 0.157865), skip_led_by=6
    ),
    2: Tutorial(
        "the same, unknown labels", "localization", NOISE, (0.43, 0.6), 0.01 * np.eye(3), (101128.9, 1.161246), "ml",
        None,
    ),
    3: Tutorial(
        *("EKF-SLAM", "slam", SLAM, (11.8**0.5, 0.18**0.5), 0.001 * FULL, (14968.6, 0.448559)),
        skip_led_by=6,
        options=FilterOptions(new_variance=10.0),
    ),
    4: Tutorial(
        *("the same, unknown labels", "slam", (0.11, *SLAM[1:]), (11.7**0.5, 0.18**0.5), 0.001 * FULL),
        (197435.4, 1.629073), "ml-ratio", options=FilterOptions(new_variance_per_square=1.0 / 130.0),
    ),
}  # fmt: skip


class GainFromBefore(EkfLocalizer):
    """EKF localization with the gain P- H' S^-1 of the covariance before the prediction, though S is of that after."""

    def predict(self, increment: Increment) -> None:
        self._version += 1
        self._before = self._P[:3, :3].copy()
        wx, wy, F, B = carried(self._mean[2], increment.mean)
        self._P[:3, :3] = F @ self._P[:3, :3] @ F.T + B @ increment.covariance @ B.T
        self._mean[:2] += wx, wy
        self._mean[2] = wrap_angle(float(self._mean[2] + increment.mean[2]))

    def _updated(
        self, observations: FrameObservations, decisions: IntArray, at: IntArray, known: Array, threshold: float,
        pose: Array | None,
    ) -> Updated:  # fmt: skip
        self._version += 1
        stats, white = np.zeros(3), np.full((len(decisions), 2), np.nan)
        for row in np.flatnonzero(decisions >= 0).tolist():
            z_hat, Hx, _ = (a[0] for a in self.sensor.linearize(self._mean[:3], known[row : row + 1]))
            nu = self.sensor.residual(observations.z[row], z_hat)
            S = Hx @ self._P[:3, :3] @ Hx.T + observations.R[row]
            K = self._before @ Hx.T @ np.linalg.inv(S)
            white[row] = np.linalg.solve(np.linalg.cholesky(0.5 * (S + S.T)), nu)
            nis = float(white[row] @ white[row])
            stats += nis, -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1]), 2.0
            self._mean[:3] += K @ nu
            self._mean[2] = wrap_angle(float(self._mean[2]))
            self._P[:3, :3] = (np.eye(3) - K @ Hx) @ self._P[:3, :3]
        created = np.full(len(decisions), -1, np.int64)
        return Updated(decisions >= 0, created, float(stats[0]), int(stats[2]), float(stats[1]), white)


class RunningMinimum(FrontEnd):
    """Ratio test against the previous running minimum instead of the second best candidate; map order matters."""

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions with the running minimum, or with another method for comparison."""
        return super().decide(expectation, method) if method is not None else Decided(running(expectation), True)


def running(expectation: Expectation) -> IntArray:
    """Decisions (m,) over the landmarks in order of creation, then "new" at `ALPHA`."""
    e = expectation.by_age()
    d2 = np.column_stack([e.individual_distances(), np.full(len(e.z), ALPHA)])
    number = np.append(e.number, NEW)
    decisions = np.full(len(d2), DISCARD, np.int64)
    for i, row in enumerate(d2.tolist()):
        best, second, winner = FARTHEST, FARTHEST, DISCARD
        for squared, candidate in zip(row, number.tolist(), strict=True):
            if squared < best:
                best, second, winner = squared, best, candidate
        if second > RATIO * best:
            decisions[i] = winner
    return decisions


def at_own_instants(at: Array, odometry: Array, first: float, last: float, grid: float, motion: VelocityModel) -> Any:
    """As `mrclam.lay_out`, with the velocity of each frame at its own instant, interpolated across gaps."""
    time = first + grid * np.arange(int((last - first) / grid + 1e-9) + 1)
    own = [np.interp(time + GRID, odometry[:, 0], v) for v in odometry[:, 1:].T]
    return LAY_OUT(at, np.column_stack([time, *own]), first, last, grid, motion)


def from_the_truth_on(files: Files, name: str, columns: tuple[str, ...]) -> Table:
    """As `mrclam._stamped`; the first row of the odometry holds from the first true pose on."""
    table = STAMPED(files, name, columns)
    if "Odometry" not in name:
        return table
    rows, truth = table.all(), STAMPED(files, name.replace("Odometry", "Groundtruth"), ("x", "y", "orientation")).all()
    earlier = np.arange(truth[0, 0], rows[0, 0], 0.5 * MAX_HOLD)
    rows = np.pad(rows, ((len(earlier), 0), (0, 0)), mode="edge")
    rows[: len(earlier), 0] = earlier
    return replace(table, columns=dict(zip(table.columns, rows.T, strict=True)))


LAY_OUT, STAMPED = mrclam.lay_out, mrclam._stamped


def without_frames_led_by(landmark: int | None, log: Log) -> Log:
    """The log without observations of frames whose first one is of this landmark."""
    o, true_id = log.recorded.observations, log.truth.landmark_of
    assert true_id is not None
    kept = true_id[np.searchsorted(o.frame, o.frame)] != landmark
    recorded = replace(log.recorded, observations=o.only(kept))
    return replace(log, recorded=recorded, truth=replace(log.truth, landmark_of=true_id[kept]))


def recorded(step: int, source: Path, landmarks: Path | None) -> Log:
    t = STEPS[step]
    motion = VelocityModel(VelocityNoise("displacement", alphas=t.alphas), "half_angle")
    calibration = replace(Calibration().with_sigma(*t.sigma), motion=motion)
    treatment = Treatment(start=t.start, landmarks=landmarks, grid=GRID, calibration=calibration)
    with patch.object(mrclam, "lay_out", at_own_instants), patch.object(mrclam, "_stamped", from_the_truth_on):
        log = without_frames_led_by(t.skip_led_by, load_mrclam(source, 1, treatment))
    r = log.recorded  # their first frame moves from the first true pose, too, by odometry that is the next frame's
    u, M = r.increments.mean[1], r.increments.covariance[1]
    wx, wy, F, B = carried(r.prior.mean[2], u)
    prior = Prior(r.prior.mean + [wx, wy, u[2]], F @ t.prior @ F.T + B @ M @ B.T)
    return replace(log, recorded=replace(r, prior=prior))


def run(step: int, log: Log) -> Run:
    t = STEPS[step]
    inputs = log.inputs(labels=t.association == "known")
    if t.task == "slam":
        inputs = inputs.without_map()
    with threadpool_limits(1):  # as in `eval.replay.run.compare`
        setup = Setup(gate=None, new_gate=None, gate_known=None)
        kind = RunningMinimum if step == 4 else FrontEnd
        front = kind("ekf", t.association, inputs, setup, t.options)
        if step == 1:
            assert inputs.map is not None
            front.estimator = GainFromBefore(inputs.prior, inputs.sensor, inputs.map, t.options)
        with patch.object(Frame, "by_sensor", one_by_one):
            return driven("ekf", front, inputs, t.task)


def one_by_one(frame: Frame) -> list[Frame]:
    """Each observation is decided about and used before the next one."""
    return [frame.part(slice(i, i + 1)) for i in range(len(frame.observations.z))]


def row_of(name: str, found: Run, log: Log, original: tuple[float, float] | None = None) -> str:
    row = metrics_row(found, found.phases[-1], log, None)
    cells = [float(row[c]) for c in ("rmse_position_m", "rmse_heading_deg", "rmse_landmark_m", "sse_position_m2")]
    theirs = "" if original is None else f"{original[1]:.4f} ({1e3 * (cells[0] - original[1]):+.2f} mm)"
    squares = "" if original is None else f"{original[0]:.0f}"
    return f"| {name} | {cells[0]:.4f} | {theirs} | {cells[1]:.1f} | {cells[2]:.3f} | {cells[3]:.0f} | {squares} |"


def table(source: Path, landmarks: Path) -> Iterator[str]:
    yield "| run | position RMSE [m] | original | heading [°] | landmarks [m] | Σ e² [m²] | original |"
    for step, t in STEPS.items():
        log = recorded(step, source, landmarks)
        yield row_of(f"step {step}, {t.name}", run(step, log), log, t.original)
    log = load_mrclam(source, 1, Treatment(landmarks=landmarks))
    for task in ("localization", "slam"):
        for found in compare(log.inputs(labels=True), task, ("ekf", "batch")):
            yield row_of(f"our {found.estimator}, {task}", found, log)


def main() -> None:
    p = Parser(prog="python -m tests.research.tutorials", description="The classic UTIAS tutorials beside ours.")
    p.add_argument("source", type=Path, metavar="MRCLAM_Dataset1.zip")
    p.add_argument("landmarks", type=Path, metavar="Landmark_Groundtruth.dat", help="the corrected landmarks")
    given = p.parse_args()
    for line in table(given.source, given.landmarks):
        print(line, flush=True)


if __name__ == "__main__":
    main()
