"""Each quantity knows where it comes from, in every converter, through log.toml, to the words that follow it."""

import json

import numpy as np
import pytest

from data.convert.__main__ import main as convert
from data.errors import DataError
from data.logs import open_log
from eval.inspect import main as inspect
from eval.score import main as score
from tests.quick import slow

TABLE = ("--odometry-sigma", "0.05,2deg", "--observation-sigma", "0.1,2deg")
ODOMETRY = "t,v,omega,range,bearing\n0,1,0,5,0\n1,1,0,4,0.1\n2,1,0,3,0.1\n"
G2O = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 2 2 0 0\nEDGE_SE2 0 1 1 0 0{}\nEDGE_SE2 1 2 1 0 0{}\n" + (
    "EDGE_SE2 0 2 2 0 0{}\n"
)
STATED = " 1 0 0 1 0 9"
CARMEN = "".join(f"ODOM {k} 0 0 0 0 0 {k} h {k}\nFLASER 3 1 2 3 0 0 0 0 0 0 {k} h {k}\n" for k in range(3))


@pytest.mark.parametrize(("kind", "text", "flags", "expected"), [
    ("table", ODOMETRY, TABLE, {"odometry_noise": "given", "observation_noise": "given", "sensor_pose": "assumed",
                                "max_range": "inferred"}),
    ("table", ODOMETRY, (*TABLE, "--sensor-pose=0.1,0,0", "--max-range", "9", "--unit", "time=ms"),
     {"odometry_noise": "given", "observation_noise": "given", "sensor_pose": "given", "max_range": "given",
      "units": "given"}),
    ("g2o", G2O.format(*[STATED] * 3), (), {}),
    ("g2o", G2O.format("", STATED, STATED), (), {"odometry_noise": "assumed"}),
    ("g2o", G2O.format(STATED, STATED, ""), (), {"closure_noise": "assumed"}),
    ("carmen", CARMEN, (), {"odometry_noise": "assumed", "range_noise": "assumed", "sensor_pose": "assumed",
                            "max_range": "assumed"}),
])  # fmt: skip
def test_a_log_keeps_where_its_numbers_come_from(tmp_path, monkeypatch, capsys, kind, text, flags, expected):
    monkeypatch.chdir(tmp_path)
    source = {"table": "a.csv", "g2o": "a.g2o", "carmen": "a.log"}[kind]
    (tmp_path / source).write_text(text)
    assert convert([kind, source, "log", *flags]) == 0
    assert open_log("log").origins == expected
    capsys.readouterr()
    assert inspect(["log"]) == 0
    first = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert set(expected.values()) == set(first) & {"given", "assumed", "inferred"}


@pytest.mark.parametrize("line", ['odometry_noises = "given"', 'odometry_noise = "guessed"'])
def test_an_unknown_origin_is_refused(tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(ODOMETRY)
    assert convert(["table", "a.csv", "log", *TABLE]) == 0
    header = tmp_path / "log" / "log.toml"
    header.write_text(header.read_text().replace('odometry_noise = "given"', line))
    with pytest.raises(DataError, match=r"log.toml: \[origin\] odometry_noises?"):
        open_log("log")


@pytest.mark.parametrize("assumed", [True, slow(False)])
def test_nees_nis_and_verdicts_say_that_the_noise_is_assumed(tmp_path, monkeypatch, capsys, assumed):
    from eval.run_all import main as run

    monkeypatch.chdir(tmp_path)
    assert convert(["arena", "log", "--seed", "1", "--frames", "20"]) == 0
    if assumed:
        with (tmp_path / "log" / "log.toml").open("a") as header:
            header.write('[origin]\nodometry_noise = "assumed"\n')
    assert (
        run(["--log", "log", "--estimator", "ekf,batch", "--association", "known", "--no-plots", "--out", "out"]) == 0
    )
    said, words = capsys.readouterr().out, "relative to the assumed odometry noise"
    facts = json.loads((tmp_path / "out" / "report.json").read_text())
    assert facts["logs"][0]["origins"] == ({"odometry_noise": "assumed"} if assumed else {})
    assert (words in said) is assumed
    assert (f"NEES {words}" in (tmp_path / "out" / "report.md").read_text()) is assumed
    path = np.column_stack([open_log("log").recorded.time, np.nan_to_num(open_log("log").truth.pose)])
    np.savetxt("e.csv", np.column_stack([path, np.tile([1, 0, 0, 1, 0, 1], (len(path), 1))]), delimiter=",",
               header="t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt", comments="")  # fmt: skip
    capsys.readouterr()
    assert score(["e.csv", "log"]) == 0
    assert ("the odometry noise is assumed" in capsys.readouterr().err) is assumed
