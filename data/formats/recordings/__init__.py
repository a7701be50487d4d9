"""Recordings that others published: Victoria Park, the ESDE study."""
