"""Files of a report: runs read back, facts as JSON, films, notices in their places, and what was revised."""

import json
import math
from dataclasses import dataclass, replace
from enum import StrEnum
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from data import words
from data.formats.results.tables import companions
from data.notice import Code, Severity, notice
from data.result import DISCARD, NEW, Innovations, Systematics
from data.worlds.registry import named_log
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.replay.run import step_by_step
from eval.report import steps
from eval.report.page.blocks import Report, Section
from eval.report.publish import films_of, trajectory_table, write_films, write_run, write_truths, write_tum
from eval.report.render import write_report
from eval.report.writing import as_json, write_facts
from eval.run_all import main
from tests.builders.tables import rows
from tests.eval.handmade import FRAMES, SIGMA, circle_log, run_with_error, true_path
from wings.labs.stepping.text import write_lab_text

OFF = np.array([0.1, -0.1, 0.02])


def written(folder, run, log=None):
    log = circle_log(name="my:log") if log is None else log
    place = write_run(folder, Trial(log, run.task, (run,)), run)
    assert place == folder / "runs" / "my_log" / f"{run.task}-{run.estimator}-{run.association}"
    return place


def test_a_path_is_a_row_per_frame_with_covariance_innovations_and_state(tmp_path):
    run = run_with_error(OFF)
    P = np.arange(9.0).reshape(3, 3)
    path = replace(run.online, covariance=np.tile(P + P.T, (FRAMES, 1, 1)))
    table = trajectory_table(np.arange(FRAMES) * 0.5, path)
    assert len(table) == FRAMES
    assert table.iloc[:, 0].tolist() == [0.5 * k for k in range(FRAMES)]
    np.testing.assert_allclose(table.iloc[:, 1:4].astype(float), path.pose)
    assert table.iloc[3, 4:].tolist() == [0.0, 4.0, 8.0, 8.0, 12.0, 16.0]
    run = replace(
        run_with_error(OFF), state_size=np.arange(3, 3 + FRAMES),
        innovations=Innovations(np.zeros(FRAMES), np.zeros(FRAMES, int), -np.arange(float(FRAMES)), np.zeros((4, 2))),
    )  # fmt: skip
    table = pd.read_csv(written(tmp_path, run) / "online.csv")
    assert table["state_size"].tolist() == list(range(3, 3 + FRAMES))
    assert table["log_likelihood"].tolist() == [-k for k in range(FRAMES)]
    np.testing.assert_allclose(table[["c_xx", "c_yy"]], np.tile(SIGMA[:2] ** 2, (FRAMES, 1)))


def test_a_smoother_has_both_paths_each_with_its_own_systematic_errors(tmp_path):
    def errors(value):
        return Systematics(("scale",), np.full((FRAMES, 1), value), np.full((FRAMES, 1), 0.1 * value))

    run = run_with_error(OFF, estimator="isam2", phases=("online", "final"))
    run = replace(run, errors_online=errors(1.0), errors_final=errors(2.0))
    place = written(tmp_path, run)
    for phase, value in (("online", 1.0), ("final", 2.0)):
        table = pd.read_csv(place / f"{phase}.csv")
        assert set(table["scale"]) == {value}
        np.testing.assert_allclose(table["sigma_scale"], 0.1 * value)
        assert (place / f"{phase}.tum").exists()
    assert "state_size" not in pd.read_csv(place / "final.csv")
    assert "log_likelihood" not in pd.read_csv(place / "final.csv")


def test_a_tum_path_has_the_heading_as_a_quaternion_about_z_and_leaves_out_what_is_not_known(tmp_path):
    pose = np.array([[1.0, 2.0, np.pi / 2], [np.nan, 0.0, 0.0], [3.0, 4.0, -0.4]])
    write_tum(tmp_path / "path.tum", np.array([0.5, 1.0, 1.5]), pose)
    rows = np.loadtxt(tmp_path / "path.tum")
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        rows, [[0.5, 1, 2, 0, 0, 0, half, half], [1.5, 3, 4, 0, 0, 0, np.sin(-0.2), np.cos(0.2)]], atol=1e-15
    )


def test_true_paths_are_written_once_for_each_log_that_has_one(tmp_path):
    blind = circle_log(truth=False, name="blind")
    unknown = circle_log(name="unknown")
    unknown = replace(unknown, truth=replace(unknown.truth, pose=np.full((FRAMES, 3), np.nan)))
    write_truths(tmp_path, [Trial(log, "slam", ()) for log in (circle_log(name="my:log"), blind, unknown)])
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.tum")] == ["runs/my_log/truth.tum"]
    np.testing.assert_allclose(np.loadtxt(tmp_path / "runs/my_log/truth.tum")[:, 1:3], true_path()[:, :2])


