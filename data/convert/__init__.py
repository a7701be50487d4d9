"""Turn a recording or a simulation into an open log folder: `python -m data.convert`."""
