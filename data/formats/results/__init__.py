"""Trajectories that other programs wrote: one file a format, each read into the same type."""
