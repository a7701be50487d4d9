"""Question 4 over several seeds: the numbers of one seed are the referee's, their mean and spread those by hand."""

from __future__ import annotations

from dataclasses import replace

import pytest

from data.logs import open_log
from data.words import number, percent
from eval.compare import compare
from eval.plan.experiment import Unfinished
from eval.plan.flags.options import read_options
from eval.referee.score import Trial, score
from eval.replay.settings import Setup
from eval.report.comparison import comparison_table
from eval.report.page.blocks import Table, every_block
from tests.eval.handmade_lab import lab_log
from wings.labs import sections as seeds
from wings.labs.sections import SEED_METHODS as METHODS
from wings.labs.sections import Seed, hand_in, one_seed, over_seeds, seed_jobs, seeds_table

SETUP = Setup(new_gate=0.99)
NAME = "corridor:3:people"


@pytest.fixture(scope="module")
def trial() -> Trial:
    log = open_log(NAME)
    runs = [
        r for m in METHODS for r in compare(log.inputs(labels=m == "known").without_map(), "slam", ("ekf",), m, SETUP)
    ]
    return Trial(log, "slam", tuple(runs))


@pytest.mark.slow
def test_a_seed_has_the_numbers_of_the_referee(trial):
    seed, scores = one_seed(NAME, SETUP), score([trial])
    for method, (fp, fn, rmse, aligned) in zip(METHODS, seed.outcomes, strict=True):
        row = scores.metrics[scores.metrics["association"] == method].iloc[0]
        counts = scores.association[scores.association["association"] == method].iloc[0]
        assert (fp, fn) == (counts["fp"], counts["fn"])
        assert rmse == pytest.approx(row["rmse_position_m"], rel=1e-9)
        assert aligned == pytest.approx(row["rmse_aligned_m"], rel=1e-9)
    assert one_seed(NAME, SETUP) == seed


def outcomes(jcbb: float, known: float = 0.2):
    """FP, FN, RMSE, aligned RMSE of known, NN, SINGLES, JCBB."""
    return (0.0, 0.0, known, 0.1), (9.0, 1.0, 1.0, 0.5), (5.0, 1.0, 1.0, 0.5), (3.0, 1.0, jcbb, 0.2)


def test_mean_and_spread_are_those_by_hand_and_a_seed_in_which_a_method_stopped_is_left_out():
    given = [Seed("corridor:10", outcomes(0.5)), Seed("corridor:9", outcomes(0.1)), Seed("corridor:11", None)]
    found = over_seeds(open_log(NAME), given)
    assert found.logs == ("corridor:9", "corridor:10")
    assert found.mean["jcbb-first"] == pytest.approx((3.0, 1.0, 0.3, 0.2))
    assert found.deviation["jcbb-first"] == pytest.approx((0.0, 0.0, 0.4 / 2**0.5, 0.0))
    assert (found.nearer, found.nearer_aligned) == (1, 0)
    assert found.labels_win
    assert seeds_table(found)["RMSE [m]"].tolist() == ["0.200", "1.00", "1.00", "0.30 ± 0.28"]


def test_seeds_follow_the_log_s_own_with_its_constants_and_only_its_generator_s_log_has_any():
    log = open_log("corridor:7:people+srho=0.05")
    jobs = seed_jobs(log, SETUP)
    assert [j.owner for j in jobs] == [f"corridor:{k}:people+srho=0.05" for k in range(7, 7 + seeds.SEEDS)]
    assert seed_jobs(lab_log(people=True), SETUP) == [], "named as a simulated log, with other data"
    assert seed_jobs(replace(log, name="mine"), SETUP) == []
    assert seed_jobs(replace(log, source={"kind": "lab"}), SETUP) == []


@pytest.mark.slow
def test_the_answer_has_the_seeds_in_its_line_its_table_and_the_reason_and_the_same_twice(trial, tmp_path, monkeypatch):
    monkeypatch.setattr(seeds, "SEEDS", 3)
    options = read_options(["--lab", "corridor:3", "--no-plots", "--jobs", "1", "--out", str(tmp_path)])
    texts = []
    for _ in range(2):
        section = hand_in(tmp_path, options, [trial], score([trial]), Unfinished(1))[3]
        table = next(b for b in section.blocks if isinstance(b, Table) and b.stem == "lab-seeds")
        assert table.frame["method"].tolist() == list(METHODS)
        texts.append(section.answer + "".join(b for b in every_block(section.blocks) if isinstance(b, str)))
    assert texts[0] == texts[1]
    assert "Over 3 seeds: " in section.answer
    # this log's path is nearer to the truth than with labels, which is chance
    assert "In 2 of 3 seeds JCBB's path is nearer to the truth than the one with labels" in texts[0]
    assert "a few wrong ones, with landmarks close by, shift the path by chance" in texts[0]
    assert section.facts.repeated.logs == ("corridor:3:people", "corridor:4:people", "corridor:5:people")


def test_a_share_is_the_same_in_the_lab_s_table_and_in_the_log_s(trial, tmp_path, monkeypatch):
    """Seen: 7.00 in one and 6.98 % in the other."""
    monkeypatch.setattr(seeds, "SEEDS", 0)
    options = read_options(["--lab", "corridor:3", "--no-plots", "--jobs", "1", "--out", str(tmp_path)])
    scores = score([trial])
    (table,) = (b for b in hand_in(tmp_path, options, [trial], scores, Unfinished(1))[3].blocks if isinstance(b, Table))
    log_s = comparison_table(scores.metrics)
    (head,) = (c for c in log_s.columns if "inside 3σ" in c)
    shown = dict(zip(table.frame["method"], map(number, table.frame["in 3σ [%]"]), strict=True))
    assert shown == dict(zip(log_s["association"], map(number, log_s[head]), strict=True))
    assert shown["nn"] == "6.98"
    assert percent(3 / 43) == "6.98 %"
