"""Graphs of key poses alone: a chain, and loop closures in it."""
