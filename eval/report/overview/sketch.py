"""The small picture of a log and task: true path, filter and smoother from above, as SVG, the same bytes each time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from data.result import Run
from data.se2 import Array
from eval.page.document import Sketch
from eval.report.overview.facts import Facts
from eval.report.rows import Row

WIDTH, HEIGHT, EDGE = 96.0, 60.0, 3.0
"""px of the page."""
POINTS = 90
"""Of a path, at most: more than so small a picture can show."""
TRUTH, ONLINE, SMOOTHED = ("#b8b8b8", 3.0), ("#d55e00", 1.1), ("#0064a8", 1.1)
"""Colour and width of truth, filter and smoother: filters are warm, smoothers cool, as in all figures."""


def sketch(f: Facts, stem: str | None = None) -> Sketch | None:
    """The picture; None where nothing is known of any path."""
    lines: list[tuple[Array, tuple[str, float]]] = []
    names = []
    truth = f.trial.log.truth.pose
    if truth is not None and f.trial.log.truth.known_poses:
        lines.append((truth[:, :2], TRUTH))
        names.append("the true path")
    for row, phase, look in ((f.filtered, "online", ONLINE), (f.smoothed, "final", SMOOTHED)):
        path = _path(f, row, phase)
        if row is not None and path is not None:
            lines.append((path, look))
            names.append(str(row["estimator"]))
    if not names:
        return None
    return Sketch(drawn(lines), f"Map of {f.trial.log.name}: {', '.join(names)}", stem)


def _path(f: Facts, row: Row | None, phase: str) -> Array | None:
    run: Run | None = None if row is None else f.trial.find(str(row["estimator"]), str(row["association"]))
    if run is None or run.failure is not None:
        return None
    trajectory = run.online if phase == "online" else run.final
    return None if trajectory is None else trajectory.pose[:, :2]


def drawn(lines: Sequence[tuple[Array, tuple[str, float]]]) -> str:
    """Paths (N, 2) in metres from above, north up; the first one decides what is seen, up to half its size around."""
    known = [xy[np.isfinite(xy).all(axis=1)] for xy, _ in lines]
    looks = [look for xy, (_, look) in zip(known, lines, strict=True) if len(xy)]
    known = [xy for xy in known if len(xy)]
    if not known:
        return ""
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    reach = 0.5 * max(float((high - low).max()), 1.0)
    near = np.vstack([xy[np.all((xy > low - reach) & (xy < high + reach), axis=1)] for xy in known])
    low, high = near.min(axis=0), near.max(axis=0)
    if high[1] - low[1] > high[0] - low[0]:  # lying, as the picture is wide
        known = [np.column_stack([xy[:, 1], -xy[:, 0]]) for xy in known]
        low, high = np.array([low[1], -high[0]]), np.array([high[1], -low[0]])
    size = np.maximum(high - low, 1e-9)
    scale = float(min((WIDTH - 2.0 * EDGE) / size[0], (HEIGHT - 2.0 * EDGE) / size[1]))
    offset = 0.5 * (np.array([WIDTH, HEIGHT]) - scale * (high - low))
    parts = []
    for xy, (colour, width) in zip(known, looks, strict=True):
        kept = xy[np.unique(np.linspace(0, len(xy) - 1, POINTS).astype(int))]
        x, y = offset[0] + scale * (kept[:, 0] - low[0]), offset[1] + scale * (high[1] - kept[:, 1])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x.tolist(), y.tolist(), strict=True))
        parts.append(f'<polyline points="{points}" stroke="{colour}" stroke-width="{width:g}"/>')
    box = f'width="{WIDTH:g}" height="{HEIGHT:g}" viewBox="0 0 {WIDTH:g} {HEIGHT:g}"'
    inside = f'<rect {box.split(" viewBox")[0]} fill="#ffffff"/><g fill="none" stroke-linejoin="round">'
    return f"<svg {box}>{inside}{''.join(parts)}</g></svg>"


def as_file(svg: str) -> str:
    """The picture as a file of its own, which needs the name of its language."""
    return svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"
