"""Floor plans: buildings, ways through them, ranges known on paper, and logs whose noise is as stated."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from data.errors import UsageError
from data.inputs import Scanner
from data.se2 import compose, dead_reckoned, inverse
from data.worlds.registry import named_log
from wings.laser.floorplan.world import Floorplan, _layout, drive, plan_of, scan_ranges, simulate

SHORT = 400


@pytest.fixture(scope="module")
def log():
    return named_log(f"floorplan:3:frames={SHORT}")


def test_ranges_have_the_noise_that_the_scanner_states(log):
    scans = log.inputs().scans
    exact = scan_ranges(log.truth.pose, scans.scanner, 180, plan_of(3).walls)
    error = (scans.ranges - exact)[scans.ranges > 0]
    np.testing.assert_allclose(error.std(), scans.scanner.sigma, rtol=0.02)
    assert abs(error.mean()) < 4.0 * scans.scanner.sigma / np.sqrt(error.size)


@pytest.mark.slow
def test_odometry_drifts_by_metres_and_the_robot_comes_back_by_both_directions():
    log = simulate(Floorplan(thin=3000), 0)
    p = log.truth.pose
    reckoned = dead_reckoned(log.inputs().prior.mean, log.inputs().increments.mean)
    assert 1.0 < np.hypot(*(reckoned - p)[:, :2].T).mean() < 10.0
    near = np.hypot(*(p[:, None, :2] - p[None, :, :2])[::10, ::10].transpose(2, 0, 1)) < 0.4
    later = np.subtract.outer(np.arange(300), np.arange(300)) > 30  # one minute
    turned = np.cos(p[::10, None, 2] - p[None, ::10, 2])
    assert (near & later & (turned > 0.9)).sum() > 20
    assert (near & later & (turned < -0.9)).sum() > 20


def test_same_seed_same_log_and_a_switch_reshuffles_nothing(log):
    again = named_log(f"floorplan:3:frames={SHORT}").inputs()
    assert again.scans.ranges.tobytes() == log.inputs().scans.ranges.tobytes()
    assert again.increments.mean.tobytes() == log.inputs().increments.mean.tobytes()
    plain, seen = log.inputs().scans.ranges, named_log(f"floorplan:3:frames={SHORT}+people").inputs()
    nearer = seen.scans.ranges < plain
    assert (seen.scans.ranges == plain)[~nearer].all()
    assert 0.001 < nearer.mean() < 0.5
    glass = named_log(f"floorplan:3:frames={SHORT}+glass").inputs().scans.ranges
    lost = glass == 0.0
    assert 0.02 < lost.mean() < 0.5
    np.testing.assert_allclose(glass[~lost], plain[~lost], atol=1e-9)


def test_thin_logs_have_fewer_scans_and_the_same_ones(log):
    thin = named_log(f"floorplan:3:frames={SHORT}+thin=5").inputs()
    assert len(thin.time) == SHORT
    np.testing.assert_array_equal(thin.scans.frame, np.arange(0, SHORT, 5))
    assert thin.scans.of(1) is None


@pytest.mark.parametrize("key", ["frames=0", "beams=0", "slip=1.5", "panes=2", "field_of_view=361", "glass=maybe"])
def test_parameters_out_of_range_are_refused(key):
    with pytest.raises(UsageError, match=key.partition("=")[0]):
        named_log(f"floorplan:0:{key}")


ROUND = Scanner(-math.pi, math.radians(4.0), 60.0, 0.01)


@pytest.fixture(scope="module", params=range(4))
def building(request):
    return plan_of(request.param)


def test_every_place_can_be_reached(building):
    ways, n = building.ways, len(building.ways.place)
    graph = csr_array((ways.length, ways.edge.T.astype(np.int32)), shape=(n, n))
    assert connected_components(graph, False)[0] == 1
    route = ways.route(int(ways.target[0]), int(ways.target[-1]), ways.length)
    steps = {frozenset(e) for e in ways.edge.tolist()}
    assert all(frozenset(pair) in steps for pair in pairwise(route))


def test_a_drive_keeps_clear_of_walls_and_furniture_and_sees_no_way_out(building):
    path = drive(building.ways, np.random.default_rng(0), 2.0 * np.arange(600), 0.5, 0.6)
    ranges = scan_ranges(path, ROUND, 90, building.walls)
    assert ranges.min() > 0.25
    assert ranges.max() < 42.5  # the diagonal of 30 m a side


@pytest.mark.parametrize("seed", range(12))
def test_every_place_inside_is_in_one_room_or_in_a_corridor(seed):
    corridors, rooms = _layout(np.random.default_rng(seed))
    every = np.array([*corridors, *rooms])
    size = every[:, 2:].max(axis=0)
    assert every[:, :2].min(axis=0).tolist() == [0.0, 0.0]
    assert ((size >= 25.0) & (size <= 30.0)).all()
    for x, y in np.random.default_rng(seed).uniform(0.0, 1.0, (400, 2)) * size:
        in_corridors = sum(r.holds(x, y) for r in corridors)
        in_rooms = sum(r.holds(x, y) for r in rooms)
        assert (in_rooms == 0) if in_corridors else (in_rooms == 1), (x, y)
    narrow = [min(r.x1 - r.x0, r.y1 - r.y0) for r in corridors]
    assert 1.8 <= min(narrow) <= max(narrow) <= 2.4


FULL = Scanner(-math.pi, math.radians(2.0), 20.0, 0.01)


def reference(pose, scanner, beams, walls, discs):
    """Every beam against every wall as a 2 x 2 system, and against every disc as a quadratic."""
    x, y, theta = compose(pose, inverse(np.array([*scanner.translation, scanner.rotation])))
    ranges = np.full(beams, np.inf)
    for b in range(beams):
        angle = theta + scanner.angle_min + b * scanner.angle_step
        d, o = np.array([math.cos(angle), math.sin(angle)]), np.array([x, y])
        for w in walls:
            a, e = w[:2], w[2:] - w[:2]
            r, u = np.linalg.solve(np.stack([d, -e], 1), a - o)
            if r > 0 and 0 <= u <= 1:
                ranges[b] = min(ranges[b], r)
        for cx, cy, radius in discs:
            c = np.array([cx, cy]) - o
            roots = np.roots([1.0, -2.0 * d @ c, c @ c - radius**2])
            if np.isreal(roots).all() and roots.min() > 0:
                ranges[b] = min(ranges[b], roots.min())
    return np.where(ranges < scanner.max_range, ranges, np.inf)


@pytest.mark.parametrize("seed", range(2))
def test_the_nearest_of_all_that_a_beam_meets(seed):
    rng = np.random.default_rng(seed)
    walls = rng.uniform(-6, 6, (12, 4))
    discs = np.column_stack([rng.uniform(-6, 6, (3, 2)), rng.uniform(0.1, 0.5, 3)])
    poses = np.column_stack([rng.uniform(-3, 3, (3, 2)), rng.uniform(-9, 9, 3)])
    fan = Scanner(-2.0, 0.05, 3.0, 0.01, rotation=0.7, translation=(0.2, -0.1))
    for scanner, beams in ((FULL, 180), (fan, 60)):
        found = scan_ranges(poses, scanner, beams, walls, discs=np.broadcast_to(discs, (3, 3, 3)))
        expected = [reference(p, scanner, beams, walls, discs) for p in poses]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.isinf(found).any()  # the second one's reach is short
    assert np.isfinite(found).any()


def test_glass_returns_nothing_and_hides_what_is_behind():
    ahead = Scanner(0.0, 0.1, 20.0, 0.01)
    walls = np.array([[1.0, -1, 1, 1], [2, -1, 2, 1]])
    at = np.zeros((1, 3))
    assert scan_ranges(at, ahead, 1, walls)[0, 0] == 1.0
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([True, False]))[0, 0] == np.inf
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([False, True]))[0, 0] == 1.0
    person = np.array([[[0.8, 0.0, 0.25]]])
    assert scan_ranges(at, ahead, 1, walls, glass=np.array([True, True]), discs=person)[0, 0] == pytest.approx(0.55)
