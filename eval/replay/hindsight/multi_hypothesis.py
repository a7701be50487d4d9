"""Multiple hypotheses (`mht`): several histories of decisions, each with an estimator of its own.

Reid, "An algorithm for tracking multiple targets", IEEE TAC 24(6), 1979; the best children of a hypothesis by Murty's
method (Operations Research 16(3), 1968; Cox and Hingorani, IEEE PAMI 18(2), 1996). In a frame each observation is of a
landmark inside the outer gate, of a new one, or, where it is inside a gate, of none. A child's likelihood has three
parts: the joint innovation of its pairings, the densities of new landmarks and of clutter in the view, and the
landmarks in view that were not observed. The likeliest hypothesis decides. Where another one becomes the likeliest, its
earlier decisions revise the others.
"""

import copy
import heapq
import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from association.expectation import gate_threshold
from association.truncated import Acceptance
from data.inputs import Frame, IntArray
from data.notice import Notice
from data.result import DISCARD, NEW, Event, Finished, MapState, Updated
from data.se2 import Array
from ekf.filter import FilterOptions
from eval.replay.external.adapter import CannotError
from eval.replay.frontend import FrontEnd, Pairing
from eval.replay.hindsight.hypotheses import DROP, STRAY, Choice, DetectionRates, one_pose, view_area
from eval.replay.settings import MHT, Given, Setup


def best_assignments(cost: Array, most: int, slack: float) -> list[tuple[float, IntArray]]:
    """Summed cost and column (m,) of at most `most` assignments of all rows to different columns of `cost` (m, n),
    infinite where impossible, cheapest first, of finite cost, within `slack` of the cheapest.
    """
    found = list[tuple[float, IntArray]]()
    problems = list[tuple[float, int, IntArray, Array, int]]()  # cost, order, columns; what is allowed, rows fixed
    limit = np.inf

    def solve(allowed: Array, fixed: int) -> None:
        try:
            rows, columns = scipy.optimize.linear_sum_assignment(allowed)
        except ValueError:  # every assignment has an infinite cost
            return
        total = float(allowed[rows, columns].sum())
        if total <= limit:
            heapq.heappush(problems, (total, len(found) * len(cost) + fixed, columns, allowed, fixed))

    solve(cost, 0)
    while problems and len(found) < most:
        total, _, columns, allowed, fixed = heapq.heappop(problems)
        found.append((total, columns))
        limit = found[0][0] + slack
        left = allowed.copy()  # the other assignments of this problem: the first that differs in a row, by row
        for row in range(fixed, len(cost)):
            other = left.copy()
            other[row, columns[row]] = np.inf
            solve(other, row)
            left[row, np.arange(left.shape[1]) != columns[row]] = np.inf
    return found


class _Replay(FrontEnd):
    """One hypothesis's replay: decisions are handed to it."""

    @property
    def passed(self) -> Acceptance:
        """Each pairing has passed the outer gate."""
        return Acceptance(gate_threshold(self.setup.new_gate, len(self.sensor.measures)))


@dataclass(eq=False)
class _Hypothesis:
    """A history of decisions, its estimator, and the logarithm of its weight. names: numbers in decisions of its
    landmarks, one for the same first observation in all; pairing: of the present frame, with the estimator's numbers.
    """

    replay: _Replay
    weight: float
    names: list[int]
    past: Choice | None = None
    pairing: Pairing | None = None

    def as_decided(self, numbers: IntArray) -> IntArray:
        """Numbers (n,) in decisions of landmarks (n,) of the estimator; `NEW` and `DISCARD` stay."""
        if not self.replay.slam:
            return numbers
        return np.where(numbers >= 0, np.array([*self.names, -1], np.int64)[numbers], numbers)


