"""Scores: errors, consistency and confusion as pure functions of runs and truth."""
