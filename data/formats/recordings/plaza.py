"""The Plaza range-only logs bundled with gtsam: a mowing robot among four radio beacons at surveyed places.

`Plaza1_.mat` and `Plaza2_.mat`, arrays with a row for each message:

    DR  t, distance [m] and turn [rad] since the row before        TD  t, antenna, beacon, range [m]
    GT  t, x, y [m], heading [rad] by RTK GPS                      TL  beacon, x, y [m]

The first row of GT precedes the first of DR; the other stamps are the same. Recorded by J. Djugash, B. Hamner and S.
Roth (Journal of Field Robotics 26, 2009). Two things of the files, both by comparison with their ground truth: ranges
are 1.07 times the distances, in both sets; and headings of Plaza 2 point backwards.
"""

import numpy as np
import scipy.io

from data import se2
from data.digest import source_file
from data.formats.recordings.laser import FLOOR, TravelNoise, increments_of
from data.formats.recordings.victoria_park import bundled_file
from data.inputs import Inputs, LandmarkMap, Observations, Prior
from data.log import Log
from data.origin import Origin
from data.sensors import Range
from data.terminal import counted
from data.timeline import frame_times, truth_at
from data.truth import Truth

SCALE, SIGMA = 1.07, 0.5
"""Of the ranges over the distances, and standard deviation [m] of what is left: 1.0699 and 0.51 in Plaza 1, 1.0700 and
0.52 in Plaza 2."""
NOISE = TravelNoise(0.03, 0.03, 0.05, 0.03)
"""Of wheels and gyro: against the ground truth 0.03 m per sqrt(m) in Plaza 1, and 0.05 rad per sqrt(m) in Plaza 2."""
FIRST = 0.1  # m and rad, standard deviation of the first true pose


def load_plaza(number: int, scale: float = SCALE, sigma: float = SIGMA) -> Log:
    """Log of one set (1 or 2); `scale`: ranges are divided by it; `sigma`: m, of a range afterwards. Frames are the
    instants of ranges, and every second. Labels are the radio's, so they are sensed.
    """
    path = bundled_file(f"Plaza{number}_.mat")
    found = scipy.io.loadmat(path)
    odometry, ranges, truth, beacons = (np.asarray(found[name], float) for name in ("DR", "TD", "GT", "TL"))
    ranges = ranges[np.argsort(ranges[:, 0], kind="stable")]
    ahead = se2.between(truth[:-1, 1:], truth[1:, 1:])[:, 0].sum() > 0.0  # headings shall point forwards
    true = np.column_stack([truth[:, 1:3], se2.wrap_angle(truth[:, 3] + (0.0 if ahead else np.pi))])
    begin, stamp = float(truth[0, 0]), np.concatenate([truth[:1, 0], odometry[:, 0]])
    inside = (ranges[:, 0] >= stamp[0]) & (ranges[:, 0] <= stamp[-1])
    ranges = ranges[inside]
    time = frame_times(ranges[:, 0], stamp[0], stamp[-1])
    steps = np.vstack([np.zeros(3), se2.along_arcs(odometry[:, 1], odometry[:, 2])])
    increments, floored = increments_of(se2.interpolate(stamp, se2.dead_reckoned(true[0], steps), time), NOISE)
    label = ranges[:, 2].astype(np.int64)
    order = np.argsort(beacons[:, 0])
    landmarks = LandmarkMap(beacons[order, 0].astype(np.int64), beacons[order, 1:])
    z = np.stack([ranges[:, 3] / scale, np.zeros(len(ranges))], axis=-1)
    recorded = Inputs(
        prior=Prior(true[0], np.eye(3) * FIRST**2), time=time - begin, increments=increments,
        observations=Observations(
            np.searchsorted(time, ranges[:, 0]).astype(np.int64), z, np.tile(np.diag([sigma**2, 1.0]), (len(z), 1, 1))
        ),
        sensor=Range(max_range=1.001 * float(z[:, 0].max()), label="radio"), map=landmarks, covariance_floor=FLOOR,
        floored=floored,
    )  # fmt: skip
    notes = [
        f"Ranges are divided by {scale:g} (--range-scale); by the ground truth they are {SCALE:g} times the distances.",
        f"The first true pose is the prior, with a standard deviation of {FIRST:g} m and {FIRST:g} rad.",
    ]
    if not inside.all():
        notes.append(f"{counted(int((~inside).sum()), 'range')} before or after all odometry: left out.")
    if float(np.abs(se2.wrap_angle(odometry[:, 2] - np.diff(truth[:, 3]))).max()) < 1e-9:
        notes.append("The true headings turn exactly as the odometry does, so they are no independent reference.")
    return Log(
        f"plaza-{number}", recorded, Truth(truth_at(truth[:, 0], true, time), landmarks, label), label=label,
        labels_are_sensed=True, notes=tuple(notes),
        source={"kind": "plaza", "set": number, **source_file(path), "clock": begin, "range_scale": scale},
        origins=dict.fromkeys(("odometry_noise", "observation_noise", "max_range"), Origin.INFERRED)
        | {"prior": Origin.ASSUMED} | ({"observation_noise": Origin.GIVEN} if sigma != SIGMA else {}),
    )  # fmt: skip
