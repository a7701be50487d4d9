"""`python -m eval.step` walks through a log, pauses only where somebody sits, and leaves nothing half done."""

import builtins
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

from data.log import shortened
from data.logs import open_log
from eval.referee.plausibility import with_plausibility
from eval.replay.run import step_by_step
from eval.replay.settings import Setup
from wings.labs.stepping import command as step, pictures
from wings.labs.stepping.command import main
from wings.labs.stepping.pictures import ImageWriter, picture_axes
from wings.labs.stepping.stepper import Walk
from wings.labs.stepping.text import run_text

STAGES = ("prediction", "ground-truth", "observations", "compatibility", "matching", "map")
PNG_END = b"IEND\xaeB`\x82"


@pytest.fixture
def sitting(monkeypatch):
    """Somebody sits at a terminal; the fixture sets what is typed at each pause."""
    asked: list[str] = []

    def install(answer) -> list[str]:
        def typed(prompt: str = "") -> str:
            asked.append(prompt)
            return answer(len(asked))

        monkeypatch.setattr(builtins, "input", typed)
        monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
        return asked

    return install


@pytest.fixture(autouse=True)
def no_windows(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # no report of a lab is here
    for name in pictures.SCREENS:
        monkeypatch.delenv(name, raising=False)


def whole(folder: Path) -> set[str]:
    """Names of the files of a folder, each of which is complete."""
    for path in folder.glob("*.png"):
        assert path.read_bytes().endswith(PNG_END)
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_a_run_through_writes_a_picture_of_every_stage_and_all_text(tmp_path, capsys):
    arguments = ["corridor:0", "--task", "slam", "--association", "jcbb", "--frames", "2", "--run-through"]
    assert main([*arguments, "--save", str(tmp_path / "new" / "steps")]) == 0
    out, err = capsys.readouterr()
    expected = {f"step-{k:03d}-{stage}.png" for k in range(2) for stage in STAGES}
    # the first cycle has no motion, and nothing to match with
    expected -= {f"step-000-{stage}.png" for stage in ("prediction", "compatibility", "matching")}
    assert whole(tmp_path / "new" / "steps") == expected | {"error.png", "steps.txt"}
    assert (tmp_path / "new" / "steps" / "steps.txt").read_text() == out
    assert "whole run: 24 observations in 2 steps" in out
    assert "position RMSE [m]" in out
    assert err == ""


@pytest.mark.parametrize("arguments", [
    ["--task", "slam"], ["--task", "slam", "--association", "nn", "--maintain", "--new-gate", "0.99"],
    pytest.param(["--task", "slam", "--association", "known"], marks=pytest.mark.slow),
    ["--task", "localization", "--association", "ml", "--gate", "none"],
    pytest.param(["--task", "slam", "--association", "gnn", "--in-view"], marks=pytest.mark.slow),
    ["--task", "slam", "--estimator", "isam2", "--frames", "12"],
])  # fmt: skip
def test_what_is_printed_on_the_way_is_what_the_referee_says_in_the_end(arguments, capsys):
    assert main(["--log", "corridor:0:people", "--run-through", *arguments]) == 0
    out = capsys.readouterr().out
    given = dict(zip(arguments[::2], arguments[1::2])) if "--maintain" not in arguments else {"--association": "nn"}
    if "--maintain" not in arguments and "--frames" not in arguments:
        log = open_log("corridor:0:people")
        association, task = given.get("--association", "jcbb"), given.get("--task", "slam")
        inputs = log.inputs(labels=association == "known")
        inputs = inputs.without_map() if task == "slam" else inputs
        setup = step.read(["--log", "corridor:0:people", *arguments]).options.setup
        run = with_plausibility(step_by_step("ekf", inputs, task, association, setup), inputs)
        assert out.startswith(run_text(log, run))
    sums = np.array([line.split()[1::2] for line in out.split("\n") if line.startswith("TP") and "FN" in line], int)
    counts = {line[:2]: int(line.split()[1]) for line in out.split("\n") if line.endswith("%")}
    assert dict(zip(("TP", "TN", "FP", "FN"), sums.sum(axis=0).tolist())) == counts


def blind(names):
    """Windows that nobody looks at: what is painted is never rendered; their names are kept."""

    def figure(num: str, clear: bool) -> Figure:
        assert clear
        names.append(num)
        return Figure()

    return SimpleNamespace(figure=figure, pause=lambda seconds: None)


def test_looking_on_changes_no_number(monkeypatch):
    monkeypatch.setattr(ImageWriter, "show", lambda *_: None)  # asks for all that pictures need, and paints none
    log = open_log("corridor:0:people")
    for estimator in ("ekf", "isam2"):
        for association in ("known", "jcbb"):
            short = shortened(log, 10).inputs(labels=association == "known").without_map()
            walk = Walk(log, "slam", estimator, ImageWriter(None, blind([])), pausing=False)
            seen = step_by_step(estimator, short, "slam", association, observer=walk, finish=False)
            alone = step_by_step(estimator, short, "slam", association, finish=False)
            assert np.array_equal(seen.online.pose, alone.online.pose)
            assert np.array_equal(seen.online.covariance, alone.online.covariance)
            assert np.array_equal(seen.decisions, alone.decisions)


@pytest.mark.slow
def test_the_order_is_move_observe_compatibility_matching_update(sitting, monkeypatch, capsys):
    asked = sitting(lambda n: "")
    names = []
    monkeypatch.setattr(pictures, "open_windows", lambda: blind(names))
    assert main(["--log", "corridor:0", "--task", "slam", "--frames", "2"]) == 0
    stages = [prompt.strip(" []").split(";")[0] for prompt in asked]
    cycle = ["move", "observe", "compatibility", "matching", "update"]
    assert stages == ["observe", "update", *cycle, "end"]
    second = ["ground-truth", "map", "observations", "compatibility", "matching", "map"]
    assert names == ["ground-truth", "observations", "map", *second, "error"]
    out = capsys.readouterr().out
    assert "step 1, move: odometry 1.0" in out
    assert "step 1, compatibility: " in out


def test_typing_r_runs_through_and_q_stops(sitting, capsys):
    asked = sitting(lambda n: "r" if n == 3 else "")
    assert main(["--log", "corridor:0", "--frames", "4"]) == 0
    assert len(asked) == 3
    assert "whole run" in capsys.readouterr().out
    asked.clear()
    sitting(lambda n: "q")
    assert main(["--log", "corridor:0", "--frames", "4"]) == 0
    assert "whole run" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "status", "at"), [(KeyboardInterrupt, 130, 5), (EOFError, 0, 1)])
