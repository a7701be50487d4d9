"""Faults on the way to gtsam and back: frames, order of noise and of marginals, linearization, robots at rest."""

from __future__ import annotations

from functools import cache

import numpy as np

from data.errors import DataError
from data.worlds.arena import Arena, simulate
from data.worlds.corridor import Corridor
from data.worlds.corridor import simulate as simulate_corridor
from eval.replay.run import compare, step_by_step
from eval.replay.settings import Setup
from graph.incremental import Isam2Smoother
from tests.mutation.faults import Check, Fault, replaced
from tests.mutation.verdicts import BATCH_NEES, BATCH_NIS, SAME_LAST_POSE, agree, corridor


def same_expectation():
    setup = Setup(gate_known=0.999999)
    ekf, isam2 = compare(corridor().inputs(labels=True), "slam", ["ekf", "isam2"], "known", setup)
    a, b = np.nansum(ekf.innovations.nis), np.nansum(isam2.innovations.nis)
    assert abs(b / a - 1.0) < 0.05, f"{b / a:.3g} times its NIS"


@cache
def blind():
    """A log without odometry and its optimum, which a fault of iSAM2 cannot touch."""
    inputs = simulate_corridor(Corridor(frames=60, odometry=False), 0).inputs(labels=True)
    return inputs, compare(inputs, "slam", ["batch"])[0].final


def incremental_as_batch():
    """Without odometry the start values are metres off, so that the linearization points matter."""
    inputs, batch = blind()
    isam2 = step_by_step("isam2", inputs.without_map(), "slam").online
    agree(isam2.pose[-1], batch.pose[-1], batch.covariance[-1], 0.1)


def at_rest():
    log = simulate(Arena(frames=10, speed=0.0, swing=0.0, sigma_v=0.0, sigma_omega=0.0), 0)
    ekf, batch = compare(log.inputs(labels=True), "localization", ["ekf", "batch"])
    agree(ekf.online.pose[-1], batch.final.pose[-1], batch.final.covariance[-1], 0.1)


def no_relinearization(monkeypatch):
    monkeypatch.setitem(Isam2Smoother.__init__.__kwdefaults__, "threshold", 100.0)


def covariance_in_order_of_keys(real):
    def covariance(self, keys):
        return real(self, [*keys[1:], keys[0]]) if len(keys) > 1 else real(self, keys)

    return covariance


def range_before_bearing(real):
    def bearing_range(sensor, z, R):
        return real(sensor, z, R)[0], R

    return bearing_range


SAME_EXPECTATION = Check("iSAM2 expects what the filter expects", same_expectation)
INCREMENTAL = Check("newest pose of iSAM2 is 0.1 sigma from batch at most", incremental_as_batch)
AT_REST = Check("the batch smoother takes a robot at rest", at_rest)

FAULTS = (
    Fault(9, "body-frame marginals of the batch smoother", BATCH_NEES,
          replaced("graph.optimum.worlds_from_bodies", lambda real: lambda theta: np.array([np.eye(3)] * len(theta))),
          match="overconfident"),
    Fault(9, "body-frame marginals of iSAM2", SAME_LAST_POSE,
          replaced("graph.open_end.world_from_body", lambda real: lambda theta: np.eye(3))),
    Fault(10, "joint marginal in the order of its keys", SAME_EXPECTATION,
          replaced("graph.engine.Engine.covariance", covariance_in_order_of_keys),
          by=(AssertionError, np.linalg.LinAlgError)),
    Fault(11, "noise as [range, bearing] to gtsam", BATCH_NIS,
          replaced("graph.factors.bearing_range", range_before_bearing)),
    Fault(26, "robot at rest, covariance without a floor", AT_REST,
          replaced("data.worlds.parameters.floor_covariances", lambda real: lambda covariance, floor: (covariance, 0)),
          by=DataError, match="covariance is singular"),
    Fault(27, "iSAM2 hardly ever relinearizes", INCREMENTAL, no_relinearization),
)  # fmt: skip
