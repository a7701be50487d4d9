"""The study of the battery: logs are independent, faults reach them, and each is judged as any other log."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.research.diagnosis.study import (
    Case,
    Examined,
    Validation,
    World,
    examined,
)

TINY = Validation(
    "tiny",
    (World("arena", "arena", "slam", (("frames", 40), ("landmarks", 10))),),
    2,
    19,
    "arena",
    1,
    ("wrong-labels",),
    ("reported",),
)


@pytest.mark.slow
def test_wrong_labels_are_put_down_to_the_associations():
    (found,) = examined(TINY, Case(TINY.worlds[0], 1, "wrong-labels", 0.05))
    assert found.objected
    assert found.cause == "associations"
    assert found.p == pytest.approx(1 / 20)
    assert found.found[0] == "pairings readings"
    assert found.nis
    assert not found.failure


def test_a_broken_filter_is_convicted_by_twins_and_a_sound_one_is_not():
    case = Case(TINY.worlds[0], 2, broken=(("reported", 1.0), ("reported", 0.25), ("reading-noise", 0.25)))
    sound, modest, credulous = examined(TINY, case)
    assert not sound.convicted
    assert modest.convicted
    assert modest.cause == "estimator"
    assert not modest.nis  # its innovations are those of the sound filter
    assert credulous.convicted
    assert credulous.nis


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["arena", "corridor", "circle"])
def test_the_battery_objects_to_one_log_in_twenty_that_is_right(kind):
    values = {"arena": (("frames", 100),), "circle": (("frames", 400),)}.get(kind, ())
    world = World(kind, kind, "slam", values)
    found = [examined(replace(TINY, worlds=(world,)), Case(world, seed))[0] for seed in range(40)]
    assert not [e.failure for e in found if e.failure]
    # of 40, 8 or more happen once in a thousand at 5 %
    assert sum(e.objected for e in found) < 8


ARENA, CIRCLE = World("arena", "arena", "slam"), World("circle", "circle", "slam")


def log(fault="", size=0.0, *, objected=False, cause="nothing", world="arena", **more):
    return Examined(world, 0, fault, size, 0.025 if objected else 0.5, objected, cause, **more)