class MultiHypothesisFrontEnd(FrontEnd):
    """Decides by the likeliest of several hypotheses (`Setup.hypotheses`), for any estimator that can be copied."""

    def __init__(
        self, estimator: str, association: str, given: Given, setup: Setup, options: FilterOptions | None = None
    ) -> None:
        """Raises CannotError: the estimator lacks a capability that the setup needs, or cannot be copied."""
        replay = _Replay(estimator, "jcbb", given, setup, options)
        self._shared = (*replay.given, *replay.given.sensors, replay.given, setup)
        self.members = [_Hypothesis(replay, 0.0, [])]
        super().__init__(estimator, association, given, setup, options)
        try:
            self._copied(replay)
        except (TypeError, RuntimeError) as why:
            raise CannotError(f"--association {MHT}: the estimator cannot be copied ({why})") from None
        self.map_management = self.parking = None  # each hypothesis has its own
        self._detection, self._reach = DetectionRates(given.sensor), 0.0
        self._number: dict[int, int] = {}  # of landmarks, by the row of the observation that initialized each
        self._first = 0  # landmarks of the first frame that observed any
        self._told: Choice | None = None  # the decisions of the likeliest hypothesis before this frame
        self._revised: list[Event] = []
        self._follow()

    def _copied(self, replay: _Replay) -> _Replay:
        """A copy that shares only what the log states."""
        return copy.deepcopy(replay, {id(each): each for each in self._shared})

    def _follow(self) -> None:
        """Use the likeliest hypothesis's estimator as this front end's."""
        first = self.members[0].replay
        self.estimator, self.can, self.foreign, self.own = first.estimator, first.can, first.foreign, first.own
        self.poses, self.sensor, self.waiting = first.poses, first.sensor, None

    def move(self, frame: Frame) -> None:
        """Predict all."""
        self.k = frame.number
        for h in self.members:
            h.replay.move(frame)

    def use_poses(self, frame: Frame) -> None:
        """Update all with the frame's fixes and closures, which also weigh them."""
        for h in self.members:
            h.replay.use_poses(frame)
            for done in (h.replay.poses.fixed, h.replay.poses.closed):
                h.weight -= 0.0 if done is None else 0.5 * float(np.nansum(done.nis))

    def look(self, frame: Frame) -> None:
        """Use the sensor of (a part of) a frame."""
        for h in self.members:
            h.replay.look(frame)

    def associate(self, frame: Frame) -> Pairing:
        """Branch, keep the likeliest children, and decide by the first of them."""
        sensor = self.members[0].replay.sensor
        far = sensor.polar(frame.observations.z)[:, 0].max(initial=self._reach)
        self._reach = sensor.max_range if math.isfinite(sensor.max_range) else max(float(far), 1.0)
        children = [child for h in self.members for child in self._children(h, frame)]
        children.sort(key=lambda child: -child[0])
        least, taken, kept = children[0][0] - DROP, set[int](), list[_Hypothesis]()
        for weight, parent, pairing in [c for c in children if c[0] > least][: self.setup.hypotheses]:
            replay = parent.replay if id(parent) not in taken else self._copied(parent.replay)
            kept.append(_Hypothesis(replay, weight - children[0][0], list(parent.names), parent.past, pairing))
            taken.add(id(parent))
        self.members = kept
        self._revise(kept[0].past)
        self._follow()
        return self._shown(kept[0])

    def _children(self, h: _Hypothesis, frame: Frame) -> list[tuple[float, _Hypothesis, Pairing]]:
        """The likeliest children of a hypothesis: weight, parent and decisions."""
        e, slam = h.replay.expect(frame.observations, frame.appearance), h.replay.slam
        m, n, area = len(e.z), len(e.number), view_area(h.replay.sensor, self._reach)
        d2 = e.individual_distances()
        inside = d2 < e.threshold(self.setup.new_gate)
        new = -math.log((1.0 + len(h.names) - self._first) / (10.0 + self.k) / area)  # of each in the frames so far
        cost = np.full((m, n + 2 * m), np.inf)  # candidates, new, none
        cost[:, :n][inside] = 0.5 * (d2 + e.log_determinants())[inside] + e.dims * math.log(math.sqrt(2.0 * math.pi))
        own = np.arange(m)
        if slam:
            cost[own, n + own] = new
        cost[own, n + m + own] = np.where(inside.any(axis=1) | (not slam), -math.log(STRAY / area), np.inf)
        seen, part = self._detection.within(e.z_hat, e.HPHt, self._reach)
        miss = np.log1p(-self._detection.rates[part])
        children = []
        for _, columns in best_assignments(cost, self.setup.hypotheses, DROP):
            rows = np.flatnonzero(columns < n)
            chosen = columns[rows]
            likelihood = e.innovation_statistics(rows, chosen)[2]
            if e.unlike is not None:
                likelihood -= 0.5 * float(e.unlike.distance[rows, chosen].sum())
            decisions = np.where(columns < n + m, NEW, DISCARD)
            decisions[rows] = e.number[chosen]
            weight = h.weight + likelihood - float(cost[own, columns][columns >= n].sum())
            weight += float(miss[~np.isin(seen, chosen)].sum())
            children.append((weight, h, Pairing(decisions, e, S=e.joint_innovation(rows, chosen)[1])))
        if h is self.members[0]:
            first = children[0][2].decisions
            self._detection.learn(part, np.isin(e.number[seen], first[first >= 0]), 1.0)
        return children

    def update(self, frame: Frame, pairing: Pairing) -> Updated:
        """Update each hypothesis with its own decisions; the result is the likeliest one's."""
        results = []
        for h in self.members:
            assert h.pairing is not None
            done, decisions = h.replay.update(frame, h.pairing), h.as_decided(h.pairing.decisions)
            for i in np.flatnonzero(done.created >= 0).tolist():
                h.names.append(self._number.setdefault(frame.first + i, len(self._number)))
            for i, number in enumerate(decisions.tolist()):
                h.past = Choice(frame.first + i, number, h.past)
            results.append(done)
        self._first = self._first or len(self.members[0].names)
        self._told = self.members[0].past
        return results[0]._replace(created=self.members[0].as_decided(results[0].created))

    def tidy(self) -> None:
        """The end of a frame: hypotheses with the same landmarks at the same pose become one."""
        kept = list[_Hypothesis]()
        for h in self.members:
            h.replay.tidy()
            at = h.replay.estimator.estimate()
            same = (k for k in kept if k.names == h.names and one_pose(*k.replay.estimator.estimate(), *at))
            if next(same, None) is None:
                kept.append(h)
        self.members = kept

    def _revise(self, past: Choice | None) -> None:
        """Events where this history differs from the decisions so far; both hold the same rows, newest first."""
        told, found = self._told, list[Event]()
        while past is not told:
            assert past is not None
            assert told is not None
            if past.number != told.number:
                found.append(Event(self.k, past.row, told.number, past.number, "another hypothesis leads"))
            past, told = past.before, told.before
        self._revised += reversed(found)

    def _shown(self, h: _Hypothesis) -> Pairing:
        """Its pairing, with the numbers of decisions."""
        assert h.pairing is not None
        assert h.pairing.expectation is not None
        e = h.pairing.expectation
        return h.pairing._replace(
            decisions=h.as_decided(h.pairing.decisions), expectation=replace(e, number=h.as_decided(e.number))
        )

    @property
    def state_size(self) -> int:
        """Length of the likeliest hypothesis's state."""
        return self.members[0].replay.state_size

    def events(self) -> tuple[Event, ...]:
        """Revised decisions."""
        return tuple(self._revised)

    def initialized(self, final: IntArray, created: IntArray) -> tuple[IntArray, IntArray | None]:
        """See `FrontEnd.initialized`."""
        row_of = {number: row for row, number in self._number.items()}
        begun, names = np.full_like(created, -1), self.members[0].names
        begun[[row_of[n] for n in names]] = names
        gone = [] if self.map_management is None else list(self.map_management.retracted)
        return np.where(created >= 0, created, begun), np.where(np.isin(begun, gone), -1, begun)

    def as_decided(self, numbers: IntArray) -> IntArray:
        """See `FrontEnd`: of the likeliest hypothesis."""
        return self.members[0].as_decided(numbers)

    def landmarks(self) -> MapState:
        """The likeliest hypothesis's map."""
        state = self.members[0].replay.landmarks()
        return state._replace(number=self.as_decided(state.number))

    def finish(self) -> Finished:
        """The end of the likeliest hypothesis."""
        first, done = self.members[0], self.estimator.finish()
        managed, own = first.replay.map_management, done.map
        if managed is not None:
            self.map_management = copy.copy(managed)
            self.map_management.removed = {first.names[n]: frame for n, frame in managed.removed.items()}
            self.map_management.retracted = {first.names[n] for n in managed.retracted}
        return done if own is None else done._replace(map=own._replace(number=first.as_decided(own.number)))

    def notes(self) -> list[Notice]:
        """Messages about the likeliest hypothesis's run."""
        return self.members[0].replay.notes()
