"""Faults that change nothing anybody could see, by file, what stands there and what would: each was looked at."""

from __future__ import annotations

EQUIVALENT = {
    # a continuous number that equals a threshold exactly, with probability zero
    ("association/evidence/pairings.py", "e.individual_distances()[rows] < threshold",
     "(e.individual_distances()[rows] <= threshold)"),
    # the search goes on in vain: a pairing that disagrees with one point is left out all the same
    ("association/geometry/relocalize.py", "break", "pass"),
}  # fmt: skip
