"""What the tests of MRCLAM logs share: names of the files, and questions to a log that was loaded."""

from data.formats.mrclam import Calibration
from data.log import Log
from tests.data.formats.mrclam import world

PLAIN = Calibration()
TRUTH, ODOMETRY, MEASURED = "Robot1_Groundtruth.dat", "Robot1_Odometry.dat", "Robot1_Measurement.dat"


def starts_at(log: Log) -> float:
    """First frame, in seconds after the first ground-truth row."""
    return float(log.source["first_stamp"]) - world.T0  # type: ignore[arg-type]


def noted(log: Log, *words: str) -> bool:
    return any(all(w in note for w in words) for note in log.notes)
