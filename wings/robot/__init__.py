"""A small robot on a serial line as the tutorials build it: eight sonars, wheel encoders, and a simulated one."""

from data.wing import Wing, World

WALLS = World(
    "wings.robot.world", "Walls", "walls:0 or walls:3:room=0",
    "a small robot with sonars along the walls of a room, simulated",
)  # fmt: skip

wing = Wing(
    "robot",
    commands={
        "live": ("wings.robot.live.__main__:main", "run filters and smoothers online while a small robot drives")
    },
    worlds={"walls": WALLS},
    logs=("wings.robot.log:opened",),
)
