"""Assignment `utias`: the steps of the classic tutorials, asked along a recording in the MRCLAM format."""

import math
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from association.expectation import Expectation
from association.methods import ml, nn
from data.formats import mrclam
from data.inputs import FrameObservations, Inputs, LandmarkMap, Prior
from data.motion.velocity import ARC, MODELS, step
from data.result import NEW
from data.se2 import Array
from data.sensors import RangeBearing
from eval.checks.exactness import Bug, Kalman, Rules, rules_of
from eval.replay.settings import Beginning
from wings.grade.parts import Answer, Mistakes, Question, Seeds, asked

SENSOR = RangeBearing()
SIGMA = np.array([0.03, 0.06])  # m and rad per sqrt(s), of the odometry
RIGHT = Rules()
P0 = np.diag([0.05, 0.05, 0.05]) ** 2
LESS_SURE = np.diag([1.5, 1.5, 0.4]) ** 2  # in questions of which landmark it is
SAMPLES = 400  # of the odometry, in a stretch of a recording
STEP, SECONDS = 0.1, 40.0  # s, of a simulated recording


def write_dataset(folder: Path, seed: int) -> Path:
    """A simulated recording of robot 1 in the MRCLAM format: 15 landmarks, odometry at 10 Hz, an image a second."""
    rng, n = np.random.default_rng([seed, 0x071A5]), round(SECONDS / STEP)
    xy, t = rng.uniform(-5.0, 5.0, (15, 2)), STEP * np.arange(n)
    v, omega = 0.4 + 0.1 * np.sin(0.3 * t), 0.35 + 0.2 * np.sin(0.17 * t + seed)
    noisy = np.stack([v, omega], 1) + SIGMA / math.sqrt(STEP) * rng.standard_normal((n, 2))
    pose, truth, seen = np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]), [], list[tuple[float, ...]]()
    for k in range(n):
        truth.append((t[k], *pose))
        z = SENSOR.predict(pose, xy) + rng.normal(size=(15, 2)) * (0.15, 0.1)
        if k % 10 == 5:
            seen += [(t[k], 21 + i, *z[i]) for i in range(15) if 0.3 < z[i, 0] < 6.0 and abs(z[i, 1]) < 0.7]
        pose = moved(pose, P0, v[k], omega[k], STEP, SIGMA)[0]
    number, own = np.arange(20), [mrclam.robot_file(1, what) for what in ("Groundtruth", "Odometry", "Measurement")]
    survey = np.column_stack([number[5:] + 1, xy, np.full((15, 2), 1e-4)])
    tables: tuple[Any, ...] = np.stack([1 + number, 16 + number], 1), survey, truth, np.column_stack([t, noisy]), seen
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in zip((mrclam.BARCODES, mrclam.LANDMARKS, *own), tables, strict=True):
        lines = (" ".join(f"{x:.6f}".rstrip("0").rstrip(".") for x in row) for row in rows)
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def kalman(pose: Array, P: Array, xy: Array | None, rules: Rules) -> Kalman:
    """The exact filter with rules at a pose, with landmarks (n, 2) or none."""
    known = None if xy is None else LandmarkMap(np.arange(len(xy)), xy)
    return Kalman(cast(Inputs, Beginning(Prior(pose, P), SENSOR, known)), rules)


def moved(pose: Array, P: Array, v: float, w: float, dt: float, s: Array, rules: Rules = RIGHT, m: int = ARC) -> Answer:
    """Pose and covariance after v [m/s], w [rad/s] held for dt [s], with noise s (m, rad per sqrt(s))."""
    mean, G = np.empty(3), np.empty((3, 2))
    step(m, v * dt, w * dt, mean, G)
    f = kalman(pose, P, None, rules)
    f.predict(mean, G @ np.diag(np.square(s) * dt) @ G.T)
    return f.x[:3], f.P[:3, :3]


def corrected(pose: Array, P: Array, landmark: Array, z: Array, R: Array, rules: Rules = RIGHT) -> Answer:
    """Pose and covariance after one observation z (2,) with R (2, 2) of a landmark (2,)."""
    f = kalman(pose, P, landmark[None], rules)
    f.update(FrameObservations(z[None], R[None]), np.array([0]))
    return f.x[:3], f.P[:3, :3]


def likeliest(pose: Array, P: Array, landmarks: Array, z: Array, R: Array, rules: Rules = RIGHT, f: Any = ml) -> Answer:
    """The row of the landmark (n, 2) that an observation is of, by maximum likelihood."""
    e = kalman(pose, P, landmarks, rules).expect(FrameObservations(z[None], R[None]))
    return (np.asarray(f(Expectation.from_arrays(z[None], e.z_hat, e.joint, rules.R(R[None]), SENSOR.residual), None)),)


