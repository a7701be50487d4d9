"""Names of simulated logs: one grammar for every world, and one line for what does not follow it."""

import math
from dataclasses import fields

import pytest

from data.errors import UsageError
from data.logs import open_log
from data.worlds import registry
from data.worlds.arena import Arena
from data.worlds.circle import Circle
from data.worlds.corridor import Corridor
from data.worlds.linear import LinearWorld
from data.worlds.registry import name_of
from wings.camera.gallery import Gallery

WORLDS = tuple(registry.SIMULATORS)


@pytest.mark.parametrize(("name", "said"), [
    ("arena:0:frames=40", ("arena", Arena(frames=40), 0, {})),
    ("arena:7:sensor=relative_point+sigma-v=.2", ("arena", Arena(sensor="relative_point", sigma_v=0.2), 7, {})),
    ("circle:2:speed_noise=end+centre_y=3", ("circle", Circle(speed_noise="end", centre_y=3.0), 2, {})),
    ("linear:1:frames=20+sigma_turn=3e-5", ("linear", LinearWorld(frames=20), 1, {})),
    ("corridor:0:people+no-odometry+range=8", ("corridor", Corridor(people=True, odometry=False, range=8.0), 0, {})),
    ("corridor:0:no-odometry+forward+step_mean=1+turn_sigma=30",
     ("corridor", Corridor(odometry=False, forward=True, step_mean=1.0, turn_sigma=math.radians(30)), 0, {})),
    ("visual:0:frames=40", ("visual", Gallery(), 0, {"frames": 40})),
    ("visual:3:duration=20+frames=7", ("visual", Gallery(duration=20.0), 3, {"frames": 7})),
])  # fmt: skip
def test_a_name_says_world_parameters_and_seed(name, said):
    assert registry.parse(name) == said


@pytest.mark.parametrize("world", WORLDS)
def test_a_bare_name_says_the_defaults(world):
    assert registry.parse(f"{world}:3") == (world, registry.parameters_of(world)(), 3, {})
    assert name_of(world, registry.parameters_of(world)(), 3) == f"{world}:3"


