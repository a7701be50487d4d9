"""A small robot on a serial line as the tutorials build it: eight sonars, wheel encoders, and a simulated one."""

from data.wing import Wing, World

WALLS = World(
    "wings.robot.world",
    "Walls",
    "walls:0 or walls:3:room=0",
    "a small robot with sonars along the walls of a room, simulated",
    "A simulated robot with eight sonars and wheel encoders follows the walls of a room, which are the landmarks;"
    " the same seed gives the same log.",
    "example:\n  python -m data.convert walls logs/walls-0 --seed 0 --frames 2400",
)

wing = Wing(
    "robot",
    commands={
        "live": ("wings.robot.live.__main__:main", "run filters and smoothers online while a small robot drives"),
    },
    worlds={"walls": WALLS},
    logs=("wings.robot.log:opened",),
)
