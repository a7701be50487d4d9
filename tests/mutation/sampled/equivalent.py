"""Faults that change nothing anybody could see, by file, what stands there and what would: each was looked at."""

from __future__ import annotations

EQUIVALENT = {
    # a continuous number that equals a threshold exactly, with probability zero
    ("association/conditional.py", "e.individual_distances()[rows] < threshold",
     "(e.individual_distances()[rows] <= threshold)"),
    ("eval/referee/residuals.py", "residuals.squared > OUTLYING", "(residuals.squared >= OUTLYING)"),
    # the search goes on in vain: a pairing that disagrees with one point is left out all the same
    ("eval/replay/hindsight/relocalize.py", "break", "pass"),
    # a fixed point is iterated on to the last round instead of to its last digit
    ("wings/laser/scans/uncertainty.py", "new - scale", "(new + scale)"),
    # room that grows when it is full
    # one stream of random numbers is as good as another
    ("eval/studies/twins.py", "0x7A17", "31256"),
    # the last statement of a function
    ("wings/robot/simulate.py", "return", "pass"),
}  # fmt: skip
