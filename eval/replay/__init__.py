"""Runs estimators over a log (`eval.replay.run.compare`); sees the inputs only, never the truth."""
