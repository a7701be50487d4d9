"""Files as `smfeval` writes them: wide TUM, a file of covariances, and its SQUARE header with what it declares."""

from __future__ import annotations

import numpy as np
import pytest
from smfeval.align import propagate_step
from smfeval.format import Gauge, Representation, SquareHeader, TangentConvention, TangentOrder
from smfeval.io.header import write_header
from smfeval.io.triangular import pack_lower_triangular
from smfeval.io.writer import write_steps
from smfeval.se3.lie import pose_matrix
from smfeval.steps import GaussianStep

from data.formats.results.path import LEFT, LOCAL, Manner
from data.formats.results.reading import read_path

CONVENTIONS = {LOCAL: TangentConvention.RIGHT, LEFT: TangentConvention.LEFT}


def steps(n=12, order=TangentOrder.TRANS_ROT):
    """Tilted poses with full covariances; of order rotation first, the same ones written in that order."""
    rng = np.random.default_rng(4)
    swap = [0, 1, 2, 3, 4, 5] if order is TangentOrder.TRANS_ROT else [3, 4, 5, 0, 1, 2]
    made = []
    for k in range(n):
        half = rng.normal(0.0, [0.05, 0.08, 1.0]) / 2.0
        q = np.array([*half, 1.0])
        root = 0.05 * rng.normal(size=(6, 6))
        C = (root @ root.T)[np.ix_(swap, swap)]
        made.append(GaussianStep(0.1 * k, rng.normal(0.0, 3.0, 3), q / np.linalg.norm(q), C))
    return made


def header(frame=LOCAL, order=TangentOrder.TRANS_ROT, **more):
    kind = Representation.GAUSSIAN_SE3
    common = ("SQUARE/0.3", kind, "world", "robot", Gauge.SE3, "seconds", "mine", "1")
    return SquareHeader(*common, CONVENTIONS[frame], order, "axis_angle", **more)


def square(path, made, head):
    with path.open("w") as file:
        write_header(file, head)
        write_steps(file, made, head)
    return str(path)


def wide(path, made, columns=slice(None)):
    rows = [[s.timestamp, *s.translation, *s.quat_xyzw, *pack_lower_triangular(s.covariance)] for s in made]
    np.savetxt(path, np.array(rows)[:, columns], fmt="%.17g")
    return str(path)


def test_wide_a_sidecar_and_a_header_say_the_same(tmp_path):
    made = steps()
    wanted = read_path(square(tmp_path / "square", made, header()))
    plain = wide(tmp_path / "plain.tum", made, slice(0, 8))
    side = wide(tmp_path / "side.cov", made, [0, *range(8, 29)])
    assert wanted.frame == LOCAL
    for path in (
        read_path(wide(tmp_path / "wide.tum", made)),
        read_path(plain, Manner(cov=tmp_path / "side.cov")),
        read_path(
            square(tmp_path / "other", steps(order=TangentOrder.ROT_TRANS), header(order=TangentOrder.ROT_TRANS))
        ),
    ):
        assert path.pose == pytest.approx(wanted.pose, abs=1e-9)
        assert path.covariance == pytest.approx(wanted.covariance, rel=1e-12, abs=1e-15)
    assert side
    assert read_path(plain).covariance is None


def test_a_sidecar_declares_its_own_frame(tmp_path):
    made = steps()
    wide(tmp_path / "side", made, [0, *range(8, 29)])
    text = (tmp_path / "side").read_text()
    (tmp_path / "side").write_text("#%TANGENT_CONVENTION left_perturbation\n" + text)
    path = read_path(wide(tmp_path / "plain.tum", made, slice(0, 8)), Manner(cov=tmp_path / "side"))
    wanted = read_path(square(tmp_path / "square", made, header(LEFT)))
    assert path.frame == LEFT
    assert path.covariance == pytest.approx(wanted.covariance, rel=1e-12, abs=1e-15)


def test_turning_a_path_turns_its_covariance_as_smfeval_does(tmp_path):
    """The NEES of errors does not change if truth and estimate are moved alike, whatever the frame."""
    T = pose_matrix(np.array([3.0, -1.0, 0.0]), np.array([0.0, 0.0, np.sin(0.4), np.cos(0.4)]))
    for frame in (LOCAL, LEFT):
        made = steps()
        moved = [propagate_step(s, T, 1.0, CONVENTIONS[frame], TangentOrder.TRANS_ROT) for s in made]
        before = read_path(square(tmp_path / "a", made, header(frame))).covariance
        after = read_path(square(tmp_path / "b", moved, header(frame))).covariance
        J = np.eye(3)
        J[:2, :2] = T[:2, :2]
        assert after == pytest.approx(J @ before @ J.T, rel=1e-9, abs=1e-12)
