"""A factor graph drawn: edges coloured by the p value of their deleted residual, and by their redundancy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from data.inputs import IntArray
from data.se2 import Array
from eval.figures.style import drawing

LEAST = -8.0  # log10 of the smallest p value that has a colour of its own
SUSPICION = LinearSegmentedColormap.from_list("suspicion", ["#500000", "#d7301f", "#f0a030", "#8899aa"])
FLAT = 1e-9  # m of height of a graph in the plane


def audit_figure(place: Array, ends: IntArray, p: Array, share: Array, rejected: Sequence[int]) -> Figure:
    """The graph from above, in space also from the side.

    Args:
        place: (V, 3) positions, NaN where there is none.
        ends: (F, 2) variables of each factor's first and last end.
        p: (F,) p values, NaN: not tested.
        share: (F,) redundancy over dimension.
        rejected: factors that are drawn thick.
    """
    spatial = bool(np.nanmax(np.abs(place[:, 2]), initial=0.0) > FLAT)
    views = [(0, 1, "x [m]", "y [m]"), (0, 2, "x [m]", "z [m]")][: 1 + spatial]
    with drawing():
        fig = Figure(figsize=(9.0, 4.2 * len(views)), layout="constrained")
        axes = fig.subplots(len(views), 2, squeeze=False)
        drawn = np.isfinite(place[ends]).all((1, 2))
        log_p = np.clip(np.log10(np.maximum(np.nan_to_num(p, nan=1.0), 1e-300)), LEAST, 0.0)
        for row, (i, j, x, y) in zip(axes, views, strict=True):
            for ax, value, cmap, low, high, title in (
                (row[0], log_p, SUSPICION, LEAST, 0.0, "log10 of p"),
                (row[1], share, "viridis", 0.0, 1.0, "redundancy / dimension"),
            ):
                order = np.flatnonzero(drawn)[np.argsort(-value[drawn], kind="stable")]
                lines = LineCollection(
                    list(place[ends[order]][:, :, [i, j]]), array=value[order], cmap=cmap, linewidths=np.where(
                        np.isin(order, rejected), 2.5, 0.8
                    ),
                )  # fmt: skip
                lines.set_clim(low, high)
                ax.add_collection(lines)
                ax.autoscale()
                ax.set_aspect("equal", adjustable="datalim")
                ax.set_xlabel(x)
                ax.set_ylabel(y)
                ax.set_title(title)
                fig.colorbar(lines, ax=ax, shrink=0.8)
    return fig
