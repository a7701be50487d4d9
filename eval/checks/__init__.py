"""Checks of estimators and association methods, as scikit-learn checks estimators: each result is a sentence."""
