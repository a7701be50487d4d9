"""Association outcomes: each decision against the right landmark at that frame, as TP, TN, FP or FN.

H is the decision (a landmark, or none for NEW and DISCARD). GT is the lowest-numbered landmark in the map at that frame
that was initialized from the same true id, else none; clutter has GT none. TP: H = GT, a landmark. TN: both none.
FP: H a landmark other than GT. FN: H none although GT is a landmark. They sum to the number of observations.
"""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from data.inputs import CLUTTER, IntArray, LandmarkMap
from data.result import DISCARD, NEW
from data.se2 import BoolArray
from data.truth import UNKNOWN_ID

OUTCOMES = ("tp", "tn", "fp", "fn")
WITHIN = 0.3  # m, distance within which a neighbour of the right landmark counts as near
NO_LANDMARK = -1  # GT of an observation whose landmark is not in the map


@dataclass(frozen=True)
class Confusion:
    """Outcomes of a run; the counts of TP, TN, FP and FN sum to M."""

    outcome: IntArray  # (M,) index into `OUTCOMES`
    ground_truth: IntArray  # (M,) landmark number, or `NO_LANDMARK`
    tp: int
    tn: int
    fp: int
    fn: int
    wrong: int  # FP where GT was a landmark
    spurious: int  # FP where GT was none
    duplicate: int  # FN that initialized a second landmark
    missed: int  # FN that was discarded
    deferred: int = 0  # FN discarded online and paired finally

    @property
    def precision(self) -> float:
        """TP / (TP + FP); NaN where nothing was paired."""
        return self.tp / (self.tp + self.fp) if self.tp + self.fp else float("nan")

    @property
    def recall(self) -> float:
        """TP / (TP + FN); NaN where nothing could be paired."""
        return self.tp / (self.tp + self.fn) if self.tp + self.fn else float("nan")


def ground_truth(
    frame: IntArray, true_id: IntArray, decisions: IntArray, created: IntArray, known: LandmarkMap | None,
    removed: IntArray | None = None,
) -> IntArray:  # fmt: skip
    """GT (M,) per observation. With a known map the landmark number is the true id, where the map has it.

    In SLAM a landmark is in the map from the frame after its initialization (the decisions of a frame are made
    together) up to the frame `removed` (L,) by landmark number, -1: never removed. Where revised `decisions` (M,) pair
    observations before the one that initializes it, it is in the map from the first of them on.
    """
    if known is not None:
        return np.where(np.isin(true_id, known.id), true_id, NO_LANDMARK)
    gt: IntArray = np.full(len(true_id), NO_LANDMARK, np.int64)
    numbers, row = np.unique(decisions, return_index=True)
    first = dict(zip(numbers.tolist(), frame[row].tolist(), strict=True))
    copies = defaultdict[int, list[tuple[int, int, int, int]]](list)
    rows = np.flatnonzero(created >= 0)
    for i in rows[np.argsort(created[rows], kind="stable")].tolist():
        n, now = int(created[i]), int(frame[i])
        until = -1 if removed is None else int(removed[n])
        copies[int(true_id[i])].append((n, min(now, first.get(n, now + 1) - 1), until, i))
    for i, identity in enumerate(true_id.tolist()):
        if identity < 0:
            continue
        now = int(frame[i])
        for number, since, until, by in copies.get(identity, ()):
            if since < now and i != by and (until < 0 or now <= until):
                gt[i] = number
                break
    return gt


def confuse(
    frame: IntArray, true_id: IntArray, decisions: IntArray, created: IntArray, known: LandmarkMap | None,
    removed: IntArray | None = None, final: IntArray | None = None,
) -> Confusion | None:  # fmt: skip
    """Outcomes of decisions (M,), of which `final` (M,) is the last revision; None if some true id is unknown."""
    if np.any(true_id == UNKNOWN_ID):
        return None
    gt = ground_truth(frame, true_id, decisions, created, known, removed)
    paired, has = decisions >= 0, gt >= 0
    tp = paired & (decisions == gt)
    fp = paired & ~tp
    fn = ~paired & has
    tn = ~paired & ~has
    deferred = np.zeros(len(decisions), np.bool_) if final is None else fn & (decisions == DISCARD) & (final >= 0)
    outcome = np.select([tp, tn, fp, fn], [0, 1, 2, 3]).astype(np.int64)
    counts = {name: int(mask.sum()) for name, mask in zip(OUTCOMES, (tp, tn, fp, fn), strict=True)}
    if sum(counts.values()) != len(decisions):
        raise AssertionError(f"outcomes {counts} do not sum to the {len(decisions)} observations")
    return Confusion(
        outcome, gt, **counts, wrong=int((fp & has).sum()), spurious=int((fp & ~has).sum()),
        duplicate=int((fn & (decisions == NEW)).sum()), missed=int((fn & (decisions != NEW) & ~deferred).sum()),
        deferred=int(deferred.sum()),
    )  # fmt: skip


def majority(number: IntArray, true_id: IntArray, first: BoolArray) -> IntArray:
    """The most frequent true id (M,) of each landmark's observations, by landmark `number` (M,) < 0: none; `CLUTTER`:
    no landmark. Of equally frequent ids that of its `first` (M,) observation wins, else the lowest.
    """
    size = int(number.max(initial=-1)) + 1
    named: IntArray = np.full(size, CLUTTER, np.int64)
    rows = np.flatnonzero((number >= 0) & (true_id >= 0))
    pairs, count = np.unique(np.stack([number[rows], true_id[rows]], 1), axis=0, return_counts=True)
    initial = np.full(size, CLUTTER, np.int64)
    begun = np.flatnonzero(first & (number >= 0))
    initial[number[begun]] = true_id[begun]
    own = pairs[:, 1] == initial[pairs[:, 0]]
    order = np.lexsort((-pairs[:, 1], own, count))  # the last one written is the most frequent
    named[pairs[order, 0]] = pairs[order, 1]
    return named


def majority_agreement(decisions: IntArray, true_id: IntArray) -> float:
    """Share of pairings that have the most frequent true id of their landmark; NaN without pairings.

    `confuse` names a landmark by its first observation: if that was a neighbour's, all right ones after it count as
    wrong. Here they do not. Clutter agrees with nothing.
    """
    paired = decisions >= 0
    if not paired.any():
        return float("nan")
    named = majority(decisions, true_id, np.zeros(len(decisions), np.bool_))
    return float(np.mean((true_id[paired] >= 0) & (named[decisions[paired]] == true_id[paired])))


def share_within(decisions: IntArray, true_id: IntArray, taken_id: IntArray, places: LandmarkMap) -> float:
    """Share of pairings whose landmark is truly within `WITHIN` of the right one; NaN without pairings.

    True positions of the observation's `true_id` (M,) and the paired landmark's `taken_id` (M,) are compared. An id
    without a true position is never near.
    """
    paired = np.flatnonzero(decisions >= 0)
    if not len(paired):
        return float("nan")
    own, taken = (places.positions(ids[paired]) for ids in (true_id, taken_id))
    return float(np.mean(np.hypot(*(own - taken).T) <= WITHIN))  # a comparison with NaN is false
