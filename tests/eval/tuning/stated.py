"""Small arenas of which the stated noise is wrong."""

from dataclasses import replace

import numpy as np

from data.inputs import Increments, Observations
from data.worlds.arena import Arena

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
