"""Convert a recording or a simulation to an open log folder: `python -m data.convert`."""
