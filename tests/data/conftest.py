"""Small valid log folders, as texts by file name, for the tests of reading them."""

from collections.abc import Callable
from pathlib import Path

import pytest

Files = dict[str, str]

_TOML = """\
format = 1
name = "small"
labels_are_sensed = true
notes = ["made by hand"]
{motion}
[prior]
mean = [1.0, 2.0, 0.5]
{prior}
[sensor]
kind = "{kind}"
{sigma}
max_range = 8.0
{view}
rotation = 0.1
translation = [0.2, -0.1]
[source]
maker = "hand"
"""

_MOTION = """\
[motion]
model = "unicycle"
noise = "density"
sigma = [0.05, 0.02]"""

_FRAMES = """\
t,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt
0,0,0,0,0,0,0,0,0,0
0.5,0.25,0.01,0.1,1e-3,1e-4,0,2e-3,1e-5,1e-4
1.25,0.5,-0.02,-0.3,1e-3,0,0,2e-3,0,1e-4
2,0,0,0,0,0,0,0,0,0
"""

_ODOMETRY = """\
t,v,omega
10,0.5,0.1
10.5,0.6,-0.2
11,0,0
13.25,0.4,0.3
13.5,0.4,0.3
"""

_OBSERVATIONS = {
    "frames": """\
frame,z1,z2,r11,r12,r22,true_id,label
0,2.5,0.25,0.01,0.001,0.02,3,3
1,1.5,-0.75,0.01,0,0.02,-1,7
1,9.5,1.5,0.01,0,0.02,,
3,3.5,2.5,0.04,0,0.02,7,-1
""",
    "odometry": """\
t,z1,z2,true_id
10.25,2.5,0.25,3
10.25,1.5,-0.75,
12,9.5,1.5,-1
13.75,3.5,2.5,7
""",
}

_TRUTH = {
    "frames": """\
x,y,theta
1,2,0.5
1.2,2.1,0.6
,,
nan,nan,nan
""",
    "odometry": """\
t,x,y,theta
10,1,2,3.1
10.5,1.2,2.1,-3.1
11,,,
11.5,1.5,2,-3
13.4,1.6,2.1,-2.9
13.75,1.7,2.2,-2.8
""",
}

_LANDMARKS = """\
id,x,y,sx,sy
7,4.5,1.25,0.01,0.01
3,-2.5,3,0,0
"""


def small_files(source: str, sensor: str) -> Files:
    """A valid folder that uses most of the format; the two sensors differ in the optional keys as well."""
    polar = sensor == "range_bearing"
    toml = _TOML.format(
        motion=_MOTION if source == "odometry" else "covariance_floor = 1e-9",
        prior="sigma = [0.1, 0.1, 0.05]" if polar else "covariance = [[0.02, 0.01, 0], [0.01, 0.02, 0], [0, 0, 0.01]]",
        kind=sensor,
        sigma="sigma = [0.1, 0.05]" if source == "odometry" else "",
        view="field_of_view = 3.0" if polar else "min_angle = -1.0\nmax_angle = 2.0",
    )
    return {
        "log.toml": toml, f"{source}.csv": _FRAMES if source == "frames" else _ODOMETRY,
        "observations.csv": _OBSERVATIONS[source], "truth.csv": _TRUTH[source], "landmarks.csv": _LANDMARKS,
    }  # fmt: skip


@pytest.fixture(scope="session")
def small_log_files() -> Callable[[str, str], Files]:
    """`small_log_files(source, sensor)`: texts of a valid folder; source `frames` or `odometry`."""
    return small_files


@pytest.fixture(scope="session")
def save() -> Callable[[Path, Files], Path]:
    """`save(folder, files)`: write texts (or bytes) into a folder that need not exist yet; returns it."""

    def write(folder: Path, files: Files) -> Path:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
        return folder

    return write
