"""What is fuzzed and how: valid inputs of every reader, what a right load keeps, and what broken ones may cost."""

import argparse
import gzip
import math
import re
import shutil
import signal
import tempfile
import tracemalloc
from collections import Counter
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data.convert.kinds import convert
from data.errors import SlamrefError
from data.formats.g2o import log_of, read_graph
from data.formats.mrclam import load_mrclam
from data.formats.open_log import FILES
from data.formats.results.reading import read_path
from data.formats.results.tables import companions
from data.logs import open_log
from eval.plan.flags.options import read_options
from eval.studies.scenario import load_scenario
from eval.studies.shipped import path_of
from tests.data.conftest import small_files
from tests.data.formats.mrclam import world
from tests.data.formats.open_log.measured import measured_files
from tests.data.formats.open_log.same_log import assert_sound
from tests.data.formats.open_log.test_appearance import files_of as files_of_appearance
from tests.data.formats.open_log.test_scans import GOOD
from tests.data.formats.open_log.test_sensors import files_of as files_of_sensors
from tests.faults.mutations import BYTES, MAT, NPY, TABLE, TOML, Fault, Files, mutated, zipped
from tests.wings.camera.lab.handmade import lab
from tests.wings.laser.formats.carmen_text import SMALL
from tests.wings.robot.line import linked
from wings.camera.lab.folder import open_lab
from wings.robot.packets import command_of
from wings.robot.simulated import Lidar
from wings.robot.traffic import Recording

CONFIG = """
log = ["arena:0"]
task = "slam"
estimator = ["ekf", "batch"]
gate = 0.95
forget-after = 30
maintain = true
"""


def faults_of(name: str) -> list[Fault]:
    """What may be wrong in a file, by its name."""
    ending = name.rpartition(".")[2]
    if ending == "toml":
        return TOML
    if ending == "npy":
        return NPY
    if ending == "npz":
        return [zipped(lambda _: NPY), *BYTES]
    if ending == "zip":
        return [zipped(lambda _: TABLE), *BYTES]
    return MAT if ending == "mat" else BYTES if ending in ("gz", "bin", "png") else TABLE


class Reader(NamedTuple):
    inputs: Callable[[], list[Files]]  # valid inputs, each a folder's files by their names; made once
    read: Callable[[Path], Any]  # reads a folder
    check: Callable[[Any], None]  # raises AssertionError if what was read is not sound
    faults: Callable[[str], list[Fault]] = faults_of  # what may be wrong in a file, by its name
    # raises AssertionError if a refusal does not say where
    place: Callable[[Path, str], None] = lambda folder, said: None


def encoded(files: dict[str, str]) -> Files:
    return {name: text.encode() for name, text in files.items()}


