"""The floor plan: rooms and corridors, a robot with a laser scanner, and its exact path."""
