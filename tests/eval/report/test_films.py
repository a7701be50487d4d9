"""Films of a report: one for each run, none written over another, each shown and linked."""

from __future__ import annotations

import numpy as np

from eval.referee.score import Trial
from eval.report.page.blocks import Report, Section
from eval.report.publish import films_of, write_films
from eval.report.render import write_report
from tests.eval.handmade import circle_log, run_with_error


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
