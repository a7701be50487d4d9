"""The names that tasks, estimators and ways of association have everywhere: listed once, in the order of tables.

Whoever gives one of them a meaning (filter options, methods, losses) is checked against these lists by a test.
"""

from __future__ import annotations

TASKS = ("localization", "slam")
FILTERS = ("ekf", "ekf-iterated", "ekf-fej", "ekf-invariant")
INCREMENTAL = ("isam2", "fixed-lag")
STEPPING = (*FILTERS, *INCREMENTAL)
BATCH = ("batch", "batch-huber", "batch-cauchy", "gnc")
ESTIMATORS = ("dead-reckoning", *STEPPING, *BATCH)
ASSOCIATIONS = ("known", "nn", "ml", "ml-ratio", "singles", "jcbb", "jcbb-first", "gnn", "jcbb-hindsight", "scan")


def steps(name: str) -> bool:
    """Whether an estimator, ours or not, works frame by frame."""
    return name not in BATCH and name != "dead-reckoning"
