"""Pose graphs: a chain of key poses, and loop closures in it."""
