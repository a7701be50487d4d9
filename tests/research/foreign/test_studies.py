"""Studies of foreign worlds: shares and their bounds, what counts as rightly named, and going on with a file."""

from __future__ import annotations

import pytest

from tests.research.foreign import causes, headlines
from tests.research.foreign.study import Case

SOUND = Case("eight", 1, "", "slam", "known")


def diagnosed(fault: str, named: str, *, objected: bool = True) -> causes.Row:
    return causes.Row(
        "eight", 1, fault, "slam", "known", 19, nees_filter=3.0, nees_smoother=3.0, objected=objected, named=named
    )


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


@pytest.mark.slow
def test_a_sound_log_has_no_strong_fault_and_one_with_mirrored_bearings_has():
    sound, faulty = (headlines.one(SOUND._replace(fault=f, shape="table")) for f in ("", "mirrored"))
    assert (sound.strong, faulty.strong) == (False, True)
    assert not faulty.tick
    assert faulty.objection
    text = headlines.report([sound, faulty])
    assert "| known | slam | 0/1 = 0.0 % [0.0, 79.3] | 0 |" in text
