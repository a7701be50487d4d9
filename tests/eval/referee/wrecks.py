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


def _prior(log: Log, offset) -> Log:
    p = log.recorded.prior
    return _recorded(log, prior=Prior(p.mean + np.array(offset), p.covariance))


def sensor_looking_back(log: Log) -> Log:
    z = log.recorded.observations.z
    return _readings(log, np.column_stack([z[:, 0], se2.wrap_angle(z[:, 1] + np.pi)]))


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


LOCALIZATION = {
    "map_rotated": lambda log: _map(log, log.recorded.map.xy @ se2.rotation(0.5 * np.pi).T),
    "map_shifted": lambda log: _map(log, log.recorded.map.xy + np.array([7.0, -4.0])),
    "map_in_feet": lambda log: _map(log, log.recorded.map.xy / 0.3048),
    "map_with_x_and_y_exchanged": lambda log: _map(log, log.recorded.map.xy[:, ::-1]),
    "ranges_in_feet": lambda log: _readings(log, log.recorded.observations.z * np.array([1.0 / 0.3048, 1.0])),
    "ranges_in_millimetres": lambda log: _readings(log, log.recorded.observations.z * np.array([1000.0, 1.0])),
    "bearings_in_degrees": lambda log: _readings(log, log.recorded.observations.z * np.array([1.0, 180.0 / np.pi])),
    "bearings_mirrored": lambda log: _readings(log, log.recorded.observations.z * np.array([1.0, -1.0])),
    "sensor_looking_back": sensor_looking_back, "prior_facing_backwards": lambda log: _prior(log, [0.0, 0.0, np.pi]),
    "prior_elsewhere": lambda log: _prior(log, [6.0, 5.0, 0.0]), "odometry_in_millimetres": odometry_in_millimetres,
    "kidnapped": kidnapped,
}  # fmt: skip
SLAM = ("kidnapped", "bearings_mirrored", "bearings_in_degrees", "odometry_in_millimetres")
