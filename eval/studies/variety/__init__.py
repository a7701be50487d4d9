"""A variety of simulated worlds: what is drawn by index, and the log of it."""
