"""Back ends compared on one laser log: the front end once, then every estimator on its constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from association.scans.laser_run import LaserRun
from data.inputs import Inputs
from data.result import Run
from eval.replay.laser.backends import Solved, backend, over_frames
from eval.replay.laser.front_end import FrontEndResult, run_front_end
from eval.replay.laser.parameters import LaserParameters
from eval.replay.laser.unscanned import between_scans
from eval.replay.settings import Setup

CONTRAST = 0.999
"""Gate of the filter that is shown beside the one without: it looks safe, and keeps out true loop closures where the
filter has drifted further than it believes."""


def compare_laser(inputs: Inputs, estimators: Sequence[str], setup: Setup) -> list[LaserRun]:
    """The estimators on the same key poses and loop closures, in the order asked for; dead reckoning is the wheels'.

    The filter's gate on loop closures is `setup.gate_known`. Seconds hold the front end's as well.
    """
    front = run_front_end(inputs, LaserParameters(keyframe_distance=setup.keyframe_distance))
    gate = setup.settled(False).label_gate
    runs = []
    for name in estimators:
        run = _run(inputs, front, backend(name, inputs, front.chain, front.loops, setup, gate=gate))
        if name == "ekf" and gate is None:
            twin = backend(name, inputs, front.chain, front.loops, setup, gate=CONTRAST)
            run = replace(run, gated_twin=_run(inputs, front, twin))
        runs.append(run)
    return runs


def _run(inputs: Inputs, front: FrontEndResult, solved: Solved) -> LaserRun:
    """What a back end made, with every frame at its best place in the end."""
    run, chain = solved.run, front.chain
    last = None
    if run.association != "none":
        path = run.final or over_frames(chain, solved.final_keys, np.zeros((len(chain.frame), 3, 3)))
        last = replace(path, pose=between_scans(inputs, path.pose))
        run = replace(run, seconds=run.seconds + float(front.seconds.sum()), final=run.final and last)
    given = {f.name: getattr(run, f.name) for f in fields(Run)}
    return LaserRun(
        **given, chain=chain, loops=front.loops, frame_seconds=front.seconds, key_pose=solved.final_keys,
        weight=solved.weight, last=last,
    )  # fmt: skip
