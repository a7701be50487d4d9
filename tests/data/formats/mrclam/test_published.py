"""UTIAS MRCLAM: the published recordings."""

import numpy as np
import pytest

from data import se2
from data.formats.mrclam import FROZEN, Calibration, Treatment, corrected_landmarks, load_mrclam
from tests.data.formats.mrclam.world import PLAIN, noted

pytestmark = pytest.mark.usefixtures("tables_parsed_once")
BAD_NINE = [(755.0, 836.0), (945.0, 1050.0), (376.0, 380.0)]


@pytest.fixture(scope="module")
def published(mrclam):
    def load(dataset, robot, **arguments):
        source = mrclam / f"MRCLAM_Dataset{dataset}.zip"
        return load_mrclam(source, robot, Treatment(**{"calibration": PLAIN, **arguments}))

    return load


def misses(log):
    """Median distance [m] between each landmark and its readings projected from the true poses."""
    o, known, pose = log.recorded.observations, log.recorded.map, log.truth.pose
    assert known is not None and pose is not None and log.truth.landmark_of is not None  # noqa: PT018
    x, y, heading = pose[o.frame].T
    r, b = o.z.T
    points = np.stack([x + r * np.cos(heading + b), y + r * np.sin(heading + b)], axis=-1)
    away = np.hypot(*(points - known.xy[np.searchsorted(known.id, log.truth.landmark_of)]).T)
    return {n: float(np.nanmedian(away[log.truth.landmark_of == n])) for n in known.id.tolist()}


class TestThePublishedRecordings:
    @pytest.mark.parametrize(("dataset", "robot", "rows", "unknown", "median", "worst", "worst_miss"), [
        (1, 3, 8742, 2, 0.101, 6, 0.195), pytest.param(6, 4, 2399, 3, 0.125, 9, 0.176, marks=pytest.mark.slow),
        pytest.param(9, 3, 6167, 0, 0.114, 18, 0.193, marks=pytest.mark.slow),
    ])  # fmt: skip
    @pytest.mark.slow
    def test_counts_and_median_residuals_are_those_measured_elsewhere(
        self, mrclam, published, dataset, robot, rows, unknown,
        median, worst, worst_miss,
    ):  # fmt: skip
        corrected = corrected_landmarks(mrclam / f"MRCLAM_Dataset{dataset}.zip")
        log = published(dataset, robot, landmarks=corrected)
        early = sum(int(n.split()[0]) for n in log.notes if "before the first odometry" in n)
        late = sum(int(n.split()[0]) for n in log.notes if "after the last odometry" in n)
        robots = next(int(n.split()[0]) for n in log.notes if "of other robots" in n)
        assert len(log.recorded.observations.z) + robots + unknown + early + late == rows
        assert noted(log, "that no subject has") == (unknown > 0)
        assert 0.15 <= robots / rows <= 0.24
        miss = misses(log)
        assert np.median(list(miss.values())) == pytest.approx(median, abs=0.003)
        assert max(miss, key=lambda n: miss[n]) == worst
        assert miss[worst] == pytest.approx(worst_miss, abs=0.003)

    @pytest.mark.slow
    def test_the_camera_is_late_not_early(self, published):
        spread = {}
        for latency in (-0.06, 0.04, 0.14):
            log = published(9, 3, calibration=Calibration(latency=latency), exclude_truth=BAD_NINE)
            o, known, pose = log.recorded.observations, log.recorded.map, log.truth.pose
            assert known is not None and pose is not None and log.truth.landmark_of is not None  # noqa: PT018
            places = known.xy[np.searchsorted(known.id, log.truth.landmark_of)]
            residual = log.recorded.sensor.residual(o.z, log.recorded.sensor.predict(pose[o.frame], places))[:, 1]
            known_ones = residual[np.abs(residual) < 0.3]
            spread[latency] = known_ones.std()
        assert spread[0.04] < 0.9 * min(spread[-0.06], spread[0.14])

    def test_the_frozen_corrections_make_dead_reckoning_follow_the_truth(self, published):
        drift = {}
        for name, calibration in (("frozen", FROZEN), ("plain", PLAIN)):
            log = published(9, 3, calibration=calibration, start=165.0, stop=345.0)
            pose = log.recorded.prior.mean
            for step in log.recorded.increments.mean:
                pose = se2.compose(pose, step)
            assert log.truth.pose is not None
            drift[name] = abs(se2.pose_error(pose, log.truth.pose[-1])[2])
        assert drift["frozen"] < 0.5 < drift["plain"]