SENSELESS = [
    ("x", "the seed is a whole number, as in {world}:0"), ("", "the seed is a whole number, as in {world}:0"),
    ("-1", "the seed is a whole number, as in {world}:0"),
    ("1.5:frames=40", "the seed is a whole number, as in {world}:0"), ("0:", "'' is not known"),
    ("0:colour=red", "'colour=red' is not known"), ("0:frames=9+", "'' is not known"),
    ("0:frames", "frames needs a value, as in frames=1; known: "),
    ("0:no-frames", "frames needs a value, as in frames=1; known: "),
    ("0:frames=many", "frames=many: a whole number is needed"),
    ("0:frames=4.5", "frames=4.5: a whole number is needed"), ("0:frames=0", "at least 1 is needed"),
    ("0:frames=9+frames=8", "frames is given twice"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "wrong"), [
    *((f"{world}:{rest}", wrong.format(world=world)) for world in WORLDS for rest, wrong in SENSELESS),
    ("arena:0:sigma_v=fast", "arena:0:sigma_v=fast: sigma_v=fast: a number is needed"),
    ("arena:0:sensor=sonar", "arena: sensor = 'sonar': unknown; known: range_bearing, relative_point"),
    ("circle:0:speed=nan", "circle:0:speed=nan: speed=nan: a number is needed"),
    ("circle:0:speed_noise=x", "circle: speed_noise = 'x': unknown; known: start, end"),
    ("corridor:0:people=20", "people=20: on or off is needed; their number is crowd=N"),
    ("linear:0:spacing=-1", "linear: spacing = -1.0; a positive number is needed"),
    ("corridor:0:no-people=1", "no-people=1"), ("corridor:0:no-range", "range needs a value"),
    ("corridor:0:srho=-.1", "srho = -0.1"), ("corridor:0:crowd=20", "without people"),
    ("corridor:0:sx_blind=1", "no-odometry"), ("corridor:0:no-odometry+sx_move=1", "no-odometry"),
    ("corridor:0:min_angle=-181", "min_angle = -181"), ("corridor:0:people+people=on", "people is given twice"),
    ("corridor:0:forward", "forward = True has no effect with odometry"),
    ("corridor:0:no-odometry+forward+constant-velocity", "one can be stated"),
    ("corridor:0:no-odometry+forward+sx_blind=1", "with a motion prior"),
    ("corridor:0:no-odometry+step_mean=1", "without forward"),
    ("corridor:0:no-odometry+forward+velocity=2", "without constant-velocity"),
    ("corridor:0:no-odometry+turn_sigma=20", "without a motion prior"),
    ("mixed:0:outliers=2", "mixed: outliers = 2.0; a share is needed"),
    ("mixed:0:sigma-gps=0", "mixed: sigma_gps = 0.0; a positive number is needed"),
])  # fmt: skip
def test_a_name_that_makes_no_sense_is_refused_in_one_line(name, wrong):
    with pytest.raises(UsageError) as fault:
        open_log(name)
    assert wrong in str(fault.value)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize(("world", "change", "wrong"), [
    *(("arena", {key: value}, f"arena: {key} = {value}") for key, value in [
        ("landmarks", 0), ("frames", 0), ("side", 0.0), ("period", 0.0), ("odometry_rate", 0.0), ("radius", 0.0),
        ("max_range", 0.0), ("field_of_view", 0.0), ("sigma_v", -1.0), ("sigma_omega", -1.0), ("min_range", -1.0),
        ("prior_sigma", -1.0), ("prior_sigma_heading", -1.0), ("clutter", -1.0), ("sigma_range", 0.0),
        ("sigma_bearing", 0.0), ("sigma_point", 0.0), ("detection", 1.01), ("detection", -0.01),
    ]),
    ("circle", {"sigma_speed": -0.1}, "circle: sigma_speed = -0.1; must not be negative"),
    ("circle", {"sigma_point": 0.0}, "circle: sigma_point = 0.0; a positive number"),
    ("circle", {"frames": 2.5}, "circle: frames = 2.5; a whole number"),
    ("circle", {"speed": math.nan}, "circle: speed = nan; a finite number"),
    ("circle", {"min_range": 5.0}, "circle: min_range = 5.0, max_range = 5.0; min_range < max_range"),
    ("circle", {"heading_noise": "during"}, "circle: heading_noise = 'during': unknown; known: after, before"),
    ("circle", {"ring": -20.0}, "circle: ring = -20.0; more than -9.54"),
    ("linear", {"sigma_odometry": -0.1}, "linear: sigma_odometry = -0.1; must not be negative"),
    ("linear", {"prior_sigma_heading": -0.1}, "linear: prior_sigma_heading = -0.1; must not"),
    ("linear", {"sigma_point": 0.0}, "linear: sigma_point = 0.0; a positive number"),
    ("linear", {"frames": 0}, "linear: frames = 0; at least 1"),
    *(("linear", {key: 0.0}, f"linear: {key} = 0.0; a positive")
      for key in ("period", "laps", "half_length", "half_width", "spacing", "max_range")),
    *(("park", {key: value}, f"park: {key} = {value}")
      for key, value in [("block", 19), ("detection", 1.5), ("spacing", 0.0), ("frames", 0)]),
])  # fmt: skip
def test_a_senseless_value_is_named_with_its_key(world, change, wrong):
    with pytest.raises(UsageError) as fault:
        registry.parameters_of(world)(**change)
    assert str(fault.value).startswith(wrong)
    assert "\n" not in str(fault.value)


@pytest.mark.parametrize("world", WORLDS)
def test_an_unknown_key_is_answered_with_all_known_ones(world):
    with pytest.raises(UsageError) as fault:
        registry.parse(f"{world}:0:colour=red")
    known = str(fault.value).split("known: ")[1].split(", ")
    keys = [k.removeprefix("no-").replace("-", "_").rstrip("=") for k in known]
    assert set(keys) == {f.name for f in fields(registry.parameters_of(world))} | set(registry.SIMULATORS[world].counts)


def test_the_name_of_parameters_says_them_again():
    arena = Arena(frames=40, detection=0.9, sensor="relative_point")
    assert name_of("arena", arena, 2) == "arena:2:frames=40+sensor=relative_point+detection=0.9"
    assert registry.parse(name_of("arena", arena, 2)).parameters == arena
    corridor = Corridor(odometry=False, min_angle=math.radians(-60))
    assert registry.parse(name_of("corridor", corridor, 2)).parameters == corridor


def test_frames_of_a_recording_do_not_shorten_a_log_without_images():
    with pytest.raises(UsageError, match="frames is for a recording with images"):
        registry.named_log("visual:0:frames=40")
