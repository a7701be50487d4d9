"""Where a quantity comes from that estimators or the referee use: what covariances, NEES and NIS are relative to."""

from collections.abc import Mapping
from enum import StrEnum


class Origin(StrEnum):
    """Stated in the file, given by a flag, assumed by default, or inferred from data."""

    STATED = "stated"
    GIVEN = "given"
    ASSUMED = "assumed"
    INFERRED = "inferred"


NOISES = ("odometry_noise", "observation_noise", "range_noise", "fix_noise", "closure_noise")
QUANTITIES = (*NOISES, "prior", "sensor_pose", "max_range", "units", "time_offset", "systematic_errors")
Origins = Mapping[str, Origin]
"""Origin by quantity, of one of several sensors with its name behind a dot (`max_range.lidar`); others are stated."""


def in_words(quantity: str) -> str:
    """A quantity as sentences have it: "observation noise of lidar"."""
    name, _, sensor = quantity.partition(".")
    return name.replace("_", " ") + (f" of {sensor}" if sensor else "")


def assumed(origins: Origins) -> tuple[str, ...]:
    """The noises that are assumed, in words."""
    found = (q for q, origin in origins.items() if origin is Origin.ASSUMED and q.partition(".")[0] in NOISES)
    return tuple(map(in_words, found))


def listed(origins: Origins) -> list[tuple[Origin, str]]:
    """Each origin but stated, with its quantities in words."""
    each = {o: [in_words(q) for q, origin in origins.items() if origin is o] for o in Origin if o is not Origin.STATED}
    return [(o, ", ".join(names)) for o, names in each.items() if names]
