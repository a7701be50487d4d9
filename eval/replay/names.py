"""The names that tasks, estimators and ways of association have everywhere: listed once, in the order of tables."""

from __future__ import annotations

TASKS = ("localization", "slam")
FILTERS = ("ekf", "ekf-iterated", "ekf-fej", "ekf-invariant")
STEPPING = (*FILTERS, "isam2", "fixed-lag")
ESTIMATORS = ("dead-reckoning", *STEPPING, "batch", "batch-huber", "batch-cauchy", "gnc")
ASSOCIATIONS = ("known", "nn", "ml", "ml-ratio", "singles", "jcbb", "jcbb-first", "gnn", "jcbb-hindsight")
