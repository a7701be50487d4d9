"""Systematic errors of a run: every estimator of ours estimates them, and says what it knew and knows."""

from dataclasses import replace

import numpy as np
import pytest

from data.inputs import ERRORS, Systematic
from data.result import Finished, Systematics, Trajectory
from data.worlds.arena import Arena, simulate
from eval.replay.hindsight.localizing_frontend import Stretches
from eval.replay.hindsight.mapper import TIGHT, MappingFrontEnd
from eval.replay.run import compare
from eval.replay.settings import Beginning, Setup

OF = Systematic(("scale", "curvature", "drift", "range"), np.array([0.02, 2e-3, 1e-3, 0.02]))


@pytest.fixture(scope="module")
def inputs():
    return replace(simulate(Arena(frames=80, landmarks=20), 0).inputs(labels=True), systematic=OF)


@pytest.mark.parametrize("task", ["slam", "localization"])
def test_what_is_known_of_the_errors_comes_with_the_run(inputs, task):
    alone, ekf, batch = compare(inputs, task, ["dead-reckoning", "ekf", "batch"])
    assert (alone.errors_online, alone.errors_final) == (None, None)
    for found in (ekf.errors_online, batch.errors_final):
        assert found.names == OF.names
        assert found.mean.shape == found.sigma.shape == (80, 4)
        assert np.all(found.sigma[-1] < OF.sigma)
    assert (ekf.errors_final, batch.errors_online) == (None, None)
    last = batch.errors_final  # the last frame has seen all that a smoother has
    assert np.all(np.abs(ekf.errors_online.mean[-1] - last.mean[-1]) < 2.0 * last.sigma[-1])


def test_the_hindsight_mapper_estimates_its_own_errors_and_those_of_the_run(inputs):
    beginning = Beginning(inputs.prior, inputs.sensor)
    assert len(MappingFrontEnd("ekf", "jcbb-hindsight", beginning, Setup()).filter.errors[0]) == len(TIGHT.names)
    given = beginning._replace(systematic=OF)
    sigma = dict(zip(TIGHT.names, TIGHT.sigma, strict=True)) | dict(zip(OF.names, OF.sigma, strict=True))
    expected = [sigma[name] for name in ERRORS if name in sigma]
    np.testing.assert_array_equal(
        np.sqrt(np.diag(MappingFrontEnd("ekf", "jcbb-hindsight", given, Setup()).filter.errors[1])), expected
    )
    assert compare(inputs, "slam", ["ekf"], "jcbb-hindsight")[0].errors_online.names == OF.names


def test_a_smoother_begun_anew_has_the_errors_of_all_its_stretches():
    class Smoother:
        """Ends with an error of its number, in every frame that it had."""

        made = 0

        def __init__(self, prior):
            Smoother.made += 1
            self.number, self.frames = Smoother.made, 1

        def stamp(self, time):
            pass

        def predict(self, increment):
            self.frames += 1

        def finish(self):
            n = self.frames
            path = Trajectory(np.zeros((n, 3)), np.zeros((n, 3, 3)))
            mean = np.full((n, 1), float(self.number))
            return Finished(path, None, None, systematic=Systematics(("scale",), mean, 0.1 * mean))

    smoother = Stretches(Smoother, None)
    for k in range(5):
        if k == 3:
            smoother.reset(np.zeros(3), np.eye(3))
        smoother.predict(None)
    found = smoother.finish()
    assert found.systematic.names == ("scale",)
    assert found.systematic.mean.ravel().tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    assert len(found.final.pose) == 6
