"""The runs of the net: small logs that together cover every task, sensor, estimator, association and weighty option."""

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

from tests.net.digest import CLOSE, RUNS

GIVEN = Path(__file__).parent / "given"
"""Files that some runs read, named {given} in their words."""
LOST = 1e-2
"""How close, where another order of additions in the library below moves a number: an estimate that is lost by half of
that, iSAM2 among walls, which linearizes anew beyond a threshold, by a tenth."""
LOOSE = 1e-4
"""How close, where a graph is known badly from the log and its optimizer stops at once: errors are off by 1e-5."""
ALWAYS = ("--no-plots", "--formats", "csv", "--jobs", "1", "--out", "out", "--quiet")
"""In every run: tables only, in one process."""


@dataclass(frozen=True)
class Case:
    words: str  # of the command line, in one string
    covers: str  # what it is here for
    short: bool = False  # it is in the short half, too
    before: tuple[str, ...] = ()  # commands that are to be done first
    runs: str = RUNS  # endings of the files below runs/ that something is kept of
    close: float = CLOSE  # how close summaries are to be, relative to the scale


CASES: dict[str, Case] = {
    "arena": Case(
        "--log arena:0:frames=40 --task localization,slam --estimator dead-reckoning,ekf,isam2,batch"
        " --association known,jcbb-hindsight",
        "both tasks, range and bearing, with and without labels, revised decisions",
        short=True,
    ),
    "filters": Case(
        "--log arena:2:frames=40 --task slam --estimator ekf,ekf-iterated,ekf-fej,ekf-invariant --association known,nn",
        "every filter",
        short=True,
    ),
    "smoothers": Case(
        "--log arena:2:frames=40+clutter=0.3 --task slam --lag 5 --association jcbb"
        " --estimator batch,batch-huber,batch-cauchy,gnc,isam2,fixed-lag",
        "every smoother",
    ),
    "methods": Case(
        "--log arena:3:frames=40+clutter=1+detection=0.9 --task slam --estimator ekf"
        " --association nn,ml,ml-ratio,singles,gnn,jcbb,jcbb-first,jcbb-hindsight",
        "every association method, among clutter and misses",
    ),
    "methods-in-a-map": Case(
        "--log arena:3:frames=40+clutter=1+detection=0.9 --task localization --estimator ekf"
        " --association nn,ml,ml-ratio,singles,gnn,jcbb,jcbb-first,jcbb-hindsight",
        "the same in a known map",
    ),
    "methods-of-smoothers": Case(
        "--log arena:4:frames=40+clutter=0.5 --task slam --estimator isam2,batch"
        " --association jcbb-hindsight",
        "smoothers whose readings have no labels",
    ),
    "relative-point": Case(
        "--log arena:1:frames=40+sensor=relative_point --task localization,slam"
        " --estimator ekf,ekf-invariant,batch --association known,jcbb",
        "the Cartesian sensor",
    ),
    "linear": Case(
        "--log linear:0:frames=50 --task slam --estimator ekf,ekf-iterated,isam2,batch",
        "the world that is nearly linear",
    ),
    "circle": Case(
        "--log circle:0:frames=60 --task slam --estimator ekf-fej,isam2 --association known,nn",
        "the circle, round and round",
    ),
    "park": Case(
        "--log park:0:frames=300 --task slam --estimator ekf,batch --association jcbb",
        "a large log's beginning",
    ),
    "parked": Case(
        "--log arena:0:frames=120 --task slam --estimator ekf,ekf-iterated --association known,jcbb"
        " --deactivate-after 10",
        "landmarks that are parked and taken back",
    ),
    "forgotten": Case(
        "--log arena:0:frames=120 --task slam --estimator ekf,ekf-fej --association known,jcbb --forget-after 10",
        "landmarks that are dropped",
    ),
    "in-view": Case(
        "--log arena:0:frames=40+field_of_view=2 --task localization,slam --estimator ekf,batch"
        " --association jcbb --in-view",
        "only landmarks in view are offered",
    ),
    "gates": Case(
        "--log arena:5:frames=40+clutter=0.5 --task localization,slam --estimator ekf --association nn,jcbb"
        " --gate 0.9 --new-gate 0.999",
        "other gates",
    ),
    "no-gate": Case(
        "--log arena:5:frames=40+clutter=0.5 --task localization,slam --estimator ekf --association nn,ml --gate none",
        "no gate",
    ),
    "gate-known": Case(
        "--log arena:5:frames=40 --task localization,slam --estimator ekf,isam2,batch --gate-known 0.9",
        "labels that are gated",
    ),
    "gate-known-filters": Case(
        "--log arena:5:frames=40 --task slam --estimator ekf,isam2,batch --gate-known 0.9 --no-gate-smoothers",
        "labels that are gated for filters only",
    ),
    "corridor": Case(
        "--log corridor:0:people --task slam --estimator ekf,isam2,batch --association known,jcbb-hindsight",
        "people in the way, revised decisions",
        close=LOOSE,
    ),
    "corridor-maintained": Case(
        "--log corridor:0:people --task slam --estimator ekf --association nn,singles,jcbb --maintain --gate 0.95",
        "landmarks seen once are removed",
    ),
    "corridor-blind": Case(
        "--log corridor:1:people+no-odometry --task slam --estimator ekf,isam2 --association jcbb",
        "no odometry",
        close=LOST,
    ),
    "corridor-localization": Case(
        "--log corridor:2:people --task localization --estimator ekf,isam2,batch"
        " --association nn,jcbb-hindsight",
        "hindsight in a known map, with people",
    ),
    "walls": Case(
        "--log walls:0:frames=150 --estimator ekf,ekf-fej,isam2,batch --association known,jcbb",
        "walls as landmarks",
        close=LOST,
    ),
    "laser": Case(
        "--log in --relations {given}/relations.csv --estimator dead-reckoning,ekf,isam2,batch",
        "scans matched, loops closed, an open log folder, reference relations",
        before=("convert floorplan in --seed 0 --frames 600 --thin 5 --beams 90",),
    ),
    "laser-back-ends": Case(
        "--log floorplan:1:frames=600+beams=60",
        "every back end on one pose graph with its loops, other key distances, a thinner graph",
    ),
    "laser-corners": Case(
        "--log floorplan:1:frames=600+beams=90+people --association scan,jcbb --estimator ekf,isam2"
        " --keyframe-distance 0.8",
        "corners of walls as landmarks",
        close=LOOSE,
    ),
    "visual": Case(
        "--log visual:0:frames=6+image_width=320+image_height=240",
        "pictures found in images",
    ),
    "twins": Case(
        "--log arena:1:frames=40 --estimator ekf,batch --twins 8",
        "p values against twins",
        short=True,
    ),
    "calibrated-twins": Case(
        "--log arena:1:frames=40+curvature=0.05 --estimator ekf,batch --twins 8 --calibrate",
        "systematic errors found in residuals, with twins",
    ),
    "calibrated": Case(
        "--log arena:0:frames=40+scale=-0.1+curvature=0.02 --task slam --estimator ekf,isam2,batch"
        " --calibrate curvature,scale=0.05",
        "systematic errors in the filter's state and in both graphs",
    ),
    "study": Case(
        "--scenario linear --runs 50 --estimator ekf",
        "a study with its verdicts",
        short=True,
    ),
    "study-of-smoothers": Case(
        "--scenario arena --runs 4 --estimator ekf,isam2",
        "a study of a filter and a smoother",
    ),
    "result": Case(
        "--log arena:0:frames=40 --estimator ekf,batch --result mine={given}/arena.tum --align first",
        "a result of another program beside ours",
        short=True,
    ),
    "result-alone": Case(
        "--truth {given}/truth.tum --result a={given}/other.tum --align se2",
        "a truth and a result alone",
    ),
    "lab": Case(
        "--lab corridor:1+frames=12",
        "the lab as a whole: of its many runs the decisions",
        runs="decisions.csv",
        close=LOOSE,
    ),
}  # fmt: skip


def run(case: Case, folder: Path) -> tuple[int, Path]:
    """Exit status and result folder of a case in a folder of its own, where all that the product keeps is kept, too.
    RuntimeError: the command has written nothing; with what it said.
    """
    import slamref

    said = io.StringIO()
    words = case.words.format(given=GIVEN).split()
    with contextlib.chdir(folder), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        for line in case.before:
            if slamref.main(line.split()):
                raise RuntimeError(f"{line}\n{said.getvalue()[-2000:]}")
        try:
            status = slamref.main(["run", *words, *ALWAYS])
        except SystemExit as end:
            status = 2
            said.write(f"exit: {end.code}\n")
    out = folder / "out"
    if not out.is_dir():
        raise RuntimeError(f"{case.words}: exit status {status}\n{said.getvalue()[-2000:]}")
    return status, out
