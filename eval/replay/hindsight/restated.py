"""What is stated of odometry and sensor, put right where the log shows more noise or a wider view.

Noise is only ever taken for more than was stated. Differences of consecutive frames hide errors that last, so that less
of them is no reason to believe in less noise: gates are narrowed by innovations (`eval.replay.hindsight.gates`).
"""

from __future__ import annotations

from dataclasses import replace

from association.candidates import holding
from association.evidence import constants
from association.evidence.differences import AS_STATED, Differences, Shares, with_shares
from data.inputs import Frame
from data.sensors import Sensor


class Restated:
    """Reads a log's frames, and restates the covariances of those that come after.

    Attributes:
        shares: variances of range, bearing and motion as they are, in those stated; none is below 1.
    """

    def __init__(self, sensor: Sensor) -> None:
        """Before the first frame."""
        self.shares = AS_STATED
        self._sensor = self._view = sensor
        self._differences = Differences(sensor)

    def see(self, frame: Frame) -> Frame:
        """The next frame, with the noise that is known after it."""
        self._view = holding(self._view, self._sensor.polar(frame.sightings.z))
        told = self._differences.see(frame.increment, frame.sightings)
        self.shares = Shares(*(s if s > constants.UNDERSTATED**2 else 1.0 for s in told))
        return self.restated(frame)

    def restated(self, frame: Frame) -> Frame:
        """A frame with the noise that is known by now."""
        if self.shares == AS_STATED:
            return frame
        increment = frame.increment
        if increment is not None:
            increment = increment._replace(covariance=self.shares.motion * increment.covariance)
        return frame._replace(increment=increment, sightings=with_shares(self._sensor, frame.sightings, self.shares))

    def widened(self, sensor: Sensor) -> Sensor:
        """A sensor with the view that holds all that was read so far."""
        view = self._view
        return replace(sensor, max_range=view.max_range, min_angle=view.min_angle, max_angle=view.max_angle)

    def notes(self) -> list[str]:
        """What a reader of the results should know."""
        more = [f"{name} {s**0.5:.1f} times" for name, s in self.shares._asdict().items() if s > 1.0]
        return [f"sigmas are larger than stated, and were decided with so: {', '.join(more)}"] if more else []
