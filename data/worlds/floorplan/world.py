"""The floor plan world: scans of rooms and corridors from a robot whose path is known exactly and its odometry is poor.

Building, route, odometry noise, range noise, glass, people and the error of the prior mean come from independent
streams of the seed, so that changing one parameter does not reshuffle the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from data import se2
from data.errors import UsageError
from data.inputs import Increments, Inputs, Observations, Prior, Scanner, Scans
from data.log import Log
from data.motion.floor import floor_covariances
from data.se2 import Array, BoolArray
from data.sensors import RangeBearing
from data.truth import Truth
from data.worlds.floorplan.building import Building, build
from data.worlds.floorplan.drive import drive
from data.worlds.floorplan.raycast import scan_ranges
from data.worlds.parameters import check_parameters

FLOOR = 1e-10
"""m^2, rad^2; smallest eigenvalue of an increment's covariance."""
SLIP = (0.04, 0.01, 0.04)
"""m, m, rad; standard deviation of what a slip adds to an increment: a good part of a step of 0.1 m."""
PANE = 1.5
"""m, the longest piece of a wall that is of glass or not as a whole."""
PERSON, MANNERS = 0.22, 0.6
"""m, radius of a person, and how near the scanner people come."""


def _degrees(value: float) -> float:
    """A field in radians whose value is written in degrees, in a log's name and as a flag."""
    default: float = field(default=math.radians(value), metadata={"unit": "deg"})
    return default


@dataclass(frozen=True)
class Floorplan:
    """Parameters of the world. Angles: radians here, degrees in names and flags.

    Attributes:
        glass: some pieces of the walls return nothing.
        people: people walk about and hide what is behind them.
        frames: number of frames.
        period: s between frames.
        thin: of so many frames one has a scan, the first included.
        speed: m/s, along straight lines.
        turn_rate: rad/s, at most.
        sigma_along: m per sqrt(s), odometry noise density along the way.
        sigma_across: m per sqrt(s), the same across the way.
        sigma_turn: rad per sqrt(s), the same of the heading.
        slip: probability that the wheels slip in a frame.
        beams: in a scan.
        field_of_view: deg, from the first beam to one after the last.
        max_range: m; nothing as far or farther is measured.
        sigma_range: m, standard deviation of a range.
        rotation: deg, of the scanner: p_scanner = R p_body + T.
        translation_x, translation_y: m, T.
        panes: share of the walls that is of glass, where there is glass.
        crowd: number of people, where there are people.
        prior_sigma: m, prior_sigma_heading: rad; the prior mean is drawn with them (0: it is exact).

    Raises:
        UsageError: a value of the wrong type or out of range.
    """

    glass: bool = field(default=False, metadata={"hint": "its share of the walls is panes=SHARE"})
    people: bool = field(default=False, metadata={"hint": "their number is crowd=N"})
    frames: int = 3000
    period: float = 0.2
    thin: int = 1
    speed: float = 0.5
    turn_rate: float = 0.6
    sigma_along: float = 0.02
    sigma_across: float = 0.007
    sigma_turn: float = 0.02
    slip: float = 0.01
    beams: int = 180
    field_of_view: float = _degrees(180.0)
    max_range: float = 30.0
    sigma_range: float = 0.015
    rotation: float = _degrees(0.0)
    translation_x: float = 0.0
    translation_y: float = 0.0
    panes: float = 0.15
    crowd: int = 15
    prior_sigma: float = 0.0
    prior_sigma_heading: float = 0.0

    def __post_init__(self) -> None:
        check_parameters(
            "floorplan",
            self,
            positive=("frames", "period", "thin", "speed", "turn_rate", "beams", "field_of_view", "max_range",
                      "sigma_range"),
            not_negative=("sigma_along", "sigma_across", "sigma_turn", "slip", "panes", "crowd", "prior_sigma",
                          "prior_sigma_heading"),
        )  # fmt: skip
        for name in ("slip", "panes"):
            if getattr(self, name) > 1.0:
                raise UsageError(f"floorplan: {name} = {getattr(self, name)}; a share of 1 is needed")
        if self.field_of_view > 2.0 * math.pi + 1e-12:
            raise UsageError(f"floorplan: field_of_view = {math.degrees(self.field_of_view):g}; at most 360 deg")

    def scanner(self) -> Scanner:
        """With beams from the right to the left, the same angle on both sides but for one step."""
        return Scanner(
            -0.5 * self.field_of_view,
            self.field_of_view / self.beams,
            self.max_range,
            self.sigma_range,
            self.rotation,
            (self.translation_x, self.translation_y),
        )


def plan_of(seed: int) -> Building:
    """The building of a seed; no parameter changes it."""
    return build(np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0]))