def test_interrupt_and_end_of_file_at_a_pause_end_in_one_line_and_leave_whole_files(
    fault, status, at, sitting, tmp_path, capsys
):
    def answer(n: int) -> str:
        if n == at:
            raise fault
        return ""

    asked = sitting(answer)
    assert main(["--log", "corridor:0", "--task", "slam", "--save", str(tmp_path)]) == status
    out, err = capsys.readouterr()
    assert len(asked) == at
    first = {f"step-000-{stage}.png" for stage in ("ground-truth", "observations")}
    more = {f"step-001-{stage}.png" for stage in ("prediction", "ground-truth", "observations", "compatibility")}
    assert whole(tmp_path) == (first if at == 1 else first | {"step-000-map.png"} | more)
    said = err if status else out.rstrip().split("\n")[-1] + "\n"
    assert said.count("\n") == 1
    assert "files written so far are complete" in said
    assert "Traceback" not in out + err


def test_an_interrupt_while_a_file_is_written_leaves_no_part_of_it(tmp_path, monkeypatch):
    def interrupted(self: Path, target: Path) -> Path:
        raise KeyboardInterrupt

    saved = ImageWriter(tmp_path, None)
    saved.write("one.png", b"whole")
    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        saved.write("one.png", b"other")
    with pytest.raises(KeyboardInterrupt):
        saved.write("two.png", b"other")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("one.png", b"whole")]


@pytest.mark.parametrize(("arguments", "words"), [
    ([], "no log: one log is needed"), (["--log", "nowhere"], "no such log or folder"),
    (["--log", "corridor:0", "--log", "arena:0"], "one log is needed"),
    (["--log", "corridor:0", "--gate", "1"], "between 0 and 1"),
    (["--log", "corridor:0", "--gate", ""], "a number is needed"),
    (["--log", "corridor:0", "--new-gate", "wide"], "a number is needed"),
    (["--log", "corridor:0", "--association", "guess"], "known: known, nn, ml"),
    (["--log", "corridor:0", "--association", "nn,ml"], "one name is needed"),
    (["--log", "corridor:0", "--association", ""], "one name is needed"),
    (["--log", "corridor:0", "--estimator", "batch"], "ekf, ekf-iterated, ekf-fej, ekf-invariant, isam2, fixed-lag do"),
    (["--log", "corridor:0", "--task", "mapping"], "known: localization, slam"),
    (["--log", "corridor:0", "--frames", "0"], "a whole number from 1 up"),
    (["--log", "corridor:0", "--frames", "1.5"], "a whole number is needed"),
    (["--log", "victoria-park", "--task", "localization"], "has no map"),
    (["--log", "corridor:0", "--save", __file__], "--save"),
    (["corridor:0", "--maintain", "--run-through"], "for slam only; type --task slam"),
])  # fmt: skip
def test_nonsense_is_one_line_and_exit_2(arguments, words, refused):
    assert words in refused(main, arguments)


def test_help_explains_every_flag_and_shows_it(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    out = capsys.readouterr().out
    assert "python -m eval.step corridor:0 --association jcbb" in out
    for flag in ("--association", "--estimator", "--task", "--gate", "--new-gate", "--in-view", "--maintain",
                 "--save", "--run-through", "--frames"):  # fmt: skip
        assert out.count(flag) >= 2, flag  # explained, and shown


WINDOWS = SimpleNamespace(figure=pyplot.figure, pause=lambda _: None)
"""pyplot as `Album` uses it, where nobody sees the windows; `draw_idle` draws at once."""


def test_apicture_axes_that_is_saved_and_drawn_again_needs_no_layout(tmp_path):
    """Warnings are errors here; seen: layoutgrids, of a figure whose axes stand where they were put."""
    images = ImageWriter(tmp_path, WINDOWS)
    try:
        for step in ("1", "2"):
            images.show("picture", lambda fig: picture_axes(fig).plot([0.0, 1.0]), step)
            pyplot.figure("picture").canvas.draw()
    finally:
        pyplot.close("all")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1.png", "2.png"]


@pytest.mark.slow
def test_windows_are_drawn_again_and_again_without_a_warning(tmp_path):
    log = shortened(open_log("corridor:0:people"), 2)
    walk = Walk(log, "slam", "ekf", ImageWriter(tmp_path, WINDOWS), pausing=False)
    try:
        step_by_step("ekf", log.inputs().without_map(), "slam", "jcbb", Setup(), observer=walk)
        assert len(pyplot.get_fignums()) > 2
    finally:
        pyplot.close("all")
