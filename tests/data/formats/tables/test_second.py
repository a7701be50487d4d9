"""A second odometry in tables of another program: closures between successive frames."""

import numpy as np
import pytest

from data.se2 import between, interpolate

POSES = "t,x,y,theta\n" + "".join(f"{k},{k},0,0\n" for k in range(6))
VELOCITIES = "t,v,omega\n" + "".join(f"{k},1,0\n" for k in range(6))
CAMERA = "t,x,y,theta\n" + "".join(f"{0.5 * k},{0.45 * k},{0.01 * k * k},{0.02 * k}\n" for k in range(2, 10))
SIGMA = {POSES: ("--odometry-sigma", "0.1,0.1,0.1,0.1"), VELOCITIES: ("--odometry-sigma", "0.1,0.1")}


@pytest.fixture
def with_camera(convert):
    """`with_camera(odometry, camera, *words)`: what `convert` gives of these two, as odo.csv and camera.csv."""

    def run(odometry, camera, *words, sigma="0.2,0.1,0.05,0.3", files=None, status=0):
        given = ("--second-odometry", "camera.csv", "--second-odometry-sigma", sigma, *words)
        files = {"odo.csv": odometry, "camera.csv": camera} | (files or {})
        return convert(files, "table", "odo.csv", "out", *SIGMA.get(odometry, SIGMA[POSES]), *given, status=status)

    return run


@pytest.mark.parametrize("odometry", [POSES, VELOCITIES])
def test_poses_become_the_motion_between_the_frames_that_they_cover(with_camera, odometry):
    log, said = with_camera(odometry, CAMERA)
    assert "camera.csv: a second odometry, as closures between 3 of 5 pairs of successive frames, source camera" in said
    r = log.recorded
    assert (r.closures.frame1.tolist(), r.closures.frame2.tolist()) == ([1, 2, 3], [2, 3, 4])
    assert r.closures.sources == ("camera",)
    k = np.arange(2, 10)
    at = interpolate(0.5 * k, np.column_stack([0.45 * k, 0.01 * k * k, 0.02 * k]), r.time[1:5])
    relative = between(at[:-1], at[1:])
    np.testing.assert_allclose(r.closures.relative, relative, atol=1e-12)
    d, turn = np.hypot(*relative[:, :2].T), np.abs(relative[:, 2])
    along, heading = 0.2**2 * d + 0.1**2 * turn, 0.05**2 * d + 0.3**2 * turn
    variance = np.diagonal(r.closures.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(variance, np.column_stack([along, along, heading]))
    assert r.increments.mean[1:, 0] == pytest.approx(1.0), "the first one is the motion, unchanged"


def test_velocities_say_nothing_across_a_gap_and_poses_do(with_camera):
    gap = [0.0, 1.0, 2.0, 4.5, 5.0]
    log, _ = with_camera(POSES, "t,v,omega\n" + "".join(f"{t},1,0\n" for t in gap), sigma="0.1,1deg")
    closures = log.recorded.closures
    assert list(zip(closures.frame1.tolist(), closures.frame2.tolist(), strict=True)) == [(0, 1), (1, 2)]
    assert closures.relative[:, 0] == pytest.approx(1.0)
    assert closures.covariance[0, 2, 2] == pytest.approx(np.radians(1.0) ** 2)
    log, _ = with_camera(POSES, "t,x,y,theta\n" + "".join(f"{t},{t},0,0\n" for t in gap))
    closures = log.recorded.closures
    assert list(zip(closures.frame1.tolist(), closures.frame2.tolist(), strict=True)) == [(0, 1), (1, 2), (2, 5)]
    assert closures.relative[-1] == pytest.approx([3.0, 0.0, 0.0])


def test_beside_closures_it_is_a_source_of_its_own(with_camera):
    loops = {"loops.csv": "t1,t2,dx,dy,dtheta,source\n0,4,4,0,0,camera\n"}
    log, _ = with_camera(VELOCITIES, CAMERA, "--closures", "loops.csv", "--closure-sigma", "1,1,1", files=loops)
    closures = log.recorded.closures
    assert closures.sources == ("camera", "camera odometry")
    assert closures.source.tolist() == [1, 1, 0, 1]
    assert closures.later.tolist() == [2, 3, 4, 4]


@pytest.mark.parametrize(("odometry", "camera", "sigma", "said"), [
    (POSES, POSES, "1,1,1,1", "camera.csv: the motion of the odometry once more; another one is needed"),
    (POSES, "t,left,right\n0,1,1\n1,2,2\n", "1,1,1,1", "--second-odometry camera.csv: wheel ticks; velo"),
    (POSES, "t,x,y,theta\n70,1,0,0\n71,2,0,0\n", "1,1,1,1", "from 70 to 71 s covers 0 frames of 0 to 5 s"),
    (POSES, "x,y,theta\n0,0,0\n1,0,0\n", "1,1,1,1", "no column 't' for t"),
    ("x,y,theta\n0,0,0\n1,0,0\n", "dx,dy,dtheta\n1,0,0\n", "1,1,1,1", "1 row, the odometry has 2; without stamps"),
])  # fmt: skip
def test_one_line_says_what_is_wrong(with_camera, odometry, camera, sigma, said):
    assert said in with_camera(odometry, camera, sigma=sigma, status=2)