def simulate(floorplan: Floorplan, seed: int, name: str | None = None) -> Log:
    """One log of the floor plan. Same parameters and seed: same bytes."""
    _, route_rng, odometry_rng, range_rng, glass_rng, people_rng, prior_rng = (
        np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)
    )
    building = plan_of(seed)
    time = floorplan.period * np.arange(floorplan.frames, dtype=np.float64)
    truth = drive(building.ways, route_rng, time, floorplan.speed, floorplan.turn_rate)
    increments, floored = _odometry(floorplan, truth, odometry_rng)
    frame = np.arange(0, floorplan.frames, floorplan.thin)
    walls, of_glass = _panes(building, floorplan.panes if floorplan.glass else 0.0, glass_rng)
    crowd = _people(floorplan, building, time, people_rng)[frame] if floorplan.people else None
    scanner = floorplan.scanner()
    if crowd is not None:
        _make_way(crowd, truth[frame], scanner)
    ranges = scan_ranges(truth[frame], scanner, floorplan.beams, walls, glass=of_glass, discs=crowd)
    ranges = np.maximum(ranges + floorplan.sigma_range * range_rng.standard_normal(ranges.shape), 1e-3)
    ranges[ranges >= floorplan.max_range] = 0.0
    sigma = np.array([floorplan.prior_sigma, floorplan.prior_sigma, floorplan.prior_sigma_heading])
    mean = truth[0] + sigma * prior_rng.standard_normal(3)
    mean[2] = se2.wrap_angle(mean[2])
    inputs = Inputs(
        Prior(mean, np.diag(sigma**2)),
        time,
        increments,
        Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2))),
        RangeBearing(max_range=floorplan.max_range),
        floored=floored,
        scans=Scans(scanner, frame, ranges),
    )
    return Log(name or f"floorplan:{seed}", inputs, Truth(truth), source={"kind": "floorplan", "seed": seed})


def _odometry(floorplan: Floorplan, truth: Array, rng: np.random.Generator) -> tuple[Increments, int]:
    """Noisy increments, and the covariance that their error has: that of steady noise and of rare slips together.

    It is the same for every increment: the robot never rests, and one that grew with the true way would tell it.
    """
    exact = se2.between(truth[:-1], truth[1:])
    density = np.array([floorplan.sigma_along, floorplan.sigma_across, floorplan.sigma_turn])
    steady = density * math.sqrt(floorplan.period) * rng.standard_normal(exact.shape)
    slips = rng.random((len(exact), 1)) < floorplan.slip
    slipped = slips * np.array(SLIP) * rng.standard_normal(exact.shape)
    mean, covariance = np.zeros_like(truth), np.zeros((len(truth), 3, 3))
    mean[1:] = exact + steady + slipped
    covariance[1:] = np.diag(np.square(density) * floorplan.period + floorplan.slip * np.square(SLIP))
    covariance, floored = floor_covariances(covariance, FLOOR)
    return Increments(mean, covariance), floored


def _panes(building: Building, share: float, rng: np.random.Generator) -> tuple[Array, BoolArray]:
    """All walls (W, 4) with their faces cut into panes, and (W,) which are of glass."""
    faces = building.walls[: building.faces]
    count = np.maximum(np.ceil(np.linalg.norm(faces[:, 2:] - faces[:, :2], axis=1) / PANE), 1.0).astype(int)
    part = np.concatenate([np.arange(n) / n for n in count])[:, None]
    a, way = np.repeat(faces[:, :2], count, axis=0), np.repeat(faces[:, 2:] - faces[:, :2], count, axis=0)
    step = way / np.repeat(count, count)[:, None]
    glass = rng.random(len(a)) < share
    if not share:
        return building.walls, np.zeros(len(building.walls), bool)
    cut = np.concatenate([a + part * way, a + part * way + step], axis=1)
    rest = building.walls[building.faces :]
    return np.concatenate([cut, rest]), np.concatenate([glass, np.zeros(len(rest), bool)])


def _people(floorplan: Floorplan, building: Building, time: Array, rng: np.random.Generator) -> Array:
    """Discs (N, crowd, 3) of people on walks of their own."""
    discs = np.full((len(time), floorplan.crowd, 3), PERSON)
    for i, own in enumerate(rng.spawn(floorplan.crowd)):
        discs[:, i, :2] = drive(building.ways, own, time, float(own.uniform(0.6, 1.3)), math.pi)[:, :2]
    return discs


def _make_way(discs: Array, poses: Array, scanner: Scanner) -> None:
    """Those too near the scanner at an instant are not there: radius zero."""
    at = se2.compose(poses, se2.inverse(np.array([*scanner.translation, scanner.rotation])))
    near = np.hypot(discs[..., 0] - at[:, None, 0], discs[..., 1] - at[:, None, 1]) < MANNERS
    discs[near, 2] = 0.0