def files_of(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def made(make: Callable[[Path], object]) -> Files:
    with tempfile.TemporaryDirectory() as folder:
        make(Path(folder))
        return files_of(Path(folder))


def open_logs() -> list[Files]:
    kinds = [(source, sensor) for source in ("frames", "odometry") for sensor in ("range_bearing", "relative_point")]
    line = small_files("frames", "range_bearing")
    line["log.toml"] = line["log.toml"].replace("range_bearing", "line")
    measured = [encoded(measured_files(source)) for source in ("frames", "odometry")]
    several = [encoded(files_of_sensors(source)) for source in ("frames", "odometry")]
    looks = encoded(files_of_appearance())
    return [*(encoded(small_files(*kind)) for kind in kinds), encoded(line), dict(GOOD), *measured, *several, looks]


def named(folder: Path, said: str) -> None:
    """One file of a log folder is named, and the line of a fault in a table."""
    (name,) = [n for n in FILES if said.startswith(f"{folder / n}:")] or ["log.toml"] * (": a folder of" in said)
    if name.endswith(".csv") and (folder / name).exists() and "sigma in [sensor]" not in said:
        assert re.match(rf"{re.escape(str(folder / name))}:\d+", said), said


def datasets() -> list[Files]:
    return [encoded(world.texts()), made(lambda path: world.save_zip(path / "set.zip", world.texts()))]


def read_dataset(folder: Path) -> Any:
    archive = folder / "set.zip"
    return load_mrclam(archive if archive.exists() else folder, 1)


def lab_folders(form: str) -> Callable[[], list[Files]]:
    return lambda: [made(lambda path: lab(path / "lab", form=form))]


def read_lab(folder: Path) -> Any:
    recording = open_lab(folder / "lab")
    return recording, list(recording.frames())


def sound_frames(found: Any) -> None:
    recording, frames = found
    assert len(frames) == len(recording)
    times = [f.time for f in frames]
    assert np.isfinite(times).all()
    assert (np.diff(times) > 0).all()
    for f in frames:
        assert np.isfinite([f.v, f.omega]).all()
        assert f.rgb.dtype == np.uint8
        assert f.rgb.shape[:2] == f.xyz.shape[:2]
    assert np.isfinite(recording.setup.corners).all()


def carmen() -> list[Files]:
    text = SMALL.encode()
    return [{"small.log": text}, {"small.log.gz": gzip.compress(text, mtime=0)}]


def read_carmen(folder: Path) -> Any:
    return open_log(str(next(p for p in sorted(folder.iterdir()))))


TUM = "# t x y z qx qy qz qw\n" + "".join(f"{k / 10} {k} {-k} 0 0 0 {np.sin(k)} {np.cos(k)}\n" for k in range(9))
UPPER = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
PLANE = "t,x,y,theta,c_xx,c_xy,c_xt,c_yy,c_yt,c_tt\n" + "".join(f"{k},{k},0,0.1,1,0,0,1,0,1\n" for k in range(9))
LANDMARKS = "landmark,x,y,c_xx,c_xy,c_yy,first_frame,times_seen\n0,1,2,1,0,1,0,3\n1,4,2,1,0.1,1,1,2\n"
DECISIONS = "frame,observation,decision,final\n0,0,-1,-1\n1,0,0,0\n1,1,-1,-1\n2,0,-2,0\n"


def results() -> list[Files]:
    return [
        encoded({"path.tum": TUM}),
        encoded({"path.tum": "".join(f"{k} {k} 0 0 0 0 0 1 {UPPER}\n" for k in range(5))}),
        encoded({"path.tum": "".join(f"{k} {k} 0 0 0 0 0 1 1 0 0 1 0 1 1 0 0 1 0 1\n" for k in range(5))}),
        encoded({"path.tum": "time_ms,x [m],y [m],yaw_deg\n" + "".join(f"{50 * k},{k},0,9\n" for k in range(9))}),
        encoded({"online.csv": PLANE, "landmarks.csv": LANDMARKS, "decisions.csv": DECISIONS}),
    ]


def read_result(folder: Path) -> Any:
    name = next((n for n in ("path.tum", "online.csv") if (folder / n).exists()), "online.csv")
    return read_path(str(folder / name)), companions(folder)


def sound_path(found: Any) -> None:
    path = found[0]
    assert len(path.pose) >= 1
    assert not np.isinf(path.pose).any()
    assert path.covariance is None or not np.isinf(path.covariance).any()
    if path.time is not None:
        assert (np.diff(path.time) > 0).all()


def scenarios() -> list[Files]:
    return [{"scenario.toml": path_of(name).read_bytes()} for name in ("arena", "circle", "corridor", "visual")]


def recordings() -> list[Files]:
    def drive(path: Path, framed: bool, lidar: Lidar | None) -> None:
        sigma = None if lidar is None else lidar.sigma
        with Recording(path / "log", framed=framed, lidar_sigma=sigma) as recording:
            link, _, clock = linked(framed=framed, recording=recording, lidar=lidar)
            while clock.now() < 4.0:
                link.step(command_of(0.2, 0.3))

    kinds = ((False, None), (True, None), (True, Lidar(beams=90)))
    return [made(lambda path, kind=kind: drive(path, *kind)) for kind in kinds]


G2O = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nVERTEX_XY 2 2 1\nEDGE_SE2 0 1 1 0 0.1 10 0 0 10 0 90\n" + (
    "EDGE_SE2_XY 0 2 2 1 5 0 5\nEDGE_SE2_XY 1 2 1 1 5 0 5\n"
)


