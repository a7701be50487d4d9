"""Back ends compared on one laser log: the front end once, then every estimator on its constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from association.scans.laser_run import SCAN, LaserRun
from association.scans.points import beams_of, scan_points
from association.scans.redundant import redundant, without
from association.scans.scale import learned_scale, residuals, spanned
from data.errors import UsageError
from data.inputs import Inputs
from data.result import Run
from data.se2 import compose, transform_points
from eval.replay.laser.backends import NAMES, Solved, backend
from eval.replay.laser.front_end import FrontEndResult, run_front_end
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.unscanned import between_scans
from eval.replay.settings import Setup

CONTRAST = 0.999
"""Gate of the filter that is shown beside the one without."""
FEWEST = 20
"""Loop closures from which a scale of the covariances is learned: it is then known to a quarter or better."""


def compare_laser(inputs: Inputs, estimators: Sequence[str], setup: Setup) -> list[LaserRun]:
    """The estimators on the same key poses and loop closures, in the order asked for; dead reckoning is the wheels'.

    Covariances of scan matching are scaled, all alike, so that the loop closures fit the graph as they should; that
    changes no optimum, and what is claimed of it. The filter's gate on loop closures is `setup.gate_known`. Seconds
    hold the front end's as well. Raises UsageError for an estimator that is no back end of scan matching.
    """
    for name in estimators:
        if name not in NAMES:
            raise UsageError(f"{name} with association {SCAN}: of laser logs there are {', '.join(NAMES)}")
    parameters = LaserParameters(keyframe_distance=setup.keyframe_distance)
    front = run_front_end(inputs, parameters)
    learned = _learned(inputs, front, setup)
    factor, error = learned or (1.0, 0.0)
    front = _scaled(front, factor)
    if setup.least_information is not None:
        front = _thinned(inputs, front, setup.least_information, parameters)
    claimed = parameters.variance_scale * factor
    gate = setup.settled(False).label_gate
    runs = []
    for name in estimators:
        run = _run(inputs, front, backend(name, inputs, front.chain, front.loops, setup, gate=gate))
        if learned and run.chain is not None:
            run = replace(run, scale=(claimed, parameters.variance_scale * error))
        if name == "ekf" and gate is None:
            scaled, unscaled = (
                _run(inputs, given, backend(name, inputs, given.chain, given.loops, setup, gate=CONTRAST))
                for given in (front, _scaled(front, 1.0 / claimed))
            )
            run = replace(run, with_gate=(scaled, unscaled))
        runs.append(run)
    return runs


def _learned(inputs: Inputs, front: FrontEndResult, setup: Setup) -> tuple[float, float] | None:
    """Factor on the front end's covariances and its standard error; None where too few loop closures tell."""
    chain, loops = front.chain, front.loops
    believed = np.flatnonzero(loops.believed >= 0)
    if len(believed) < FEWEST:
        return None
    solved = backend("batch", inputs, chain, loops, setup)
    if solved.run.failure is not None:
        return None
    key1, key2 = loops.key1[believed], loops.key2[believed]
    step = 1 + np.flatnonzero(spanned(len(chain.frame), key1, key2))
    d2 = residuals(
        solved.final_keys, np.concatenate([step - 1, key1]), np.concatenate([step, key2]),
        np.concatenate([chain.motion[step], loops.relative[believed]]),
        np.concatenate([chain.covariance[step], loops.covariance[believed]]),
    )  # fmt: skip
    return learned_scale(d2, len(believed))


def _scaled(front: FrontEndResult, factor: float) -> FrontEndResult:
    """The same constraints with other covariances."""
    c, o = front.chain, front.loops
    chain = replace(c, covariance=factor * c.covariance, since_covariance=factor * c.since_covariance)
    return replace(front, chain=chain, loops=replace(o, covariance=factor * o.covariance))


def _thinned(inputs: Inputs, front: FrontEndResult, least: float, parameters: LaserParameters) -> FrontEndResult:
    """The constraints without the key poses that tell little about the map, placed by the batch smoother.

    They are chosen by the whole log, so that online, too, estimates lack what was left out later.
    """
    solved = backend("batch", inputs, front.chain, front.loops)
    if solved.run.failure is not None or inputs.scans is None:
        return front
    scans, nothing = inputs.scans, np.zeros((0, 2))
    beams = beams_of(scans.scanner, scans.ranges.shape[1])
    row = dict(zip(scans.frame.tolist(), scans.ranges, strict=True))
    ends = [
        transform_points(pose, scan_points(row[frame], beams, parameters.max_range).xy) if frame in row else nothing
        for pose, frame in zip(solved.final_keys, front.chain.frame.tolist(), strict=True)
    ]
    chain, loops = without(front.chain, front.loops, redundant(ends, least))
    return replace(front, chain=chain, loops=loops)


def _run(inputs: Inputs, front: FrontEndResult, solved: Solved) -> LaserRun:
    """What a back end made, with every frame at its best place in the end."""
    run, chain = solved.run, front.chain
    last = None
    if run.association != "none":
        last = between_scans(inputs, compose(solved.final_keys[chain.key], chain.since))
        final = None if run.final is None else replace(run.final, pose=last)
        run = replace(run, seconds=run.seconds + float(front.seconds.sum()), final=final)
    given = {f.name: getattr(run, f.name) for f in fields(Run)}
    if last is None:
        return LaserRun(**given)
    return LaserRun(
        **given, chain=chain, loops=front.loops, frame_seconds=front.seconds, key_pose=solved.final_keys,
        weight=solved.weight, last=last,
    )  # fmt: skip
