"""What is known before the first frame: all that an estimator or a front end may begin with."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from data.inputs import LandmarkMap, Prior, Systematic
from data.sensors import Sensor


class Given(Protocol):
    """Prior, sensor, for localization the map, and errors to estimate. `Inputs` has them, and so has a robot."""

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

    @property
    def systematic(self) -> Systematic | None:
        """Errors of odometry and sensor that are estimated along; None: there are none."""
        ...


class Beginning(NamedTuple):
    """Just that, without a log; fields as in `Given`."""

    prior: Prior
    sensor: Sensor
    map: LandmarkMap | None = None
    systematic: Systematic | None = None