LOOP = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(4)) + (
    "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 9 0 0 9 0 9\n" for k in range(3))
    + "EDGE_SE2 3 0 -3 0 0.1 9 1 0.5 8 0.2 7\nEDGE_SE2 0 2 2 0 0 5 0 0 5 0 5\nFIX 0\n"
)
ROBOT = "t,v,omega,range,bearing\n" + "".join(f"{k},1,0.1,{2 + k % 3},0.{k}\n" for k in range(9))
MAPPING = 'odometry = "robot.csv"\nodometry_sigma = "0.1,2deg"\nobservation_sigma = [0.1, 0.1]\nmap = "map.csv"\n'
MAPPING += (
    'truth = "truth.csv"\nprior = "truth"\nprior_sigma = "1cm,1cm,1deg"\n[columns]\nt = "t"\n[unit]\nangle = "rad"\n'
)
TABLES = {
    "robot.toml": MAPPING,
    "robot.csv": ROBOT,
    "map.csv": "id;x;y\n1;2,5;3\n7;4,5;-1\n",
    "truth.csv": "# t x y theta\n" + "".join(f"{k} {k} 0 0\n" for k in range(9)),
}


POSED = "t,x,y,theta\n" + "".join(f"{k},{k},0,0.1\n" for k in range(9))
MEASURED = {
    "robot.toml": 'odometry = "robot.csv"\nfixes = "fixes.csv"\nclosures = "loops.csv"\nodometry_sigma = [1, 1, 1, 1]\n'
    'fix_sigma = "0.5,0.5,5deg"\nclosure_sigma = "0.1,0.1,1deg"\nfix_lever = [0.1, 0.2]\nprior = "0,0,0"\n'
    "prior_sigma = [1, 1, 1]\n",
    "robot.csv": POSED,
    "fixes.csv": "t;x;y;theta;sx;source\n1;1,5;2;;;\n2,5;;;0,5;;compass\n4;4;0;0,1;0,25;\n",
    "loops.csv": "t1,t2,dx,dy,dtheta,sx,sy,stheta\n8,0.5,-7.5,0,0,,,\n1,3,2,0,0.1,0.1,0.2,0.01\n",
}


SEVERAL = {
    "robot.toml": 'odometry = "robot.csv"\nsecond_odometry = "camera.csv"\nsecond_odometry_sigma = "0.1,1deg"\n'
    'odometry_sigma = [1, 1, 1, 1]\nmap = "map.csv"\nprior = "0,0,0"\n'
    'prior_sigma = [1, 1, 1]\nmax_range = 30\nview = "-90deg,90deg"\n[columns]\n"radio.range" = "dist"\n'
    '[sensor.lidar]\nfile = "cones.csv"\nobservation_sigma = [0.1, 0.1]\nsees = "cone"\nsensor_pose = "0.1,0,5deg"\n'
    '[sensor.radio]\nfile = "radio.csv"\nobservation_sigma = 0.3\nsees = "beacon"\nmax_range = "50m"\n',
    "robot.csv": POSED,
    "map.csv": "id,x,y,kind\n1,2,3,cone\n4,5,6,beacon\n",
    "camera.csv": "t,v,omega\n" + "".join(f"{k / 2},1,0.{k}\n" for k in range(9)),
    "cones.csv": "t,range,bearing,label\n0.5,2,0.1,1\n2,3,0.2,\n2,4,-0.1,1\n",
    "radio.csv": "t;dist;label\n2,0;4,5;4\n3;4,4;\n",
}


def read_tables(folder: Path) -> Any:
    return convert(argparse.Namespace(kind="table", source=folder / "robot.toml", out=folder / "out")).log


def read_config(folder: Path) -> Any:
    return read_options(["--config", str(folder / "config.toml")])


def nothing(found: Any) -> None:
    """What was read is checked where it is used."""


