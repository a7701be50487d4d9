"""Standard errors of `eval.tune` are as large as its errors are, on simulated logs."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from data.formats.open_log import load_folder
from eval.tuning import fit, make_model, pairings, read_odometry
from tests.eval.tuning.stamped import Stamped, stamped_folder

LOGS = 200
FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)


def varied(seed):
    """Latency 0 or 0.05 s either way, sigmas stated 1/4 to 4 times the true ones, biases or none, on stamps or not."""
    rng = np.random.default_rng([seed, 1])
    return Stamped(
        latency=(0.0, 0.05, -0.05)[seed % 3], stated=tuple(float(f) for f in rng.choice(FACTORS, 2)),
        bias=((0.0, 0.0), (0.1, 0.02))[seed % 2], over=((1.0, 1.0), (1.04, 0.97))[seed // 2 % 2],
        offset=(0.0, 0.02)[seed // 4 % 2], noise=(1.0, 2.0)[seed // 8 % 2], seed=seed,
    )  # fmt: skip


def deviations(folder, true):
    """Error over standard error of every parameter that was fitted, by name."""
    inputs = load_folder(stamped_folder(folder, true)).inputs(labels=True)
    model = make_model(inputs, read_odometry(folder))
    found, truth = fit(model, pairings(inputs)), true.truth()
    z = (found.theta - [p.parameter(truth[p.name]) for p in model.parameters]) / found.error
    return {p.name: float(e) for p, e in zip(model.parameters, z)}


@pytest.mark.slow
def test_95_percent_intervals_cover_the_truth_in_90_to_100_percent_of_logs(tmp_path):
    """Measured over 200 logs: coverage, mean and root mean square of error over standard error.

    motion_v        91.5 %  -0.40  1.13      bias_range      96.0 %  +0.03  0.99
    motion_omega    92.0 %  -0.19  1.05      bias_bearing    95.5 %  +0.02  1.00
    sigma_range     96.0 %  -0.05  0.97      odometry_v      91.0 %  -0.05  1.14
    sigma_bearing   92.5 %  -0.08  1.01      odometry_omega  93.5 %  -0.44  1.07
    latency         92.0 %  +0.01  1.03

    200 logs, because the share of 100 has itself a standard error of 2 to 3 %: in the first 100 odometry_v is covered
    in 87 %, in the second in 95 %. Motion noise is found a little small, as variances are by maximum likelihood;
    odometry scales are shrunk, as `eval.tuning` says.
    """
    with threadpool_limits(1):
        logs = [deviations(tmp_path / str(seed), varied(seed)) for seed in range(LOGS)]
    for name in logs[0]:
        errors = np.array([log[name] for log in logs if np.isfinite(log[name])])
        assert len(errors) > 0.95 * LOGS, name
        assert np.mean(np.abs(errors) < 1.96) >= 0.9, name