def test_decisions_are_judged_in_both_phases_where_the_truth_is_known(tmp_path):
    run = replace(
        run_with_error(OFF), decisions=np.array([NEW, 0, DISCARD, 0]), final_decisions=np.array([NEW, 0, 0, DISCARD])
    )
    table = pd.read_csv(written(tmp_path, run) / "decisions.csv")
    assert table["frame"].tolist() == [0, 1, 2, 3]
    assert table["observation"].tolist() == [0, 0, 0, 0]
    assert table["decision"].tolist() == [NEW, 0, DISCARD, 0]
    assert table["final_decision"].tolist() == [NEW, 0, 0, DISCARD]
    assert table["truth"].tolist() == [-1, 0, 0, 0]
    assert table["outcome"].str.upper().tolist() == ["TN", "TP", "FN", "TP"]
    assert table["final_outcome"].str.upper().tolist() == ["TN", "TP", "TP", "FN"]
    log = circle_log(name="my:log")
    unjudged = replace(log, truth=replace(log.truth, landmark_of=None))
    table = pd.read_csv(written(tmp_path, run, unjudged) / "decisions.csv")
    assert table[["truth", "outcome", "final_outcome"]].isna().all(axis=None)


def test_a_landmark_that_begins_with_another_observation_is_written_with_its_number_there(tmp_path):
    """And what is written says all: which observation each landmark begins with, and so every outcome."""
    run = replace(
        run_with_error(OFF), decisions=np.array([NEW, 0, 0, 0]), final_decisions=np.array([DISCARD, 0, NEW, 0]),
        created=np.array([0, -1, -1, -1]), begun=np.array([-1, -1, 0, -1]),
    )  # fmt: skip
    place = written(tmp_path, run)
    table = pd.read_csv(place / "decisions.csv")
    assert table["final_decision"].tolist() == [DISCARD, 0, 0, 0]
    assert table["final_outcome"].str.upper().tolist() == ["TN", "TP", "TN", "TP"]
    assert companions(place).decisions[:, 4].tolist() == run.begun.tolist()


def test_landmarks_have_their_true_ids_and_what_was_seen_of_them(tmp_path):
    (row,) = pd.read_csv(written(tmp_path, run_with_error(OFF)) / "landmarks.csv").to_dict("records")
    assert (row["landmark"], row["true_id"], row["first_frame"], row["times_seen"]) == (0, 3, 0, 4)
    assert (row["x"], row["y"], row["c_xx"], row["c_xy"], row["c_yy"]) == pytest.approx((6.1, 0.1, 0.04, 0.0, 0.04))
    assert pd.isna(row["ambiguous"])


def test_dead_reckoning_decides_nothing_and_has_no_map_and_slam_without_one_is_a_mistake(tmp_path):
    wheels = replace(run_with_error(OFF, estimator="dead-reckoning", mapped=False), association="none")
    place = written(tmp_path, wheels)
    write_lab_text(place, Output(lab_text=True), Trial(circle_log(), "slam", (wheels,)), wheels)
    assert sorted(p.name for p in place.iterdir()) == ["online.csv", "online.tum"]
    with pytest.raises(AssertionError, match="no map"):
        written(tmp_path, run_with_error(OFF, mapped=False))
    known = run_with_error(OFF, mapped=False, task="localization")
    names = {p.name for p in written(tmp_path, known, circle_log(name="my:log", known_map=True)).iterdir()}
    assert names == {"online.csv", "online.tum", "decisions.csv"}


def test_a_landmark_that_left_has_the_frame_of_its_last_observation(tmp_path):
    run = step_by_step("ekf", named_log("arena:0:frames=20").inputs(labels=True).without_map(), "slam")
    gone = int(run.map.number[2])
    log = named_log("arena:0:frames=20")
    table = pd.read_csv(written_of(tmp_path, replace(run, left=np.array([gone])), log)).set_index("landmark")
    last = log.recorded.observations.frame[run.final_decisions == gone].max()
    assert table["until"].dropna().to_dict() == {gone: last}


def written_of(folder, run, log):
    write_run(folder, Trial(log, run.task, (run,)), run)
    (found,) = folder.glob("runs/*/*/landmarks.csv")
    return found


class Word(StrEnum):
    GOOD = "good"


@dataclass(frozen=True)
class Facts:
    size: float
    word: Word
    many: np.ndarray
    names: frozenset[str]


