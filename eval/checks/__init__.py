"""Checks of anybody's estimator or way of association, as scikit-learn checks estimators: each result a sentence."""
