"""The line on the terminal says pose and 3 sigma, walls, what went wrong on the line, and how long estimates took."""

from __future__ import annotations

import math

import numpy as np

from wings.robot.live.session import Latencies, Step, estimator_words, status_line

NOBODY = np.empty(0, np.int64)
STEP = Step(np.array([1.0, -2.0, 7.0]), np.diag([0.01, 0.04, math.radians(1.0)]) ** 2, NOBODY, NOBODY, 1.0)


def test_a_pose_stands_with_its_three_sigma_and_a_wrapped_heading():
    pose = "x 1.000 ± 0.030, y -2.000 ± 0.120 m, heading 41.1 ± 3.0°"
    assert estimator_words("ekf", STEP, "walls 9", "") == f"ekf {pose}, walls 9"
    assert estimator_words("ekf", STEP, "", "").endswith("°")
    assert estimator_words("ekf", None, "walls 0", "") == "ekf waits"
    assert estimator_words("ekf", STEP, "walls 9", "astray") == "ekf ended"


def test_faults_latency_and_being_late_are_said():
    latencies = Latencies()
    assert status_line(3.0, ["ekf"], {"lost": 0}, latencies, 0.25) == "    3.0 s | ekf | link: no faults"
    latencies.add(0.004)
    line = status_line(3.0, ["ekf"], {"lost": 2, "late": 0, "device gone": 1}, latencies, 0.25)
    assert line.endswith("| link: lost 2, device gone 1 | latency 4.0 ms, 99 % < 4.0 ms")
    latencies.add(0.6)
    assert status_line(4.0, [], {}, latencies, 0.25).endswith("| late: 0.60 s, longer than a period of 0.25 s")
    latencies.begin()
    latencies.add(0.1)
    assert "late:" not in status_line(5.0, [], {}, latencies, 0.25), "of this second, not of ever"
    assert math.isnan(Latencies().within(0.99))
