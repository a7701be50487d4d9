"""Laser logs: scans matched, loops closed, walls mapped; CARMEN logs and floor plans, their scores and sections."""

from data.wing import Recording, Wing, World

FLOORPLAN = World(
    "wings.laser.floorplan.world", "Floorplan", "floorplan:0 or floorplan:0:people+glass+thin=5",
    "rooms and corridors seen by a laser scanner, simulated",
)  # fmt: skip
CARMEN = Recording(
    "wings.laser.carmen:is_carmen_file", "wings.laser.carmen:open_carmen", "carmen", "a CARMEN log",
    found="wings.laser.carmen:carmen_logs",
)  # fmt: skip

wing = Wing(
    "laser", worlds={"floorplan": FLOORPLAN}, recordings=(CARMEN,), conversions=("wings.laser.convert",),
    questions=("wings.laser.questions:questions",), replays=("wings.laser.slam.comparison:laser_runs",),
    kernels={"laser": "wings.laser.warming:warm"}, outcomes=("wings.laser.score:closure_counts",),
    notices=("wings.laser.score:faults",), player=("wings.laser.report:add_loops",),
    files=("wings.laser.report:write_laser_files",),
    figures={"grid": "wings.laser.report:GRID", "loops": "wings.laser.report:LOOPS"},
    sections=("wings.laser.report:laser_sections",), templates="wings.laser",
)  # fmt: skip
