"""The simulated robot: its body in a room, its wheels and sonars, and a line with faults."""
