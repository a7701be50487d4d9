"""Laser scans: matching, loop-closure checks, corners and occupancy grids."""
