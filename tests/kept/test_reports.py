"""Reports of small logs stay as they are, in every word, number, table and figure that a person sees.

What is right is said elsewhere, statement by statement; here is that nothing else changes with it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from eval.player.pack import unpacked
from eval.run_all import main
from tests.kept.compare import assert_kept
from tests.kept.drawn import drawn

CASES = {
    "arena": "--log arena:0:frames=40 --task localization,slam --estimator ekf,isam2,batch"
    " --association known,jcbb-hindsight",
    "labels-withheld": "--log arena:3:frames=40 --task slam --estimator ekf-fej,fixed-lag,batch-huber"
    " --association nn,jcbb",
    "twins": "--log arena:1:frames=40 --estimator ekf,batch --twins 8 --calibrate",
    "study": "--scenario arena --runs 4 --estimator ekf,isam2",
    "corridor": "--log corridor:0:people --estimator ekf,isam2,batch",
    "walls": "--log walls:0:frames=150 --estimator ekf,batch",
    "laser": "--log floorplan:0:frames=300",
}
UNSTEADY = re.compile(r'data:[^"\')]+|<script.*?</script>|<style.*?</style>', re.DOTALL)
CHUNK = re.compile(r'<script type="application/json" class="chunk">(.*?)</script>', re.DOTALL)


def recorded(page: str) -> Iterator[str]:
    """What a player's page holds: each array's size, first and last row, mean; everything else as it is."""
    for text in CHUNK.findall(page):
        chunk = json.loads(text)
        for name, values in unpacked(chunk).items():
            rows = np.asarray(values, float)
            known = rows[np.isfinite(rows).all(axis=1)]
            shown = [known[0], known[-1], known.mean(axis=0)] if len(known) else []
            yield f"{name} {rows.shape} {len(known)} {' | '.join(' '.join(f'{v:.6g}' for v in r) for r in shown)}"
        yield from (f"{key} {json.dumps(value)}" for key, value in chunk.items() if key not in ("arrays", "data"))


@pytest.mark.parametrize("case", CASES)
def test_a_report_stays_as_it_is(case, tmp_path, monkeypatch, capsys):
    figures: dict[str, list[str]] = {}
    plain = Figure.savefig

    def savefig(figure, path, *args, **options):
        rounding = case == "laser" and "filter-smoother" in str(path)  # these two are equal but for it
        if isinstance(path, Path) and path.suffix == ".png" and not rounding:
            figures[path.stem] = drawn(figure)
        if isinstance(path, Path) and path.suffix == ".pdf":
            path.touch()  # the same figure again
        else:
            plain(figure, path, *args, **{**options, "dpi": 20})

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Figure, "savefig", savefig)
    assert main([*CASES[case].split(), "--out", "report", "--jobs", "1"]) in (0, 1)
    assert_kept(f"{case}/terminal", capsys.readouterr().out)
    out = tmp_path / "report"
    if case != "laser":  # its page quotes times, and compares estimators that are equal but for rounding
        assert_kept(f"{case}/page", UNSTEADY.sub("", (out / "report.html").read_text("utf-8")))
    tables = [out / f"{name}.csv" for name in ("metrics", "association", "consistency", "trust")]
    tables += [p for p in sorted((out / "tables").glob("*.tex")) if case != "laser"]
    assert_kept(f"{case}/tables", "".join(f"== {p.name}\n{p.read_text('utf-8')}" for p in tables))
    for page in sorted((out / "players").glob("*.html")):
        assert_kept(f"{case}/player", "\n".join(recorded(page.read_text("utf-8"))) + "\n")
    assert figures
    assert_kept(f"{case}/figures", "".join(f"== {n}\n" + "\n".join(figures[n]) + "\n" for n in sorted(figures)))