READERS = {
    "open log": Reader(open_logs, lambda folder: open_log(str(folder)), assert_sound, place=named),
    "MRCLAM": Reader(datasets, read_dataset, assert_sound),
    "MAT": Reader(lambda: [*lab_folders("log.mat")(), *lab_folders("plain.mat")()], read_lab, sound_frames),
    "npy": Reader(lab_folders("log.npy"), read_lab, sound_frames),
    "npz": Reader(lab_folders("log.npz"), read_lab, sound_frames),
    "CARMEN": Reader(carmen, read_carmen, assert_sound),
    "results": Reader(results, read_result, sound_path),
    "TOML of a scenario": Reader(scenarios, lambda folder: load_scenario(str(folder / "scenario.toml")), nothing),
    "recording of a robot": Reader(recordings, lambda folder: open_log(str(folder / "log")), assert_sound),
    "tables of another program": Reader(lambda: [encoded(TABLES), encoded(MEASURED), encoded(SEVERAL)], read_tables,
                                        assert_sound),
    "TOML of a run": Reader(lambda: [{"config.toml": CONFIG.encode()}], read_config, nothing),
    "g2o": Reader(lambda: [{"graph.g2o": text.encode()} for text in (G2O, LOOP)],
                  lambda folder: log_of("graph", read_graph(folder / "graph.g2o")), assert_sound),
}  # fmt: skip


LONGEST = 20
"""s that one read may take; the valid inputs take milliseconds."""
SPARE = 2 << 20
"""Bytes that a read may take however little it reads: messages, tables of names, a library's buffers."""


class LateError(BaseException):
    """Of a read that does not end; what a reader makes of the errors it knows, it makes nothing of this one."""


@contextmanager
def no_longer_than(seconds: int):
    """Raises LateError in a read that does not end."""

    def late(*_: object) -> None:
        raise LateError(f"reads for more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def save(files: Files, folder: Path) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def peak_of(reader: Reader, files: Files) -> tuple[int, str]:
    """Bytes at most in use while it was read, and what became of it."""
    folder = Path(tempfile.mkdtemp())
    try:
        save(files, folder)
        tracemalloc.start()
        with no_longer_than(LONGEST):
            try:
                found = reader.read(folder)
            except SlamrefError as error:
                said = str(error)
                assert "\n" not in said, said
                assert len(said) < 1000, f"{len(said)} characters: {said[:200]}"
                reader.place(folder, said)
                outcome = "refused"
            else:
                reader.check(found)
                outcome = "read"
        return tracemalloc.get_traced_memory()[1], outcome
    finally:
        tracemalloc.stop()
        shutil.rmtree(folder)


def size_of(files: Files) -> int:
    return sum(map(len, files.values()))


def try_faults(name: str, reader: Reader, count: int) -> Counter[str]:
    """How often broken inputs were refused and read; AssertionError at the first that ends otherwise."""
    inputs = reader.inputs()
    peak_of(reader, dict.fromkeys(inputs[0], b""))  # what a library loads when it first fails is not the input's
    valid = []
    for files in inputs:
        assert peak_of(reader, files)[1] == "read"
        valid.append(peak_of(reader, files)[0])
    outcomes: Counter[str] = Counter()
    for k in range(count):
        rng = np.random.default_rng([k, 7])
        which = int(rng.integers(len(inputs)))
        broken = mutated(inputs[which], reader.faults, rng)
        try:
            peak, outcome = peak_of(reader, broken)
        except BaseException as error:
            kept = Path(tempfile.gettempdir()) / f"fault-{name.replace(' ', '-')}-{k}"
            save(broken, kept)
            raise AssertionError(f"mutation {k} of {name}: {type(error).__name__}: {error}; kept in {kept}") from error
        outcomes[outcome] += 1
        allowed = 2 * math.ceil(valid[which] * max(size_of(broken) / size_of(inputs[which]), 1.0)) + SPARE
        if peak >= allowed:  # once in a while the interpreter rebuilds its table of interned strings, of 4 MB
            peak = peak_of(reader, broken)[0]
        assert peak < allowed, f"mutation {k} of {name}: {peak} bytes in use, {allowed} allowed"
    assert outcomes["refused"] > count / 20
    return outcomes
