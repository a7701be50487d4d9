"""Drives estimators over a log; sees the inputs only, never the truth."""
