"""Labels with their gate, and appearance in a run: where it helps, and that it can be left out."""

from dataclasses import replace

import numpy as np
import pytest

from association.appearance import Looks
from data.appearance import UNREAD, Appearance
from data.formats.open_log import write_folder
from data.inputs import FrameObservations, LandmarkMap, Observations, Prior
from data.log import Log
from data.logs import open_log
from data.sensors import RelativePoint
from data.worlds.registry import named_log
from eval.plan.experiments import make_plan
from eval.plan.flags.options import read_options
from eval.replay.hindsight.final_association import reassociate
from eval.replay.hindsight.hypotheses import Hypotheses
from eval.replay.run import compare, step_by_step
from eval.replay.settings import SENSED_GATE, Setup
from eval.report.writing import gate_sentence
from eval.studies.twins import source_of, twin
from eval.tune import main as tune
from tests.quick import slow

DENSE = "arena:0:landmarks=70+frames=25"


def wrong(log, run):
    """Observations paired with a landmark that another one began."""
    true, number = log.truth.landmark_of, run.final_decisions
    begun = {int(n): int(true[i]) for i, n in enumerate(run.created) if n >= 0}
    known = log.recorded.map is not None and run.task == "localization"
    return sum(d >= 0 and (d if known else begun.get(int(d), -1)) != t for d, t in zip(number, true, strict=True))


@pytest.mark.parametrize("task", ["slam", "localization"])
@pytest.mark.parametrize("more", ["descriptor_sigma=0.1", "classes=4"])
def test_fewer_pairings_are_wrong_with_appearance(task, more):
    log = named_log(f"{DENSE}+{more}+sigma_bearing=0.08")
    runs = [compare(log.inputs(), task, ["ekf"], "nn", Setup(appearance=on))[0] for on in (False, True)]
    assert wrong(log, runs[1]) < 0.6 * wrong(log, runs[0])


@pytest.mark.parametrize("task", ["slam", "localization"])
def test_left_out_it_is_as_if_there_were_none(task):
    plain, dressed = named_log("arena:1:frames=20"), named_log("arena:1:frames=20+descriptor_sigma=0.1+classes=3")
    one = compare(plain.inputs(), task, ["ekf"], "jcbb")[0]
    other = compare(dressed.inputs(), task, ["ekf"], "jcbb", Setup(appearance=False))[0]
    assert one.online.pose.tobytes() == other.online.pose.tobytes()
    assert one.final_decisions.tolist() == other.final_decisions.tolist()


@pytest.mark.parametrize("task", [slow("slam"), "localization"])
def test_hindsight_uses_it_in_every_decision(task):
    log = named_log(f"{DENSE}+descriptor_sigma=0.1")
    runs = [compare(log.inputs(), task, ["ekf"], "jcbb-hindsight", Setup(appearance=on))[0] for on in (False, True)]
    assert wrong(log, runs[1]) <= wrong(log, runs[0])
    assert wrong(log, runs[1]) <= 2


def test_twins_draw_readings_about_the_mean_of_each_landmark():
    log = named_log("arena:0:frames=30+descriptor_sigma=0.2+classes=3")
    runs = compare(log.inputs(labels=True), "slam", ["ekf", "batch"], "known")
    source = source_of(log, runs[1], ("ekf",), Setup())
    drawn, own = (each.recorded.observations.appearance for each in (twin(source, 0), log))
    true = log.truth.landmarks.appearance
    rows = log.truth.landmarks.rows(log.truth.landmark_of)
    assert not np.array_equal(drawn.descriptor, own.descriptor)
    assert np.std(drawn.descriptor - true.descriptor[rows]) == pytest.approx(0.2, rel=0.2)
    assert np.mean(drawn.category == true.category[rows]) == pytest.approx(0.95, abs=0.04)
    assert twin(source, 0).recorded.observations.appearance.descriptor.tobytes() == drawn.descriptor.tobytes()


NEAR = np.array([[2.0, 0.0], [2.0, 0.1]])
LOOKS = Appearance(np.array([0.0, 1.0]), np.zeros(2), np.full(2, UNREAD), np.zeros(2))
SENSOR = RelativePoint(max_range=5.0)


def reading(*descriptor):
    n = len(descriptor)
    return Appearance(np.array(descriptor), np.full(n, 0.1), np.full(n, UNREAD), np.full(n, 0.5))


