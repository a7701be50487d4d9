"""What a plan has of somebody else's is loaded before any work; what of it makes no sense is a sentence."""

import sys

import pytest

from data.errors import UsageError
from data.worlds.arena import Arena, simulate
from eval.plan.experiment import Experiment, Work, check_possible, check_scenario, introduce_all, load_all, sources_of
from eval.replay.external.spec import introduced, settled
from eval.replay.settings import Setup
from eval.studies.scenario import Member, Scenario

VERBS = "\n    def predict(self, i): ...\n    def update(self, s, d): ...\n    def estimate(self): ...\n"
SLAM_ONLY = f"class F:\n    def __init__(self, prior, sensor, options): ...{VERBS}"
BOTH = f"class F:\n    tasks = ('slam', 'localization'){VERBS}    def expect(self, s): ..."
PAIRS = "def F(expectation, gate): ..."
BROKEN_CLASS = "class F:\n    def __init__(self):\n        raise ValueError('no sun')"


@pytest.fixture
def write(tmp_path, monkeypatch):
    """`write(code, kind, name)`: the settled text of the attribute F in a file of that code."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def written(code, kind="estimator", name="mine"):
        (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
        return settled(f"--{kind}", f"{name}=./{name}.py:F", kind)

    return written


def study(members, association=("known",), task=("slam",)):
    world = (("frames", 4),)
    return Scenario("small", "small", "", "", 1, task, association, tuple(map(Member, members)), "arena", world)


@pytest.mark.parametrize(("code", "words"), [
    ("F = 3", "mine=./mine.py:F: F is an int"), ("class F: ...", "mine: no method 'predict'"),
    (f"class F:\n    def __init__(self, prior): ...{VERBS}", r"its constructor takes \(prior\)"),
])  # fmt: skip
def test_what_is_no_estimator_is_refused_wherever_it_stands_among_the_names(write, code, words):
    with pytest.raises(UsageError, match=words):
        load_all(["ekf", write(code)], [])


@pytest.mark.parametrize(("code", "words"), [
    ("F = 3", "mine=./mine.py:F: F is an int"),
    (BROKEN_CLASS, r"^mine=./mine.py:F: mine\(\) raised ValueError: no sun \(mine.py, line 3\)$"),
    ("class F:\n    def __init__(self, wish): ...", r"^mine=./mine.py:F: mine\(\) raised TypeError: .*'wish'"),
])  # fmt: skip
def test_what_is_no_way_of_association_is_refused_wherever_it_stands_among_the_names(write, code, words):
    with pytest.raises(UsageError, match=words):
        load_all([], ["known", write(code, "association")])


def test_a_study_is_refused_if_a_member_can_do_nothing_or_a_way_is_broken(write):
    broken = write(BROKEN_CLASS, "association")
    for members in (["ekf"], ["ekf", write(BOTH, name="other")]):
        with pytest.raises(UsageError, match=r"mine=./mine.py:F: mine\(\) raised ValueError: no sun"):
            check_scenario(study(members, ("known", broken)))
    with pytest.raises(UsageError, match=r"--estimator half=./half.py:F: half does slam only"):
        check_scenario(study(["ekf", write(SLAM_ONLY, name="half")], task=("localization",)))


def test_of_a_study_is_left_out_what_a_member_cannot_do_a_sentence_each(write):
    members = ["ekf", write(SLAM_ONLY, name="half"), write(BOTH, name="full")]
    pairs = write(PAIRS, "association", "pairs")
    left = check_scenario(study(members, ("known", pairs), ("localization", "slam")))
    assert [line.partition(": left out, ")[0] for line in left] == [
        "small, localization, known", "small, localization, pairs", "small, slam, pairs",
    ]  # fmt: skip
    reasons = [line.partition(": left out, ")[2] for line in left]
    assert reasons[0] == reasons[1]
    assert reasons[0].startswith("half does slam only")
    assert reasons[2] == "half has no `expect`, which any --association but known needs"
    assert check_scenario(study(["ekf"], ("known", "nn"))) == []


def test_a_plan_is_refused_only_if_an_estimator_can_do_nothing_of_it(write):
    log, half = simulate(Arena(frames=4), 0), write(SLAM_ONLY, name="half")
    localize, slam = (
        Experiment(log, task, (Work("known", ("ekf", half)),), Setup()) for task in ("localization", "slam")
    )
    check_possible([])
    check_possible([localize, slam])
    with pytest.raises(UsageError, match=r"^--estimator half=./half.py:F: half does slam only"):
        check_possible([localize])


def test_foreign_names_and_those_of_results_are_introduced_and_ours_are_not(write):
    mine = write(SLAM_ONLY)
    introduce_all(["ekf", mine, "nn"], ["theirs=a.csv", "other=b.csv"])
    assert introduced() == ("mine", "other", "theirs")
    with pytest.raises(UsageError, match=r"--result mine: mine=./mine.py:F has that name, too"):
        introduce_all([mine], ["theirs=a.csv", "mine=a.csv"])
    introduce_all(["ekf"])
    assert introduced() == ()


def test_provenance_says_where_foreign_names_came_from_with_all_files_behind_them(write, tmp_path):
    write("WORD = 1", name="used_by_both")
    mine = write("import used_by_both\ndef F(): ...")
    found = sources_of(["ekf", mine])
    assert list(found) == ["mine"]
    assert found["mine"]["is"] == "mine.py:F"  # the folder is nobody else's
    assert sorted(found["mine"]["files"]) == ["mine.py", "used_by_both.py"]
    assert len(found["mine"]["sha256"]) == 64
    write("WORD = 2", name="used_by_both")
    assert sources_of([mine])["mine"]["sha256"] != found["mine"]["sha256"]
