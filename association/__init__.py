"""Data association: an expectation of the measurements, and decisions made from it by pure functions."""
