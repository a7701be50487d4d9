"""Known association frame by frame: labels that come with the frames decide."""

from __future__ import annotations

import numpy as np

from association.known import pair_by_label
from data.inputs import Frame, IntArray, LandmarkMap
from data.result import DISCARD


class KnownAssociation:
    """Decisions by label; in SLAM a label stands for the landmark that it initialized, while that is in the map."""

    def __init__(self, known: LandmarkMap | None) -> None:
        """Before the first frame; `known` is the map of localization."""
        self.map = known
        self._number_of: dict[int, int] = {}
        self._label_of: dict[int, int] = {}

    def decide(self, frame: Frame) -> IntArray:
        """Decisions (m,) about a frame's observations. Raises ValueError where labels were not granted."""
        if frame.label is None:
            raise ValueError("known association was not granted to these inputs")
        if self.map is not None:
            return np.where(np.isin(frame.label, self.map.id), frame.label, DISCARD)
        return pair_by_label(frame.label, self._number_of)

    def initialized(self, frame: Frame, created: IntArray) -> None:
        """Landmarks (m,) that the frame's observations initialized, -1 for none."""
        assert frame.label is not None  # or `decide` would have said so
        for i in np.flatnonzero(created >= 0):
            label, number = int(frame.label[i]), int(created[i])
            self._number_of[label], self._label_of[number] = number, label

    def removed(self, numbers: IntArray) -> None:
        """Landmarks (r,) that are no longer in the map: their labels may initialize others."""
        for n in numbers.tolist():
            self._number_of.pop(self._label_of.pop(n, -1), None)
