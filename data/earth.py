"""Latitude and longitude (WGS 84) as metres east and north of a place.

A tangent plane: within 10 km of its origin distances are true to 1e-6 of themselves (Groves 2013, section 2.4).
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from data.errors import DataError
from data.se2 import Array
from data.terminal import counted

RADIUS, ECCENTRICITY_SQUARED = 6378137.0, 6.69437999014e-3  # m, 1; of the ellipsoid


def centred(place: Array) -> Array:
    """Geocentric Cartesian coordinates (..., 3) [m] of latitude, longitude [deg], height [m] (..., 3)."""
    latitude, longitude, height = np.radians(place[..., 0]), np.radians(place[..., 1]), place[..., 2]
    normal = RADIUS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = ((1.0 - ECCENTRICITY_SQUARED) * normal + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def east_north_up(place: Array, origin: Array) -> Array:
    """Metres east, north and up (N, 3) of an origin (3,), as places (N, 3) latitude, longitude [deg], height [m]."""
    off = centred(place) - centred(origin)
    (s_lat, c_lat), (s_lon, c_lon) = ((np.sin(a), np.cos(a)) for a in np.radians(origin[:2]))
    east = np.array([-s_lon, c_lon, 0.0])
    north = np.array([-s_lat * c_lon, -s_lat * s_lon, c_lat])
    return np.asarray(np.stack([off @ east, off @ north, off @ np.cross(east, north)], axis=-1))


def on_plane(file: Path, place: Array, datum: Sequence[float] = ()) -> tuple[Array, tuple[float, ...], str]:
    """Metres (N, 3) of places (N, 3) of a file about a datum, by default the first known one; that datum, and a note
    where it is new, or they were ddmm.mmmm (NMEA 0183). A height of NaN is the datum's. DataError for what is no
    latitude and longitude.
    """
    known, said = np.isfinite(place[:, :2]).all(axis=1), ""
    size = np.abs(place[:, :2])
    if not (size[known] <= [90.0, 360.0]).all():
        if not ((size[known] % 100.0 < 60.0) & (size[known] < [9000.0, 18000.0])).all():
            counts = ((size[known] > 1e7) & (size[known] <= [9e8, 3.6e9]) & (size[known] % 1.0 == 0.0)).all()
            of = "; of 1e-7 deg? `--unit lat=1e-7deg,lon=1e-7deg` of `slamref convert table` reads them" * bool(counts)
            what = f"latitudes beyond 90 or longitudes beyond 360; degrees, or ddmm.mmmm, are needed{of}"
            raise DataError.at(file, what)
        place = np.hstack([np.sign(place[:, :2]) * (size // 100.0 + size % 100.0 / 60.0), place[:, 2:]])
        said = "inferred: latitudes and longitudes are degrees and minutes (ddmm.mmmm), as they are no degrees; "
    if not known.any():
        return np.full(place.shape, np.nan), tuple(datum), ""
    lat, lon, height = place[known][0].tolist()
    if not datum:
        datum = lat, lon, 0.0 if np.isnan(height) else height
        said += f"x and y are metres east and north of latitude and longitude {lat:.9g}, {lon:.9g} deg"
    origin = np.array([*datum, 0.0][:3])
    height = np.where(np.isnan(place[:, 2:]), origin[2], place[:, 2:])
    return east_north_up(np.hstack([place[:, :2], height]), origin), tuple(datum), said


APART = 50.0  # Least distance from 0 of other places, over the longest step between them


def placed(place: Array, of: str, *, first: bool = False) -> tuple[Array, tuple[str, ...]]:
    """Places (n, d), NaN where they are 0 and far from all others, as of a receiver that measured none, and what is
    said of those; `first`: also of several at first, a leap before the others; `of`: whose they are, empty: unchanged.
    """
    none = np.asarray(~place.any(axis=1))
    rest = place[~none & np.isfinite(place).all(axis=1)]
    step = np.linalg.norm(np.diff(rest, axis=0), axis=1).max(initial=0.0)
    if not 0.0 < APART * step < np.linalg.norm(rest, axis=1).min(initial=np.inf):
        early = np.logical_and.accumulate(none)
        none = early & bool(first and early.sum() > 1 and len(rest) and 0.0 < step < np.linalg.norm(rest[0]))
    if not of or not none.any():
        return place, ()
    some = f"{counted(int(none.sum()), 'place')} of {of} at 0, 0, far from all others"
    return np.where(none[:, None], np.nan, place), (f"{some}: left out, as none was measured there",)
