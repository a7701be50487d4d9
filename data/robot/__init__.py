"""The name under which the simulated robot of the wing `robot` is run."""
