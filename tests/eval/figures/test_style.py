"""Colours, labels and lines that tell estimators and ways of association apart; figures saved to the same bytes."""

import os
import subprocess
import sys
from contextlib import nullcontext
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from eval.figures import style
from eval.figures.style import OTHERS, STYLES, TRUTH_COLOUR, colour_of_method, series, style_of
from eval.replay.external.spec import introduce, place
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS
from tests.eval.figures.looks import SEEN_BY, lab, pictures
from tests.eval.handmade import run_with_error


def test_phases_and_associations_of_one_estimator_differ_in_label_and_line():
    runs = [
        run_with_error(np.zeros(3), estimator="isam2", phases=("online", "final")),
        run_with_error(np.zeros(3), association="known"),
        run_with_error(np.zeros(3), association="jcbb"),
        run_with_error(np.zeros(3), estimator="dead-reckoning", association="none"),
    ]
    drawn = series(runs)
    assert [s.label for s in drawn] == [
        "iSAM2, known (online)", "iSAM2, known (final)", "EKF, known (online)", "EKF, jcbb (online)", "dead reckoning",
    ]  # fmt: skip
    assert drawn[0].line != drawn[1].line
    assert drawn[2].line != drawn[3].line
    assert drawn[2].colour == drawn[3].colour
    assert drawn[1].line == drawn[2].line, "one line for one association, whoever uses it"
    alone = series(runs[1:])  # of one estimator the colours are those of the methods
    assert len({s.colour for s in alone}) == len({str(s.line) for s in alone}) == 3


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    before = dict(matplotlib.rcParams)
    return pictures(tmp_path_factory.mktemp("here")), before, dict(matplotlib.rcParams)


@pytest.mark.slow
def test_same_data_gives_same_bytes_in_another_process_too(drawn, tmp_path):
    assert sorted(drawn[0]) == ["map.png"]
    call = f"pictures(Path({str(tmp_path)!r}))"
    code = f"from pathlib import Path; from tests.eval.figures.looks import pictures; {call}"
    root = Path(__file__).resolve().parents[3]
    environment = {**os.environ, "PYTHONHASHSEED": "7", "PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-c", code], check=True, cwd=root, env=environment, timeout=120)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == drawn[0]


def test_ticks_that_are_kept_are_those_that_matplotlib_would_make(tmp_path, monkeypatch):
    def saved() -> bytes:
        with style.drawing():
            fig = Figure((2.0, 1.8))
            fig.subplots().plot([0.0, 123.0])
        style.finish(fig, "a title\nof many\nlines", [style.key("shrinks")])
        return style.save(fig, tmp_path, "panel")[0].read_bytes()

    ours = saved()
    monkeypatch.setattr(style, "_ticks_kept", lambda fig: nullcontext())
    assert saved() == ours


def test_saved_figures_carry_no_date_and_leave_the_callers_settings_alone(drawn):
    for name, data in drawn[0].items():
        words = [b"CreationDate", b"Creator", b"Producer"] if name.endswith("pdf") else [b"Software", b"tIME"]
        assert not [w for w in words if w in data]
    assert drawn[1] == drawn[2]


UNPLANNED = "nobody-planned-for-this"


def test_every_estimator_and_way_of_association_has_a_look_of_its_own():
    assert set(ESTIMATORS) == set(STYLES)
    assert len({style_of(name).colour for name in ESTIMATORS}) == len(ESTIMATORS)
    colours = [colour_of_method(name) for name in (*ASSOCIATIONS, UNPLANNED)]
    assert len(set(colours)) == len(ASSOCIATIONS) + 1
    drawn = series([run_with_error(np.zeros(3), association=a) for a in ASSOCIATIONS])
    assert [s.colour for s in drawn] == colours[:-1]
    assert style_of("of-others") == style_of("of-others")
    assert style_of("of-others").colour not in {s.colour for s in STYLES.values()}
    assert style_of("of-others").label == "of-others"


@pytest.mark.parametrize("seen", SEEN_BY.values(), ids=SEEN_BY.keys())
def test_ways_of_association_and_foreign_names_stay_apart_for_colour_blind_readers(seen):
    for a, b in combinations(ASSOCIATIONS, 2):
        assert np.linalg.norm(lab(colour_of_method(a), seen) - lab(colour_of_method(b), seen)) > 12.0, (a, b)
    colours = [TRUTH_COLOUR, *(STYLES[n].colour for n in ("dead-reckoning", "ekf", "isam2", "batch"))]
    for a, b in combinations(colours, 2):
        assert np.linalg.norm(lab(a, seen) - lab(b, seen)) > 15.0, (a, b)  # a just noticeable difference is about 2.3
    theirs = [colour for colour, _ in OTHERS]
    ours = [STYLES[n].colour for n in ("dead-reckoning", "ekf", "isam2", "batch")]
    for a, b in [*combinations(theirs, 2), *((a, b) for a in theirs for b in ours)]:
        assert np.linalg.norm(lab(a, seen) - lab(b, seen)) > 15.0, (a, b)


NAMES = [f"filter-{i}" for i in range(12)]


@pytest.fixture(autouse=True)
def nobody():
    yield
    introduce(())


def test_introduced_names_look_different_and_move_apart():
    introduce(NAMES)
    styles = [style_of(name) for name in NAMES]
    assert len({(s.colour, s.line) for s in styles}) == len(NAMES)
    introduce(reversed(NAMES))
    assert [style_of(name) for name in NAMES] == styles
    a, b = next((a, b) for a, b in combinations(NAMES, 2) if place(a, 5) == place(b, 5))
    introduce([a, b])
    assert place(a, 5) != place(b, 5)
