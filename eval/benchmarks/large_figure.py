"""Figure of scaling: time and memory of each estimator against the length of the log, with the exponents of growth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from matplotlib.figure import Figure

from eval.benchmarks.large import BARE, BARE_BATCH, Measured, slope
from eval.figures.paper.look import page_width
from eval.figures.style import DOTTED, Style, drawing, style_of

PEERS = {BARE: ("isam2", "bare gtsam loop"), BARE_BATCH: ("batch", "bare gtsam batch")}
"""Whose peer each is, and what it is called."""


def scaling_figure(found: Sequence[Measured]) -> Figure:
    """Wall time and peak memory above that of the log, over the number of frames, both axes logarithmic."""
    with drawing():
        fig = Figure(figsize=(page_width(), 3.5))
        panels: tuple[tuple[str, Callable[[Measured], float]], ...] = (
            ("wall time [s]", lambda m: m.seconds),
            ("memory beside the log [MB]", lambda m: max(m.peak_mb - m.log_mb, 1.0)),
        )
        for ax, (label, value) in zip(fig.subplots(1, 2), panels, strict=True):
            for estimator in dict.fromkeys(m.estimator for m in found):
                own = sorted((m for m in found if m.estimator == estimator), key=lambda m: m.frames)
                frames, values = [m.frames for m in own], [value(m) for m in own]
                style = _style(estimator)
                exponent = f", $n^{{{slope(frames, values):.2f}}}$" if len(own) > 2 else ""
                ax.plot(
                    frames, values, color=style.colour, linestyle=style.line, marker=style.marker,
                    label=style.label + exponent,
                )  # fmt: skip
            ax.set(xscale="log", yscale="log", xlabel="frames n [–]", ylabel=label)
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2)  # below: lines fill the panel
        return fig


def _style(estimator: str) -> Style:
    if estimator not in PEERS:
        return style_of(estimator)
    ours, label = PEERS[estimator]
    return replace(style_of(ours), label=label, line=DOTTED, marker="o")
