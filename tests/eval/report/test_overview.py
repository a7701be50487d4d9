"""The first screen: whom to trust, whose fault, what of an error is the frame's; never against the numbers."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

import slamref
from data.formats.mrclam import load_mrclam
from data.formats.open_log import write_folder
from data.inputs import LandmarkMap, Scanner, Scans
from data.log import Log, shortened
from data.logs import open_log
from data.sensors import RelativePoint
from data.truth import Truth
from data.worlds.arena import Arena, simulate
from eval.compare import compare
from eval.judgement.causes import UNITS, cause_word
from eval.judgement.judgement import Gauge, Judgement, Online, Verdict, conclusion, judge
from eval.judgement.runs import Counts, Methods, Objection, RunJudgement
from eval.referee.attribution import ASSOCIATIONS, CONTRADICTED, ESTIMATOR, NOISE, NOTHING, UNTELLABLE, Finding
from eval.referee.explanations import VECTORS, _named
from eval.referee.lost import lost
from eval.referee.residuals import COMPONENTS
from eval.referee.score import Trial, score
from eval.referee.truth_free import Statistic
from eval.replay.settings import Setup
from eval.report.overview import associations, drawn, gauge_statement, introduction, trust_mark
from eval.report.page.blocks import Value
from eval.report.terminal import trust_line
from eval.run_all import main
from eval.studies.diagnosis import Blame, Trust, noiseless
from eval.studies.twins import Sample
from tests.builders import logs
from tests.eval.judged import BLIND, LOG, judgement

EKF = {"estimator": "ekf", "association": "known", "phase": "online", "status": "ok", "nis": 1.0, "nis_lower": 0.9,
       "nis_upper": 1.1, "rmse_position_m": 0.404, "rmse_aligned_m": 0.112}  # fmt: skip
BATCH = EKF | {"estimator": "batch", "phase": "final", "rmse_position_m": 0.048, "rmse_aligned_m": 0.044}


def facts(filtered=EKF, smoothed=BATCH, log=LOG, trust=None, newest=None, unused=frozenset(), task="slam"):
    return judgement(filtered, newest, smoothed, log=log, task=task, trust=trust, idle=unused)


@pytest.mark.parametrize(("filtered", "smoothed", "word", "tone"), [
    (EKF, BATCH, "smoother", "good"), (EKF, BATCH | {"rmse_aligned_m": 0.111}, "either", "good"),
    (EKF | {"rmse_aligned_m": 0.01}, BATCH, "filter", "fair"),
    (EKF, BATCH | {"nees_pose": 9.5}, "path: smoother", "fair"), (EKF, BATCH | {"nees_pose": 400.0}, "filter", "fair"),
    (EKF | {"nees_pose": 400.0}, BATCH | {"nees_pose": 400.0}, "neither", "bad"),
    (EKF | {"lost_why": "0 used", "lost_frame": 7, "nees_pose": 1.1}, BATCH, "smoother", "good"),
    (EKF | {"status": "implausible"}, BATCH, "smoother", "fair"),
    (EKF, BATCH | {"status": "diverged"}, "filter", "fair"),
    (EKF | {"lost_why": "0 used", "lost_frame": 7}, BATCH | {"status": "diverged"}, "neither", "bad"),
    (EKF, None, "only ekf", "none"), (None, None, "nothing ran", "none"),
])  # fmt: skip
def test_the_word_follows_the_errors_and_who_got_to_the_end(filtered, smoothed, word, tone):
    mark = trust_mark(facts(filtered, smoothed))
    assert (mark.word, mark.tone) == (word, tone)


def test_a_violated_assumption_takes_the_tick_unless_the_solution_itself_is_broken():
    turned = Finding(NOISE, "systematic", "z2_constant", 0.0332, 0.002, gain=100.0)
    found = Trust("home", "slam", "known", Sample({}), (), (), Blame(NOISE, (turned,), (("batch", "s"),), 40, 0.01))
    mark = trust_mark(facts(trust=found))
    assert (mark.word, mark.tone) == ("path: smoother", "fair")
    assert "1.90° ± 0.11° too far left" in mark.note
    assert trust_mark(facts(trust=replace(found, blame=Blame(NOTHING, (), (), 40, 0.4)))).tone == "good"
    off = Finding(NOISE, "systematic", "z2_constant", 0.0332, 0.002, gain=100.0)
    blame = Blame(UNTELLABLE, (off,), (("batch", "s"),), 40, 0.01)
    found = Trust("blind", "slam", "known", Sample({}), (), (), blame)
    mark = trust_mark(facts(log=BLIND, trust=found))
    assert (mark.word, mark.tone) == ("cannot be told", "bad")
    assert "1.9" not in mark.note
    empty = replace(LOG.recorded, observations=logs.NOTHING)
    both = frozenset({("ekf", "known"), ("batch", "known")})
    mark = trust_mark(facts(log=replace(LOG, recorded=empty), unused=both))
    assert (mark.word, mark.tone) == ("neither", "bad")
    assert "the log has no observations" in mark.note


@pytest.mark.parametrize(("frames", "step", "why"), [
    ([0], 1.0, "1 scan"), ([0, 4], 0.0, "2 scans of a robot that never moves"), ([0, 4], 1.0, ""),
])  # fmt: skip
def test_no_path_is_recommended_where_nothing_can_be_judged(frames, step, why):
    r = BLIND.recorded
    seen = Scans(Scanner(-1.0, 1.0, 8.0, 0.01), np.array(frames), np.ones((len(frames), 3)))
    steps = replace(r.increments, mean=step * r.increments.mean)
    log = replace(BLIND, recorded=replace(r, observations=logs.NOTHING, scans=seen, increments=steps))
    mark = trust_mark(facts(log=log, trust=Trust("blind", "slam", "scan", Sample({}), (), ())))
    assert mark.word == ("unknown" if why else "path: smoother")
    assert mark.note.startswith(f"nothing can be judged: {why}" if why else "no fault found")


def trust(cause=None, *findings, measured=None, objected=()):
    blame = None if cause is None else Blame(cause, tuple(findings), tuple(objected), 40, 0.01)
    return Trust("blind", "slam", "known", Sample(measured or {}), (), (), blame)


@pytest.mark.parametrize(("said", "word"), [
    (trust(NOTHING), "nothing"),
    (trust(ASSOCIATIONS, Finding(ASSOCIATIONS, "pairings", "readings", 9)), "associations"),
    (trust(ESTIMATOR, Finding(ESTIMATOR, "linearization", "ekf", 1.6)), "estimator"),
    (trust(NOISE, Finding(NOISE, "systematic", "odometry_theta_turn", 0.1)), "odometry"),
    (trust(NOISE, Finding(NOISE, "systematic", "z2_constant", 0.1)), "sensor"),
    (trust(NOISE, Finding(NOISE, "sigma", "odometry_x", 2.0)), "odometry"),
    (trust(NOISE, Finding(NOISE, "tails", "readings", 12)), "sensor"),
    (trust(NOISE, objected=[("batch", "residual_odometry_x_lag1")]), "odometry"), (trust(), "nothing"),
    (replace(trust(), indicated=Finding(NOISE, "systematic", "odometry_theta_turn", -0.4)), "odometry"),
    (replace(trust(), indicated=Finding(NOISE, "sigma", "z", 1.8)), "sensor"),
    (replace(trust(), indicated=Finding(ASSOCIATIONS, "pairings", "readings", 9)), "associations"),
])  # fmt: skip
def test_the_cause_is_one_word_also_without_twins(said, word):
    assert cause_word(said) == word
    f = facts(EKF | {"rmse_position_m": math.nan}, BATCH | {"rmse_position_m": math.nan}, BLIND, said)
    assert (f.verdict, f.cause.word) == (Verdict.CAUSE, word)
    said = "path: smoother" if word == "nothing" else f"cause: {word}"
    assert trust_mark(f).word == said
    told = "use the smoother" if word == "nothing" else "use the smoother's path, not its covariances"
    assert introduction([f]).endswith(f"one referee. Without ground truth on blind: {told}.")
    # the terminal's note says whose path, so the cause stands before it
    assert f": {told if word == 'nothing' else said} (" in trust_line(f)


WORDED = [
    *(Finding(NOISE, "systematic", name, 0.0332, 0.00123) for name in UNITS),
    *(Finding(NOISE, "systematic", f"{s}/{n}", 0.03, 0.01) for s in ("position:gps", "pose:gps", "closure:scan")
      for n in ("x", "y", "theta", "scale", "latency", "lever_x", "lever", "offset")),
    *(Finding(NOISE, "sigma", c, 0.48, 0.01) for c in (*COMPONENTS, "z", "odometry", "position:gps/x")),
    *(Finding(NOISE, kind, name, 0.48, 0.01, frames=((4646, 4935),), outliers=12)
      for kind in ("tails", "jump", "burst", "change", "correlation", "mirrored", "outliers", "pairings", "displaced",
                   "landmark", "linearization", "innovations", "decisions")
      for name in (["position:gps"] if kind == "outliers" else ["12"])),
]  # fmt: skip


@pytest.mark.parametrize("polar", [True, False])
@pytest.mark.parametrize("found", WORDED, ids=lambda f: f"{f.kind} {f.name}")
def test_a_cause_has_25_words_on_the_terminal_with_its_size_and_the_next_step(found, polar):
    source, _, vector = found.name.rpartition("/")
    if vector in VECTORS:
        columns = [[f"{source}/" * bool(source) + name for name in names] for names in VECTORS[vector]]
        parts = tuple(_named(names, 0.0332, 0.00123) for names in columns)
        found = replace(found, parts=parts if len(parts) > 1 else parts[0].parts)
    log = replace(
        BLIND, recorded=replace(BLIND.recorded, sensor=BLIND.recorded.sensor if polar else RelativePoint(8.0))
    )
    ties = ("odometry_y_turn", "latency", "mount_x", "odometry_latency", "latency_growth")
    for other in [(), ties[:1], ties] if found.kind == "systematic" else [()]:
        tied = replace(found, other=tuple(name for name in other if name != found.name))
        blame = Blame(found.cause, (tied,), (("batch", "s"),), 40, 0.01)
        for known in (log, replace(log, truth=LOG.truth)):
            line = trust_line(facts(log=known, trust=Trust("blind", "slam", "known", Sample({}), (), (), blame)))
            assert len([word for word in line.split(": ", 1)[1].split() if re.search(r"\w", word)]) <= 25, line
            assert "next: " in line
            assert found.kind not in ("systematic", "sigma") or " ± " in line
            assert (" (or " in line) == bool(tied.other), line


@pytest.mark.parametrize(("nis", "tone", "note"), [
    (1.0, "good", "no fault found; --twins tests this"),
    (0.81, "fair", "covariances too large (NIS 0.81, 95 % bounds 0.88-1.03); --twins looks for the cause"),
    (1.6, "fair", "covariances too small (NIS 1.6, 95 % bounds 0.88-1.03); --twins looks for the cause"),
])  # fmt: skip
def test_a_rejected_nis_is_named_where_nothing_else_was_found(nis, tone, note):
    blank = {"rmse_position_m": None}
    own = {"nis": nis, "nis_lower": 0.88, "nis_upper": 1.03}
    slight = trust(measured={("batch", "slope_z1_constant"): Statistic(0.02, 0.0, 0.01)})
    mark = trust_mark(facts(EKF | blank | own, BATCH | blank, BLIND, slight))
    assert (mark.word, mark.tone, mark.note) == ("path: smoother", tone, note)


def test_the_sentences_say_what_was_compared_and_how_much_better_where_both_got_there():
    bad = facts(EKF | {"status": "implausible"})
    assert introduction([facts()]) == (
        "Filter (ekf) and smoother (batch) on identical inputs from 1 log, scored by one "
        "referee. Offline, use the smoother (the filter's RMSE is 8.42 times as large)."
    )
    found = conclusion([facts(), bad])
    assert [found[name] for name in ("logs", "filters", "smoothers", "everywhere")] == [1, ("ekf",), ("batch",), True]
    assert (found["filter_fails"], found["ratios"]) == (1, pytest.approx((8.417, 8.417), abs=1e-3))
    assert introduction([facts(), bad]).endswith("8.42 times as large); the filter failed on 1 log.")


@pytest.mark.parametrize(("rmse", "online", "note"), [
    (0.4041, Online.EQUAL, "offline; online, the RMSE of ekf and isam2 differs by less than 2 %"),
    (0.3, Online.OTHER, "online isam2 0.300 m"), (0.1, Online.FAR_BETTER, "online, too (isam2 0.100 m)"),
    (None, Online.UNKNOWN, "offline"),
])  # fmt: skip
def test_an_online_smoother_tells_later_data_from_the_kind_of_estimator(rmse, online, note):
    f = facts(newest=EKF | {"estimator": "isam2", "rmse_position_m": rmse})
    assert f.compared.online == online
    assert trust_mark(f).note == note


def test_the_error_of_the_frame_is_told_from_that_of_the_path():
    text = gauge_statement(facts())
    assert "`ekf` 0.112 m instead of 0.404 m, `batch` 0.0440 m instead of 0.0480 m" in text
    assert facts().compared.gauge == Gauge((0.404, 0.048), (0.112, 0.044), mostly=True)
    same = facts(EKF | {"rmse_aligned_m": 0.4})
    assert not same.compared.gauge.mostly
    assert "After alignment, almost the same: `ekf`" in gauge_statement(same)
    assert facts(task="localization").compared.gauge is None


def test_a_small_map_shows_every_path_inside_its_frame_and_is_the_same_each_time():
    way = np.column_stack([np.linspace(0, 5, 400), np.linspace(0, 40, 400)])
    far = np.vstack([way, [[1e7, 1e7]], [[np.nan, np.nan]]])
    svg = drawn([(way, ("#000", 1.0)), (far, ("#111", 1.0))])
    assert svg == drawn([(way, ("#000", 1.0)), (far, ("#111", 1.0))])
    assert svg.count("<polyline") == 2
    first = [tuple(map(float, p.split(","))) for p in svg.split('points="')[1].split('"')[0].split()]
    assert all(0.0 <= x <= 96.0 and 0.0 <= y <= 60.0 for x, y in first)
    assert max(y for _, y in first) - min(y for _, y in first) > 50.0  # standing, as the path does in the map figure
    assert drawn([(np.full((3, 2), np.nan), ("#000", 1.0))]) == ""


def test_no_association_method_is_called_the_best_where_path_and_decisions_disagree():
    """Seen: the one with the fewest wrong decisions called the best, though its path was the worst."""
    hindsight, first, jcbb = (
        RunJudgement("ekf", name, "online", rmse=rmse, counts=Counts(*counts))
        for name, rmse, counts in (
            ("jcbb-hindsight", 17.1, (205, 125, 200, 71)),
            ("jcbb-first", 9.22, (0, 194, 356, 51)),
            ("jcbb", 9.0, (147, 80, 250, 71)),
        )
    )
    agreed = Methods(hindsight, first, hindsight, usable=True, nearest=None, measured=True, dead_reckoning=20.0)

    def shown(methods):
        return associations(replace(facts(), methods=methods))

    assert shown(agreed) == Value("jcbb-hindsight", "200 FP / 71 FN, 17.1 m (ekf)")
    disputed = replace(agreed, nearest=first)
    both = "200 FP / 71 FN, 17.1 m (ekf); by path jcbb-first 356 FP / 51 FN, 9.22 m (ekf)"
    assert shown(disputed) == Value("by decisions jcbb-hindsight", both)
    assert shown(replace(disputed, usable=False)) == Value("none; by decisions jcbb-hindsight", both)
    assert jcbb.counts.mostly_wrong
    assert not hindsight.counts.mostly_wrong


def first_screen(log: Log, task: str, association: str):
    """Facts and mark of EKF and batch on a log, as `slamref run` shows them first."""
    inputs = log.inputs(labels=association == "known")
    inputs = inputs.without_map() if task == "slam" else inputs
    trial = Trial(log, task, tuple(compare(inputs, task, ("ekf", "batch"), association)))
    facts = judge(trial, score([trial]), ())
    return facts, trust_mark(facts)


def test_pairings_of_the_nearest_neighbour_that_ruin_nees_take_the_tick():
    facts, mark = first_screen(open_log("corridor:3"), "localization", "nn")
    assert facts.compared.smoothed.nees > 100
    assert mark.tone != "good"
    assert "NEES 136" in mark.note


def test_a_smoother_other_than_batch_is_compared_and_not_denied():
    """Without truth the tests need batch; iSAM2 beside the filter is a smoother all the same."""
    log = shortened(open_log("arena:0"), 60)
    blind = replace(log, truth=replace(log.truth, pose=None))
    ekf, isam2 = compare(blind.inputs(labels=True).without_map(), "slam", ("ekf", "isam2"), "known")

    def judged(*runs):
        trial = Trial(blind, "slam", runs)
        facts = judge(trial, score([trial]), ())
        return facts, trust_mark(facts)

    facts, mark = judged(ekf, isam2)
    assert mark.note == "no ground truth, and only batch gives the tests that need none"
    off = ekf.online.pose[:, :2] - isam2.final.pose[:, :2]
    assert facts.compared.apart == pytest.approx(np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=1e-12)
    assert judged(ekf)[1].note == "no smoother ran"


def test_copies_of_dead_reckoning_are_not_equally_good_estimates(tmp_path):
    chain = [f"VERTEX_SE2 {k} {k} 0 0" for k in range(30)]
    chain += [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 400" for k in range(29)]
    (tmp_path / "chain.g2o").write_text("\n".join(chain) + "\n")
    assert slamref.main(["convert", "g2o", str(tmp_path / "chain.g2o"), str(tmp_path / "chain")]) == 0
    _, mark = first_screen(open_log(tmp_path / "chain"), "slam", "jcbb")
    assert (mark.word, mark.tone) == ("neither", "bad")


def judged(log: Log) -> tuple[Judgement, Trial]:
    runs = compare(log.inputs(labels=True), "localization", ("ekf", "batch"), "known", Setup().settled(sensed=True))
    trial = Trial(log, "localization", tuple(runs))
    return judge(trial), trial


def swapped(log: Log) -> Log:
    """The two landmarks that are observed most often change places in the map."""
    known, (ids, times) = log.recorded.map, np.unique(log.truth.landmark_of, return_counts=True)
    xy, rows = known.xy.copy(), known.rows(ids[np.argsort(times)[-2:]])
    xy[rows] = xy[rows[::-1]]
    return replace(log, recorded=replace(log.recorded, map=LandmarkMap(known.id, xy)), labels_are_sensed=True)


def test_swapped_map_rows_are_the_first_objection_and_no_tick_stands_there():
    facts, _ = judged(swapped(open_log("arena:3")))
    assert facts.objections[0].objection is Objection.MAP
    assert facts.tone != "good"
    assert trust_mark(facts).note.startswith("map rows ")
    assert "look swapped" in trust_line(facts)


def bad(log: Log) -> Log:
    pose = log.truth.pose.copy()
    pose[70:111, :2] += [2.0, -2.0]
    return replace(log, truth=replace(log.truth, pose=pose))


@pytest.mark.slow
def test_utias_dataset_1_as_published_is_not_lost_but_has_swapped_rows(mrclam):
    facts, trial = judged(load_mrclam(mrclam / "MRCLAM_Dataset1.zip", 1))
    for run in trial.runs:  # without the truth it looks lost
        assert lost(run, trial.log.recorded, trial.log.granted) is not None
        assert (run.estimator, run.association) not in trial.lost
    assert (facts.verdict, facts.unusable) == (Verdict.SMOOTHER, ())
    assert [o.objection for o in facts.objections] == [Objection.MAP]
    assert facts.log_faults.map_rows.named["swapped"] == (11, 17)
    assert trust_mark(facts).note.startswith("map rows 11 and 17 look swapped")


TAGS = re.compile(r"<(style|head)>.*?</\1>|<[^>]+>", re.S)


def test_the_first_screen_is_short_names_the_cause_without_truth_and_points_to_each_log(tmp_path):
    log = simulate(Arena(frames=80), 3)
    write_folder(Log("blind", log.recorded, Truth(landmark_of=log.truth.landmark_of)), tmp_path / "blind")
    out = tmp_path / "report"
    words = ["--log", str(tmp_path / "blind"), "--log", "arena:0:frames=40", "--estimator", "ekf,batch", "--quick"]
    words += ["--task", "slam", "--association", "known", "--jobs", "1", "--no-plots", "--out", str(out), "-q"]
    assert main(words) == 0
    page, text = ((out / f"report.{kind}").read_text(encoding="utf-8") for kind in ("html", "md"))
    assert 100 < len(TAGS.sub("", page[page.index("<body>") : page.index("<table>")])) <= 900
    row = next(line for line in text[:4000].splitlines() if line.startswith("| [blind, slam]"))
    assert re.search(r"\*\*(cause: (odometry|sensor|estimator|associations)|path: smoother)\*\*", row)
    assert "## Diagnosis without ground truth" in text[:4000]
    rows = re.findall(r'<th scope="row"><a href="#([^"]+)">', page)
    assert rows == ["blind-slam", "arena-0-frames-40-slam"]
    assert all(f'<h2 id="{row}">' in page for row in rows)
    assert page.count("<svg width=") == 2


def test_a_contradiction_of_the_input_is_the_cause_where_the_smoother_is_broken():
    log = open_log("arena:4:frames=80")
    o = log.recorded.observations
    turned = replace(log.recorded, observations=replace(o, z=np.column_stack([o.z[:, 0], o.z[:, 1] + 0.5 * math.pi])))
    broken = Trust(log.name, "slam", "known", Sample({}, {"batch": "diverged"}), (), ())
    for recorded, word in ((log.recorded, UNTELLABLE), (turned, CONTRADICTED)):
        assert facts(log=replace(log, recorded=recorded, truth=Truth()), trust=broken).cause.word == word


def test_residuals_of_a_component_without_noise_are_no_hint():
    assert noiseless(open_log("circle:0:frames=20").recorded) == ("odometry_y",)
