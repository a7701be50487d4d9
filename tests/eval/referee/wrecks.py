"""Healthy logs with typical faults of users."""

from dataclasses import replace

import numpy as np

from data import se2
from data.inputs import Increments, LandmarkMap, Observations, Prior
from data.log import Log
from tests.builders.logs import without_frames


def _recorded(log: Log, **changed) -> Log:
    return replace(log, recorded=replace(log.recorded, **changed))


def _map(log: Log, xy) -> Log:
    return _recorded(log, map=LandmarkMap(log.recorded.map.id, xy))


def _readings(log: Log, z) -> Log:
    o = log.recorded.observations
    return _recorded(log, observations=Observations(o.frame, z, o.R))


def map_rotated(log: Log) -> Log:
    return _map(log, log.recorded.map.xy @ se2.rotation(0.5 * np.pi).T)


def map_shifted(log: Log) -> Log:
    return _map(log, log.recorded.map.xy + np.array([7.0, -4.0]))


def map_in_feet(log: Log) -> Log:
    return _map(log, log.recorded.map.xy / 0.3048)


def map_with_x_and_y_exchanged(log: Log) -> Log:
    return _map(log, log.recorded.map.xy[:, ::-1])


def ranges_in_feet(log: Log) -> Log:
    return _readings(log, log.recorded.observations.z * np.array([1.0 / 0.3048, 1.0]))


def ranges_in_millimetres(log: Log) -> Log:
    return _readings(log, log.recorded.observations.z * np.array([1000.0, 1.0]))


def bearings_in_degrees(log: Log) -> Log:
    return _readings(log, log.recorded.observations.z * np.array([1.0, 180.0 / np.pi]))


def bearings_mirrored(log: Log) -> Log:
    return _readings(log, log.recorded.observations.z * np.array([1.0, -1.0]))


def sensor_looking_back(log: Log) -> Log:
    z = log.recorded.observations.z
    return _readings(log, np.column_stack([z[:, 0], se2.wrap_angle(z[:, 1] + np.pi)]))


def prior_facing_backwards(log: Log) -> Log:
    p = log.recorded.prior
    return _recorded(log, prior=Prior(p.mean + np.array([0.0, 0.0, np.pi]), p.covariance))


def prior_elsewhere(log: Log) -> Log:
    p = log.recorded.prior
    return _recorded(log, prior=Prior(p.mean + np.array([6.0, 5.0, 0.0]), p.covariance))


def odometry_in_millimetres(log: Log) -> Log:
    i = log.recorded.increments
    return _recorded(log, increments=Increments(i.mean * np.array([1000.0, 1000.0, 1.0]), i.covariance))


def kidnapped(log: Log) -> Log:
    """A kidnapped robot: half-way it jumps sixty frames ahead, without odometry."""
    half = len(log.recorded) // 2
    return without_frames(log, slice(half, half + 60))


def stated(log: Log, factor: float) -> Log:
    """The log with every sigma stated at `factor` of what it is."""
    r = log.recorded
    o = r.observations
    increments = Increments(r.increments.mean, r.increments.covariance * factor**2)
    return replace(
        log, recorded=replace(r, increments=increments, observations=Observations(o.frame, o.z, o.R * factor**2))
    )


LOCALIZATION = (
    map_rotated, map_shifted, map_in_feet, map_with_x_and_y_exchanged, ranges_in_feet, ranges_in_millimetres,
    bearings_in_degrees, bearings_mirrored, sensor_looking_back, prior_facing_backwards, prior_elsewhere,
    odometry_in_millimetres, kidnapped,
)  # fmt: skip
SLAM = (kidnapped, bearings_mirrored, bearings_in_degrees, odometry_in_millimetres)
