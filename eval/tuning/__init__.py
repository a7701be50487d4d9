"""Model and fit of noise to a log, for `python -m eval.tune`."""
