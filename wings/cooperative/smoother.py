"""Smoothing of a team: all poses of all robots, and the landmarks in SLAM, from all data at once.

The factors are gtsam's, with those of `graph` for each robot; an observation of robot b by robot a has one between both
poses. The frames of the robots are numbered one robot after the other. Gauss-Newton steps and exact covariances are
those of `graph.qr`.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from data.inputs import IntArray, LandmarkMap
from data.result import DISCARD, MapState, Trajectory
from data.se2 import Array, covariances_in_world
from graph import factors
from graph.qr.elimination import Rows, Structure, eliminate, marginals, means, ordering, structure
from graph.qr.rows import Chunk, variables_of
from wings.cooperative.team import Team

STEP, MOST, SHORTEST = 1e-6, 100, 1e-3
"""Sigma, root sum of squares of a step that ends the search; most steps; share below which none is shortened."""
ADDED = 0.03
"""What a remaining step d may add to the NEES of a pose or landmark: d' P^-1 d, since errors of the optimum have mean
zero and covariance P. It is 1 % of the 3 expected, an eighth of the relative standard error
sqrt(2 / 300) of a mean of 100 runs. In the curved valley of odometry that is stiff across the way, steps are short."""


class TeamSmoothed(NamedTuple):
    """The optimum."""

    paths: tuple[Trajectory, ...]  # of each robot
    map: MapState | None  # landmarks by label; None: the map was known
    cost: float  # twice the sum of halved squares
    dof: int
    iterations: int  # steps
    last_step: float  # largest component of the remaining step in sigmas


def smooth_team(
    team: Team, known: LandmarkMap | None, landmark: Sequence[IntArray], sighted: Sequence[IntArray],
    start: Sequence[Array], places: dict[int, Array],
) -> TeamSmoothed:  # fmt: skip
    """The joint maximum a posteriori estimate. UnderConstrained: what is not determined, or without convergence.

    Of each robot: landmark, map id or label of each observation (M,), and sighted, the robot of each encounter (s,), or
    `DISCARD`; start, poses (N, 3). places: start of each landmark (2,) by label, in SLAM.
    """
    first = np.append(0, np.cumsum([len(m) for m in team.members]))
    every, own = list[factors.Factor](), list[tuple[int, Array | gtsam.Pose2]]()
    observed = 0
    for row, member in enumerate(team.members):
        prior = replace(member.prior, covariance=member.prior.covariance + factors.EXACT**2 * np.eye(3))
        every.append(factors.prior_factor(prior).rekey([X(int(first[row]))]))
        motion = member.increments
        every += factors.between_factors(int(first[row]) + 1, motion.mean[1:], motion.covariance[1:])[0]
        used = np.flatnonzero(landmark[row] != DISCARD)
        o, number = member.observations, landmark[row][used]
        seen = (member.sensor, o.z[used], o.R[used], first[row] + o.frame[used], number)
        made = (
            factors.landmark_factors(*seen) if known is None
            else factors.known_landmark_factors(*seen, known.positions(number), int(observed))
        )  # fmt: skip
        every += [f for each in made for f in each.measured]
        own += [value for each in made for value in each.start_values]
        paired = team.of(row)[sighted[row] != DISCARD]
        every += _encounters(team, row, paired, sighted[row][sighted[row] != DISCARD], first)
        observed += len(used) + len(paired) if known is None else len(used)
    values, count = gtsam.Values(), int(first[-1])
    for k, pose in enumerate(np.concatenate(start)):
        values.insert(X(k), factors.pose2(pose))
    for name, xy in places.items():
        values.insert(L(name), xy)
    for key, at in own:
        values.insert(key, at)
    return _optimum(team, _Linear(every, count, np.array(sorted(places), np.int64)), values, first)


def _encounters(team: Team, row: int, seen: IntArray, number: IntArray, first: IntArray) -> list[factors.Factor]:
    """Factors between two poses, of encounters (k,) by a robot of robots `number` (k,)."""
    s, sensor = team.encounters, team.members[row].sensor
    here = first[row] + team.frame[row, s.instant[seen]]
    rows = np.array([team.row(n) for n in number.tolist()], np.int64)
    there = first[rows] + team.frame[rows, s.instant[seen]]
    h, C = factors.bearing_range(sensor, s.z[seen], s.R[seen])
    roots = factors.observation_roots(C, s.R[seen], team.frame[row, s.instant[seen]])
    return [
        gtsam.BearingRangeFactorPose2(X(a), X(b), gtsam.Rot2(z[0]), z[1], factors.noise.Gaussian.SqrtInformation(root))
        for a, b, z, root in zip(here.tolist(), there.tolist(), h, roots, strict=True)
    ]


class _Linear:
    """Factors as whitened rows; landmarks of a known map, which have a variable each, are left out of them."""

    def __init__(self, every: Sequence[factors.Factor], poses: int, labels: IntArray) -> None:
        self.poses, self.labels, self.height = poses, labels, np.array([f.dim() for f in every], np.int64)
        self.chunk = Chunk.of([[f] for f in every], 0, self.height, poses, labels)
        self.graph, self.variable = self.chunk.graph, np.full((len(every), 2), -1)
        for block, f in enumerate(every):
            variable, _ = variables_of(f.keys(), poses, labels)
            there = variable[variable >= 0]
            self.variable[block, : len(there)] = there
        self.dim = np.repeat([3, 2], [poses, len(labels)])
        self.structure: Structure = structure(self.variable, self.dim, ordering(self.variable, 0, len(self.dim)))

    def rows(self, values: gtsam.Values) -> Rows:
        A, b = np.zeros((len(self.height), 3, 6)), np.zeros((len(self.height), 3, 1))
        self.chunk.put(values, self.variable, A, b)
        return Rows(self.variable, A, b, self.height, self.dim)

    def moved(self, values: gtsam.Values, delta: Array) -> gtsam.Values:
        """Values after a step delta (V, 3) in tangent coordinates."""
        vector = gtsam.VectorValues()
        for k, step in enumerate(delta[: self.poses]):
            vector.insert(X(k), step)
        for number, step in zip(self.labels.tolist(), delta[self.poses :, :2], strict=True):
            vector.insert(L(number), step)
        return values.retract(vector)

    def name(self, variable: int) -> str:
        return factors.name_of(X(variable) if variable < self.poses else L(int(self.labels[variable - self.poses])))


def _optimum(team: Team, linear: _Linear, values: gtsam.Values, first: IntArray) -> TeamSmoothed:
    """Gauss-Newton steps, shortened until the cost falls, and covariances at the end."""
    error = linear.graph.error(values)
    for step in range(MOST + 1):
        rows = linear.rows(values)
        triangle = eliminate(rows, linear.structure)
        if triangle.free >= 0:
            raise factors.UnderConstrained(f"{linear.name(triangle.free)} is not determined by the observations")
        delta, length = means(rows, linear.structure, triangle)[:, :, 0], float(np.linalg.norm(triangle.d))
        if length < STEP or step == MOST:
            break
        share = 1.0
        while share > SHORTEST:
            moved = linear.moved(values, share * delta)
            cost = linear.graph.error(moved)
            if cost < error:
                break
            share *= 0.5
        else:
            break
        values, error = moved, cost
    covariance, _ = marginals(rows, linear.structure, triangle, np.zeros((0, 2), np.int64))
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), factors.EXACT**2))
    left = float((np.abs(delta) / sigma).max())
    P = covariance + factors.EXACT**2 * np.eye(3)
    if not (delta * np.linalg.solve(P, delta[:, :, None])[:, :, 0]).sum(1).max() < ADDED:
        raise factors.UnderConstrained(f"no optimum after {step} steps: {left:.2g} sigma are left")
    pose = np.array([factors.pose_array(values.atPose2(X(k))) for k in range(linear.poses)])
    world = covariances_in_world(pose[:, 2], covariance[: linear.poses])
    paths = tuple(Trajectory(pose[a:b], world[a:b]) for a, b in pairwise(first.tolist()))
    state = None
    if len(linear.labels):
        xy = np.array([values.atPoint2(L(n)) for n in linear.labels.tolist()])
        state = MapState(linear.labels, xy, covariance[linear.poses :, :2, :2])
    return TeamSmoothed(paths, state, 2.0 * error, int(linear.height.sum() - linear.dim.sum()), step, left)
