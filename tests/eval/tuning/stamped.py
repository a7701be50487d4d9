"""Logs with odometry.csv whose latency, noise, biases and scales are known: what `eval.tune` ought to find.

Small arenas of which the stated noise is wrong.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data.inputs import Increments, Observations
from data.motion.velocity import VelocityModel, VelocityNoise, preintegrate
from data.sensors import RangeBearing
from data.worlds.arena import Arena

DT, EVERY = 0.05, 8
"""Odometry at 20 Hz, readings every 0.4 s."""
SIGMA_MOTION, SIGMA_SENSOR = (0.02, 0.01), (0.05, 0.01)
SIZE, RANGE, CLEARANCE = 12.0, 8.0, 1.0
"""m: half side of the landmarks' square, longest reading, and how far landmarks stay from the path: very near ones make
an EKF's linearization the largest error, which no noise accounts for."""


@dataclass(frozen=True)
class Stamped:
    latency: float = 0.0  # s that the stamps of the readings are late
    stated: tuple[float, float] = (1.0, 1.0)  # sigmas of motion and sensor in log.toml over the true ones
    bias: tuple[float, float] = (0.0, 0.0)  # measured minus true range [m] and bearing [rad]
    over: tuple[float, float] = (1.0, 1.0)  # odometry's distance and rotation over the true ones
    offset: float = 0.0  # s that the readings are taken after the stamp of an odometry sample
    noise: float = 1.0  # odometry's true noise over `SIGMA_MOTION`
    winding: float = 0.5  # how far velocities vary, m/s and rad/s
    seed: int = 0  # of noise, landmarks and path

    def truth(self) -> dict[str, float]:
        """Every parameter of the default fit, as `Parameter.value` has it."""
        motion, sensor = (1.0 / s for s in self.stated)
        return {
            "motion_v": motion, "motion_omega": motion, "sigma_range": sensor, "sigma_bearing": sensor,
            "bias_range": self.bias[0], "bias_bearing": self.bias[1], "odometry_v": 1.0 / self.over[0],
            "odometry_omega": 1.0 / self.over[1], "latency": self.latency,
        }  # fmt: skip


def stamped_folder(folder: Path, true: Stamped) -> Path:
    """The log folder of a robot on a winding path of 45 s among 20 landmarks."""
    rng = np.random.default_rng(true.seed)
    t = DT * np.arange(901)
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    v = 1.0 + true.winding * np.sin(t + phase[0])
    omega = 0.2 + true.winding * np.sin(0.7 * t + phase[1])
    stamp = np.concatenate([[0.0], t[40:860:EVERY] + true.offset])
    pose = path(t, v, omega, stamp)
    landmarks = scattered(rng, pose[:, :2])
    lines = []
    for at, here in zip(stamp[1:], pose[1:]):
        z = RangeBearing().predict(here, landmarks)
        near = np.flatnonzero(z[:, 0] < RANGE)
        z = z[near] + np.array(true.bias) + np.array(SIGMA_SENSOR) * rng.standard_normal((len(near), 2))
        lines += [f"{float(at + true.latency)!r},{a!r},{b!r},{i}" for (a, b), i in zip(z.tolist(), near)]
    odometry = np.column_stack([t, true.over[0] * v, true.over[1] * omega])
    sigma = true.noise * np.array(SIGMA_MOTION)
    odometry[:, 1:] += sigma / np.sqrt(DT) * rng.standard_normal((len(t), 2))
    folder.mkdir()

    def table(name, header, rows):
        (folder / name).write_text("\n".join([header, *rows]) + "\n")

    def text(rows):
        return [",".join(map(repr, row)) for row in rows.tolist()]

    table("odometry.csv", "t,v,omega", text(odometry))
    table("observations.csv", "t,z1,z2,true_id", lines)
    table("landmarks.csv", "id,x,y", [f"{i},{x!r},{y!r}" for i, (x, y) in enumerate(landmarks.tolist())])
    table("truth.csv", "t,x,y,theta", text(np.column_stack([t, path(t, v, omega, t)])))
    motion, sensor = (true.stated[0] * sigma).tolist(), (true.stated[1] * np.array(SIGMA_SENSOR)).tolist()
    (folder / "log.toml").write_text(
        'format = 1\nname = "stamped"\n[prior]\nmean = [0, 0, 0]\nsigma = [0.01, 0.01, 0.01]\n'
        f'[sensor]\nkind = "range_bearing"\nsigma = {sensor}\n'
        f'[motion]\nmodel = "unicycle"\nnoise = "density"\nsigma = {motion}\n'
    )
    return folder


def path(time, v, omega, at):
    """Poses (N, 3) at the instants `at`, from the origin at the first of them."""
    steps = preintegrate(VelocityModel(VelocityNoise("density")), time, v, omega, at)[0].mean
    pose = np.zeros((len(at), 3))
    for k in range(1, len(at)):
        c, s = np.cos(pose[k - 1, 2]), np.sin(pose[k - 1, 2])
        pose[k] = pose[k - 1] + [c * steps[k, 0] - s * steps[k, 1], s * steps[k, 0] + c * steps[k, 1], steps[k, 2]]
    return pose


def scattered(rng, places):
    """20 landmarks (20, 2) around the path, none nearer to it than `CLEARANCE`."""
    tried = places.mean(axis=0) + rng.uniform(-SIZE, SIZE, (400, 2))
    away = np.linalg.norm(tried[:, None] - places, axis=2).min(axis=1)
    return tried[away > CLEARANCE][:20]


SMALL = Arena(frames=80)


def changed(log, *, noise=1.0, bias=(0.0, 0.0), scale=(1.0, 1.0)):
    """The log with sigmas stated `noise` times too large, biased readings and odometry that counts `scale` too much."""
    r = log.recorded
    o, mean = r.observations, r.increments.mean * np.array([scale[0], scale[0], scale[1]])
    return replace(
        log,
        recorded=replace(
            r,
            increments=Increments(mean, r.increments.covariance * noise**2),
            observations=Observations(o.frame, o.z + np.array(bias), o.R * noise**2),
        ),
    )


def by_name(model, values):
    return dict(zip([p.name for p in model.parameters], values, strict=True))
