"""Noise fitted to a log: model and fit of `python -m eval.tune`."""
