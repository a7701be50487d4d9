"""A chunk of the player, decoded as in the page."""

import base64
import zlib

import numpy as np


def unpacked(chunk):
    """The arrays (rows, columns) of a chunk by name, decoded as in the page; NaN where missing."""
    content = zlib.decompress(base64.b64decode(chunk["data"]), -15)
    found = {}
    for entry in chunk["arrays"]:
        rows, columns, size = entry["rows"], entry["columns"], entry["size"]
        planes = np.frombuffer(content, np.uint8, rows * columns * size, entry["at"]).reshape(size, -1)
        integers = np.ascontiguousarray(planes.T).view(f"<i{size}").reshape(columns, rows)
        values = integers.T if entry["steps"] else np.cumsum(integers.astype(np.int64), axis=1).T
        values = values * entry["scale"]
        values = np.exp(values) if entry["log"] else values.astype(float)
        for begin, stop in entry["missing"]:
            values[begin:stop] = np.nan
        found[entry["name"]] = values
    return found
