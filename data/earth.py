"""Latitude and longitude (WGS 84) as metres east and north of a place.

A tangent plane: within 10 km of its origin distances are true to 1e-6 of themselves (Groves 2013, section 2.4).
"""

import numpy as np

from data.se2 import Array

RADIUS, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3  # m, 1; of the ellipsoid


def centred(place: Array) -> Array:
    """Geocentric Cartesian coordinates (..., 3) [m] of latitude, longitude [deg], height [m] (..., 3)."""
    latitude, longitude, height = np.radians(place[..., 0]), np.radians(place[..., 1]), place[..., 2]
    normal = RADIUS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = ((1.0 - ECCENTRICITY_SQUARED) * normal + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def east_north(place: Array, origin: Array) -> Array:
    """Metres east and north (N, 2) of an origin (3,), both as latitude, longitude [deg], height [m]; places (N, 3)."""
    off = centred(place) - centred(origin)
    (s_lat, c_lat), (s_lon, c_lon) = ((np.sin(a), np.cos(a)) for a in np.radians(origin[:2]))
    east = np.array([-s_lon, c_lon, 0.0])
    north = np.array([-s_lat * c_lon, -s_lat * s_lon, c_lat])
    return np.asarray(np.stack([off @ east, off @ north], axis=-1))
