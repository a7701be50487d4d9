"""What is known before the first frame: all that an estimator or a front end may begin with."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from data.inputs import LandmarkMap, Prior
from data.sensors import Sensor


class Given(Protocol):
    """Prior, sensor and, for localization, the map. `data.inputs.Inputs` has them, and so has a live robot."""

    @property
    def prior(self) -> Prior:
        """Belief about the pose at the first frame."""
        ...

    @property
    def sensor(self) -> Sensor:
        """The measurement model."""
        ...

    @property
    def map(self) -> LandmarkMap | None:
        """Known landmarks; None: SLAM."""
        ...


class Beginning(NamedTuple):
    """Just that, without a log; fields as in `Given`."""

    prior: Prior
    sensor: Sensor
    map: LandmarkMap | None = None
