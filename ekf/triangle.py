"""A large symmetric matrix by its lower triangle, in blocks of rows: half the memory, changed in place by BLAS-3."""

from __future__ import annotations

import numpy as np

from data.inputs import IntArray
from data.se2 import Array

ROWS = 256
"""Rows of a block. Measured with 8000 rows and products of rank 300: 128 and 512 are within 5 %."""


class Triangle:
    """Symmetric, grows by rows of zeros. Each block of rows reaches to its own diagonal and holds that block whole.

    Attributes:
        size: rows in use.
    """

    def __init__(self) -> None:
        """Of size 0."""
        self.size = 0
        self._block: list[Array] = []

    def grow(self, size: int) -> None:
        """At least `size` rows, new ones of zeros."""
        while len(self._block) * ROWS < size:
            self._block.append(np.zeros((ROWS, (len(self._block) + 1) * ROWS)))
        self.size = max(self.size, size)

    def columns(self, index: IntArray) -> Array:
        """Columns (size, k) at `index` (k,)."""
        found = np.empty((len(self._block) * ROWS, len(index)))
        home = index // ROWS
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, (b + 1) * ROWS
            left = np.flatnonzero(home <= b)
            found[begin:end, left] = block[:, index[left]]
            own = np.flatnonzero(home == b)
            if len(own):
                found[:begin, own] = block[index[own] - begin, :begin].T
        return found[: self.size]

    def put(self, index: IntArray, columns: Array) -> None:
        """Set columns (size, k) at `index` (k,), and the rows that mirror them."""
        home = index // ROWS
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            left = np.flatnonzero(home <= b)
            block[: end - begin, index[left]] = columns[begin:end, left]
            own = np.flatnonzero(home == b)
            if len(own):
                block[index[own] - begin, :end] = columns[:end, own].T

    def square(self, index: IntArray) -> Array:
        """The entries (k, k) at `index` (k,), which ascends."""
        found = np.empty((len(index), len(index)))
        home = index // ROWS
        for b in np.unique(home).tolist():
            rows, left = np.flatnonzero(home == b), np.flatnonzero(home <= b)
            part = self._block[b][np.ix_(index[rows] - b * ROWS, index[left])]
            found[np.ix_(rows, left)] = part
            found[np.ix_(left, rows)] = part.T
        return found

    def add_product(self, left: Array, right: Array) -> None:
        """Add left @ right.T, of factors (size, c) that make it symmetric."""
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            block[: end - begin, :end] += left[begin:end] @ right[:end].T

    def blocks(self) -> Array:
        """The 2 x 2 blocks (size / 2, 2, 2) of the diagonal, symmetric."""
        found = np.empty((self.size // 2, 2, 2))
        for b, block in enumerate(self._block):
            begin, end = b * ROWS, min((b + 1) * ROWS, self.size)
            row = np.arange(0, end - begin, 2)
            for i in range(2):
                for j in range(2):
                    found[begin // 2 : end // 2, i, j] = block[row + i, begin + row + j]
        mean: Array = 0.5 * (found + found.transpose(0, 2, 1))
        return mean
