"""Measurements of `python -m eval.benchmark`."""