@pytest.mark.parametrize(("descriptor", "expected"), [(0.0, 0), (1.0, 1)])
def test_the_final_re_association_takes_the_landmark_that_looks_alike(descriptor, expected):
    known = LandmarkMap(np.arange(2), NEAR, appearance=LOOKS)
    seen = Observations(np.zeros(1, np.int64), np.array([[2.0, 0.05]]), 0.1 * np.eye(2)[None])
    seen = replace(seen, appearance=reading(descriptor))
    found = reassociate(SENSOR, np.zeros((1, 3)), known, seen, Looks.of_map(known))
    assert found.number.tolist() == [expected]
    assert found.misfit < 1.0  # not inside the other's gate


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(("descriptor", "expected"), [(0.0, 0), (1.0, 1)])
def test_hypotheses_take_the_landmark_that_looks_alike(descriptor, expected, stated):
    known = LandmarkMap(np.arange(2), NEAR, appearance=LOOKS if stated else None)
    bank = Hypotheses(Prior(np.zeros(3), 0.01 * np.eye(3)), SENSOR, known)
    R = np.tile(1e-3 * np.eye(2), (2, 1, 1))
    if not stated:  # learned from a frame that is clear
        bank.observe(FrameObservations(NEAR.copy(), R), 0, reading(0.0, 1.0))
    standing = bank.observe(FrameObservations(np.array([[2.0, 0.05]]), R[:1]), 2, reading(descriptor))
    assert standing.decisions.tolist() == [expected]
    assert standing.sure[0] > 0.99


WRONG = 40
"""An observation whose label is of another landmark."""


@pytest.fixture(scope="module")
def sensed() -> Log:
    log = open_log("arena:3")
    label = log.granted.copy()
    label[WRONG] = (label[WRONG] + 7) % len(log.truth.landmarks.id)
    return replace(log, label=label, labels_are_sensed=True)


def ekf(log, setup=Setup(), task="localization"):
    return compare(log.inputs(labels=True), task, ["ekf"], setup=setup)[0]


def same(a, b):
    return (
        np.array_equal(a.online.pose, b.online.pose) and np.array_equal(a.decisions, b.decisions) and a.gated == b.gated
    )


def test_a_misread_label_is_left_out_by_itself_by_filters_and_smoothers(sensed):
    for run in compare(sensed.inputs(labels=True), "localization", ["ekf", "isam2", "batch"]):
        assert run.final_decisions[WRONG] < 0
        assert (run.final_decisions >= 0).sum() >= 0.999 * len(run.final_decisions) - 1
    run = step_by_step("ekf", sensed.inputs(labels=True), "slam")
    assert run.decisions[WRONG] < 0


def test_without_a_gate_that_was_asked_for_every_label_counts(sensed):
    run = ekf(sensed, Setup(gate_known=None))
    assert run.decisions[WRONG] == sensed.label[WRONG]
    assert run.gated == (1.0, 2.0)
    assert (ekf(sensed, Setup(gate_known=0.5)).decisions < 0).sum() > 100


def test_labels_that_no_sensor_read_are_not_gated(sensed):
    claimed = replace(sensed, labels_are_sensed=False)
    assert same(ekf(claimed), ekf(claimed, Setup(gate_known=None)))
    arena = open_log("arena:3")
    assert same(ekf(arena), ekf(arena, Setup(gate_known=None)))
    assert not same(ekf(arena), ekf(arena, Setup(gate_known=0.99)))


@pytest.mark.parametrize(("words", "gates"), [
    ([], [None, SENSED_GATE]), (["--gate-known", "auto"], [None, SENSED_GATE]),
    (["--gate-known", "none"], [None, None]), (["--gate-known", "0.99"], [0.99, 0.99]),
])  # fmt: skip
def test_a_plan_settles_it_log_by_log(sensed, tmp_path, words, gates):
    write_folder(replace(sensed, name="sensed"), tmp_path / "sensed")
    plan = make_plan(read_options(["--log", "arena:3", "--log", str(tmp_path / "sensed"), *words]), print)
    assert [e.setup.gate_known for e in plan.experiments] == gates


def test_what_is_said_of_it():
    assert "beyond the 0.9999 quantile" in gate_sentence(Setup(), sensed=True)
    assert "default for labels read by a sensor" in gate_sentence(Setup(), sensed=True)
    assert gate_sentence(Setup(), sensed=False).startswith("Pairings by label are not gated (default")
    assert gate_sentence(Setup(gate_known=None), sensed=True) == "Pairings by label are not gated."
    assert "smoothers keep them" in gate_sentence(Setup(gate_smoothers=False), sensed=True)


def test_a_fit_leaves_misread_labels_out_unless_told_otherwise(sensed, tmp_path, capsys):
    write_folder(sensed, tmp_path / "log")
    for words, factor in (([], "gated"), (["--gate", "none"], "all")):
        assert tune([str(tmp_path / "log"), str(tmp_path / factor), "--fit", "sensor", *words]) == 0
    out = capsys.readouterr().out.split("written:")
    assert out[0] != out[1].split("\n", 1)[1]
    sigma = [open_log(str(tmp_path / f)).recorded.observations.R[0, 0, 0] for f in ("gated", "all")]
    assert sigma[0] < 0.9 * sigma[1]
