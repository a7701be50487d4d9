"""Trajectories with stamps of their own: matched with a truth, aligned if asked for, and their relative errors."""
