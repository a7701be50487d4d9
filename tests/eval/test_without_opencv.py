"""What works without OpenCV, and what says how to install it."""

import subprocess
import sys

import pytest

WITHOUT = "import sys; sys.modules['cv2'] = None; from eval.{} import main; sys.exit(main(sys.argv[1:]))"
INSTALL = "images and films need OpenCV: pip install 'slamref[images]'"


def command(name, *words):
    return subprocess.run(
        [sys.executable, "-c", WITHOUT.format(name), *map(str, words)], capture_output=True, text=True, timeout=300
    )


def test_a_log_is_run_and_its_report_written(tmp_path):
    done = command("run_all", "arena:0:frames=40", "--estimator", "ekf", "--task", "slam", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    report = (tmp_path / "out" / "report.html").read_text()
    assert "data:image/webp;base64," in report
    assert (tmp_path / "out" / "players" / "arena_0_frames=40.html").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("run_all", ["visual:0:frames=3"]),
        ("run_all", ["arena:0:frames=40", "--estimator", "ekf", "--animate", "--jobs", "1"]),
        ("detect", ["docs/arena-slam-map.png", "docs/arena-slam-map.png"]),
        ("step", ["visual:0:frames=3"]),
    ],
)
def test_what_needs_it_ends_with_one_line(name, words, tmp_path):
    done = command(name, *words, *(["--out", tmp_path / "out.png"] if name != "step" else []))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(INSTALL)
    assert "Traceback" not in done.stderr


def test_the_default_suite_leaves_the_camera_out():
    names = "sys.modules['cv2'] = None; from eval.plan.experiments import _gallery; print(_gallery(print))"
    done = subprocess.run([sys.executable, "-c", f"import sys; {names}"], capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines() == [f"visual:0:frames=60 is left out: {INSTALL}", "[]"]