def test_every_kind_of_fact_becomes_plain_values():
    made = as_json(Facts(math.nan, Word.GOOD, np.array([[1.0, math.inf]]), frozenset({"b", "a"})))
    assert made == {"size": None, "word": "good", "many": [[1.0, None]], "names": ["a", "b"]}
    assert as_json({("ekf", "known"): np.int64(3)}) == {"ekf known": 3}
    with pytest.raises(TypeError, match="object is no fact"):
        as_json([object()])


def test_the_file_holds_what_stands_first_and_the_facts_of_sections_that_have_some(tmp_path):
    sections = [Section("A", ()), Section("B", (), facts={"n": 2})]
    write_facts(tmp_path, {"logs": ["a"]}, sections)
    first = (tmp_path / "report.json").read_bytes()
    assert json.loads(first) == {"logs": ["a"], "sections": [{"heading": "B", "facts": {"n": 2}}]}
    write_facts(tmp_path, {"logs": ["a"]}, sections)
    assert (tmp_path / "report.json").read_bytes() == first


def test_runs_that_differ_in_their_association_alone_get_a_film_each_and_the_report_shows_them(tmp_path):
    log = circle_log(name="corridor:0")
    runs = tuple(run_with_error(np.zeros(3), association=name) for name in ("known", "nn", "jcbb", "jcbb-first"))
    trial = Trial(log, "slam", runs)
    assert films_of(tmp_path, trial) == []
    write_films(tmp_path, trial, speed=400.0)
    names = [f"corridor_0-slam-ekf-{name}.webm" for name in ("known", "nn", "jcbb", "jcbb-first")]
    assert sorted(f.name for f in (tmp_path / "figures").iterdir()) == sorted(names)
    films = films_of(tmp_path, trial)
    write_report(tmp_path, Report("Films", "command", ("",), (Section("Log", tuple(films)),)))
    html, text = ((tmp_path / f"report.{kind}").read_text(encoding="utf-8") for kind in ("html", "md"))
    for name in names:
        assert f'src="figures/{name}"' in html
        assert f'<a href="figures/{name}">' in html
        assert f"(figures/{name})" in text
    assert html.count("<video controls") == 4
    assert "default-src 'none'" in html
    assert "media-src 'self' file:" in html


SHORT = "arena:0:frames=12"
ABOUT = {"log": SHORT, "task": "slam", "estimator": "ekf", "association": "known", "frame": 3}


class Marks:
    """For each code a macro that says the code alone, whatever its values."""

    def __getattr__(self, name):
        return lambda *_, **__: f"«{name.replace('_', '-')}»"


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    out = tmp_path_factory.mktemp("codes") / "report"
    templates, found = words.environment, steps.notices
    marked = SimpleNamespace(get_template=lambda _: SimpleNamespace(module=Marks()))
    with pytest.MonkeyPatch.context() as patch:
        said: list[str] = []
        patch.setattr(words, "environment", lambda package: marked if package == "data" else templates(package))
        every = [notice(code).about(**ABOUT) for code in Code]
        patch.setattr(steps, "notices", lambda trials, scores, known: found(trials, scores, [*known, *every]))
        patch.setattr("eval.plan.console.say", said.append)
        run = ["--log", SHORT, "--task", "slam", "--estimator", "ekf", "--association", "known", "--no-plots"]
        main([*run, "--out", str(out), "--jobs", "1"])
    report = (out / "report.md").read_text(encoding="utf-8")
    sections = {name: report.partition(f"## {name}\n")[2].partition("\n## ")[0] for name in ("Warnings", "Failures")}
    notes = report.partition("Notes on the log and its runs")[2].partition("</details>")[0]
    return {"terminal": "\n".join(said), **sections, "notes": notes, "notices.csv": rows(out / "notices.csv")}


PLACES = {
    Severity.ERROR: {"terminal", "Failures"}, Severity.WARNING: {"terminal", "Warnings"}, Severity.INFO: {"notes"},
}  # fmt: skip


@pytest.mark.parametrize("place", ["terminal", "Warnings", "Failures", "notes"])
def test_each_code_stands_once_where_its_severity_belongs_and_nowhere_else(places, place):
    there = {code: places[place].count(f"«{code}»") for code in Code}
    assert there == {code: int(place in PLACES[code.severity]) for code in Code}


def test_the_table_has_every_code_with_its_severity_errors_first(places):
    rows = places["notices.csv"]
    assert {r["code"]: r["severity"] for r in rows if r["frame"] == "3"} == {c.value: c.severity.value for c in Code}
    order = [Severity(r["severity"]) for r in rows]
    assert order == sorted(order, key=[Severity.ERROR, Severity.WARNING, Severity.INFO].index)