def initialized(pose: Array, P: Array, z: Array, R: Array, rules: Rules = RIGHT) -> Answer:
    """A new landmark (2,), its covariance (2, 2), and that with the pose (2, 3)."""
    f = kalman(pose, P, None, rules)
    f.update(FrameObservations(z[None], R[None]), np.array([NEW]))
    return f.x[3:], f.P[3:, 3:], f.P[3:, :3]


FUNCTIONS: tuple[Callable[..., Answer], ...] = moved, corrected, likeliest, initialized
REFERENCES = dict(zip(("move", "correct", "correspond", "initialize"), FUNCTIONS, strict=True))


@lru_cache(maxsize=2)
def recorded(seeds: Seeds) -> dict[str, list[Question]]:
    """Questions by part along stretches of recordings: simulated ones, or those of a data set, by seed."""
    out: dict[str, list[Question]] = {name: [] for name in REFERENCES}
    for seed in seeds.seeds:
        with tempfile.TemporaryDirectory() as folder:
            source = seeds.data or write_dataset(Path(folder) / f"utias_{seed}", seed)
            _along(source, seed, mrclam.FROZEN if seeds.data else mrclam.Calibration(), out)
    return out


def _along(source: Path, seed: int, calibration: mrclam.Calibration, out: dict[str, list[Question]]) -> None:
    """Add the questions of a stretch; the seed chooses the robot and where it begins."""
    files, rng = mrclam.open_files(source), np.random.default_rng(seed)
    robot = int(rng.choice(files.robots()))

    def table(name: str, columns: str) -> Array:
        return mrclam.parse(files.path(name), files.content(name), tuple(columns.split())).all()

    survey = mrclam.read_landmarks(files, mrclam.corrected_landmarks(source))
    subject = {int(code): int(who) for who, code in table(mrclam.BARCODES, "subject barcode")}
    kinds = {"Odometry": "v omega", "Measurement": "barcode range bearing", "Groundtruth": "x y heading"}
    odometry, seen, truth = (table(mrclam.robot_file(robot, kind), f"time {kinds[kind]}") for kind in kinds)
    least = int(np.argmax(odometry[:, 0] >= truth[0, 0]))
    begin = int(rng.integers(least, max(len(odometry) - SAMPLES, least + 1)))
    odometry = odometry[begin : begin + SAMPLES + 1]
    v, omega = calibration.velocities(odometry[:, 1], odometry[:, 2])
    z = calibration.readings(seen[:, 2:])
    R, who = calibration.noise(z), np.array([subject.get(int(code), -1) for code in seen[:, 1]])
    at = int(np.searchsorted(truth[:, 0], odometry[0, 0]).clip(0, len(truth) - 1))
    pose, P, name = truth[at, 1:], P0, f"{files.name}, robot {robot}"

    def ask(part: str, k: int, *given: Any) -> Answer:
        expected = REFERENCES[part](*given)
        out[part].append(Question(name, k, given, expected))
        return expected

    for k, (t, after) in enumerate(zip(odometry[:-1, 0], odometry[1:, 0], strict=True)):
        pose, P = ask("move", k, pose, P, float(v[k]), float(omega[k]), float(after - t), SIGMA)
        for i in np.flatnonzero((seen[:, 0] > t) & (seen[:, 0] <= after) & np.isin(who, survey.id)).tolist():
            ask("initialize", k, pose, P, z[i], R[i])
            ask("correspond", k, rng.multivariate_normal(pose, LESS_SURE), P + LESS_SURE, survey.xy, z[i], R[i])
            pose, P = ask("correct", k, pose, P, survey.positions(who[i : i + 1])[0], z[i], R[i])


def _mistakes(name: str) -> Mistakes:
    """The reference with each mistake that `check` knows; then those of this part alone."""
    answer = REFERENCES[name]
    if name == "correspond":
        yield "nn", lambda *given: answer(*given, RIGHT, nn)
    own = [bug for bug in Bug if name != "initialize" or bug.startswith("new")]
    for bug, rules in ((b, rules) for b in own for rules in rules_of(b)):
        yield bug, lambda *given, rules=rules: answer(*given, rules)
    for model, number in MODELS.items() if name == "move" else ():
        yield model, lambda *given, number=number: answer(*given, RIGHT, number)


PARTS = tuple(asked(name, lambda seeds, name: recorded(seeds)[name], _mistakes) for name in REFERENCES)
