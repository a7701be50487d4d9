"""Folders of format 2 with fixes and closures, as texts by file name."""

from tests.data.conftest import Files, small_files

FIX = """
[[fix]]
name = "gps"
lever = [0.3, -0.1]
sigma = [0.5, 0.25]

[[fix]]
name = "compass"
rotation = 0.2
sigma = [0.05]
"""
CLOSURE = """
[[closure]]
name = "laser"
sigma = [0.1, 0.2, 0.01]

[[closure]]
name = "camera"
"""
FIXES = """\
{key},kind,source,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt,true_inlier
{0},position,,1.5,2.25,,,,,,,,1
{0},heading,compass,,,0.75,,,,,,,
{1},pose,gps,1.75,2.5,0.5,0.04,0.01,0,0.09,0,0.01,0
{2},position,gps,2.5,3,,0.25,0.1,,0.16,,,
"""
CLOSURES = """\
{key}1,{key}2,dx,dy,dtheta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt,source,true_inlier
{2},{0},-0.75,0.25,3.25,0.01,0.001,0,0.02,0,0.001,,0
{0},{1},0.25,0.01,0.1,0.01,0,0,0.01,0,0.001,camera,1
"""
AT = {"frames": ("frame", ("0", "1", "3")), "odometry": ("t", ("10.25", "10.75", "13.25"))}


def measured_files(source: str, sensor: str = "range_bearing") -> Files:
    key, at = AT[source]
    files = small_files(source, sensor)
    files["log.toml"] = files["log.toml"].replace("format = 1", "format = 2") + FIX + CLOSURE
    return files | {"fixes.csv": FIXES.format(*at, key=key), "closures.csv": CLOSURES.format(*at, key=key)}
