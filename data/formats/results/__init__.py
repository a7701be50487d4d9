"""Trajectories of other programs: readers by format, one common type."""
