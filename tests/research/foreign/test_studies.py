"""Studies of foreign worlds: shares and their bounds, what counts as rightly named, and going on with a file."""

from __future__ import annotations

import pytest

from tests.research.foreign import causes, headlines
from tests.research.foreign.faults import FAULTS
from tests.research.foreign.shapes import SHAPES
from tests.research.foreign.study import Case, done_all, read, wilson

SOUND = Case("eight", 1, "", "slam", "known")


def diagnosed(fault: str, named: str, *, objected: bool = True) -> causes.Row:
    return causes.Row(
        "eight", 1, fault, "slam", "known", 19, nees_filter=3.0, nees_smoother=3.0, objected=objected, named=named
    )


def test_bounds_of_a_share_are_those_of_wilson():
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(5, 100) == pytest.approx((0.0215, 0.1118), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("named", "kind"),
    [
        ("systematic odometry_theta_time", causes.RIGHT),
        ("systematic odometry_theta_distance|systematic odometry_theta_time; sigma z1", causes.ONE_OF),
        ("sigma z1; systematic odometry_theta_time", causes.LATER),
        ("sigma z1; tails readings", causes.WRONG),
        ("", causes.UNNAMED),
    ],
)
def test_what_is_named_first_counts(named, kind):
    assert causes.kind_of(diagnosed("gyro-bias", named)) == kind
    assert causes.kind_of(diagnosed("gyro-bias", named, objected=False)) == causes.MISSED


def test_every_fault_shape_and_task_has_its_turn_and_no_log_is_used_twice():
    found = headlines.cases(70, 350)
    assert {(c.shape, c.fault) for c in found if c.fault} == {(s, f) for s in SHAPES for f in FAULTS}
    assert len(set(found)) == len(found)
    assert not [c for c in found if c.fault.startswith("map") and c.task == "slam"]
    named = causes.cases(["latency", "map-scale"], ["eight", "car"], 8, 8, "known", 0)
    assert {(c.shape, c.task) for c in named if c.fault == "latency"} == {
        (s, t) for s in ("eight", "car") for t in ("localization", "slam")
    }
    sound = {c.seed for c in found if not c.fault} | {c.seed for c in named if not c.fault}
    assert not sound & {c.seed for c in (*found, *named) if c.fault}


def test_an_interrupted_study_goes_on_with_its_file(tmp_path):
    file, asked = tmp_path / "rows.csv", []

    def one(case: Case) -> causes.Row:
        asked.append(case)
        return causes.Row(*case, 19, 3.0, 4.0, p=0.5, objected=False, named="a|b; c")

    first = done_all([SOUND], one, causes.Row, file, 1)
    other = SOUND._replace(seed=2)
    both = done_all([SOUND, other], one, causes.Row, file, 1)
    assert asked == [SOUND, other]
    assert both[0] == first[0]
    assert read(causes.Row, file) == dict(zip([SOUND, other], both, strict=True))


@pytest.mark.slow
def test_a_sound_log_has_no_strong_fault_and_one_with_mirrored_bearings_has():
    sound, faulty = (headlines.one(SOUND._replace(fault=f, shape="table")) for f in ("", "mirrored"))
    assert (sound.strong, faulty.strong) == (False, True)
    assert not faulty.tick
    assert faulty.objection
    text = headlines.report([sound, faulty])
    assert "| known | slam | 0/1 = 0.0 % [0.0, 79.3] | 0 |" in text
