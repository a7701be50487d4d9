"""A corridor lab small enough to count by hand: a robot that stands still before two points, people or none."""

from dataclasses import replace

import numpy as np

from data.inputs import LandmarkMap
from data.log import Log
from data.result import MapEstimate, Run, Trajectory
from data.truth import Truth
from tests.builders.logs import increments_of, inputs_of, observations_of

FRAMES = 5
POINTS = LandmarkMap(np.array([1, 2]), np.array([[2.0, 0.0], [2.0, 0.5]]))
NEW, DISCARD = -1, -2

# who is seen (frame, true id), in the order of the log; 0 stands for "not shown" in a log without people
SEEN = [(0, 1), (0, 2), (1, 1), (1, 2), (1, -1), (2, 1), (2, 2), (2, -1), (3, 1), (3, 2), (3, -1), (4, 1), (4, 2)]
RIGHT = {1: 0, 2: 1}


def lab_log(*, people: bool = False, odometry: bool = True, seed: int = 0, name: str | None = None) -> Log:
    """Both points in every frame, in three frames a person too. Without odometry no motion is stated."""
    seen = [s for s in SEEN if people or s[1] > 0]
    frame, true_id = (np.array(column) for column in zip(*seen))
    z = np.array([POINTS.xy[i - 1] if i > 0 else (3.0, 1.0) for i in true_id])
    mean = np.zeros((FRAMES, 3))
    if odometry:
        mean[1:, 2] = 1e-12  # what was read is not exactly nothing
    steps = increments_of(mean, 0.01 * np.eye(3))
    inputs = inputs_of(steps, observations_of(frame, z), spread=1e-6, time_is_index=True)
    switches = [w for w, on in (("people", people), ("no-odometry", not odometry)) if on]
    source = {"kind": "corridor", "seed": seed, "corridor": {"people": people, "odometry": odometry, "range": 5.0}}
    log_name = name or ":".join([f"corridor:{seed}", *(["+".join(switches)] if switches else [])])
    return Log(log_name, inputs, Truth(np.zeros((FRAMES, 3)), POINTS, true_id), source=source)


def lab_run(
    log: Log, association: str, *, error: float = 0.01, changes: dict[int, int] | None = None, estimator: str = "ekf",
    removed: dict[int, int] | None = None, seconds: float = 1.0,
) -> Run:  # fmt: skip
    """A run that is right and leaves people out, but for `changes` by row of the log; off by `error` m from frame 1 on.
    `removed`: frame after which a landmark, by number, was gone, whose observations are discarded in the end.
    """
    true_id, frame = log.truth.landmark_of, log.recorded.observations.frame
    decisions = np.array([NEW if f == 0 else RIGHT.get(int(i), DISCARD) for f, i in zip(frame, true_id)])
    for row, decision in (changes or {}).items():
        decisions[row] = decision
    created = np.full(len(decisions), -1)
    created[decisions == NEW] = np.arange((decisions == NEW).sum())
    number = np.arange((decisions == NEW).sum())
    gone = np.full(len(number), -1)
    final = decisions.copy()
    for landmark, after in (removed or {}).items():
        gone[landmark] = after
        final[(created == landmark) | (decisions == landmark)] = DISCARD
    kept = number[gone < 0]
    size = 3 + 2 * np.array([((created >= 0) & (frame <= k)).sum() for k in range(FRAMES)])
    for after in (removed or {}).values():
        size[after + 1 :] -= 2
    pose = np.zeros((FRAMES, 3))
    pose[1:, 1] = error
    path = Trajectory(pose, np.tile(np.diag([0.04, 0.01, 0.01]), (FRAMES, 1, 1)))
    mapped = MapEstimate(
        kept, np.tile([2.0, 0.0], (len(kept), 1)), np.tile(0.01 * np.eye(2), (len(kept), 1, 1)),
        frame[created >= 0][kept], np.ones(len(kept), np.int64),
    )  # fmt: skip
    run = Run(
        estimator, association, "slam", path, None, mapped, decisions, final, created, state_size=size,
        seconds=seconds, removed=gone if removed is not None else None,
    )  # fmt: skip
    if estimator == "isam2":
        return replace(run, final=path, state_size=None)
    return replace(run, online=None, final=path, state_size=None) if estimator == "batch" else run


# what NN makes of the log with people: rows 6 (point 2, neighbour), 8 (point 1 initialized twice), 9 (on a person), 11
# (point 1 with its second landmark); people: row 4 initializes, 7 is paired with that, 10 with a point
FOOLED = {4: NEW, 6: 0, 7: 2, 8: NEW, 9: 2, 10: 0, 11: 3}
