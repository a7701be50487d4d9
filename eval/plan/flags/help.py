"""The help of `slamref run`: the flags of everyday use with an example each, and examples of all flags."""

from __future__ import annotations

import argparse
import sys
import textwrap
from typing import Any, NamedTuple

PROG = "python -m eval.run_all"
WIDTH, INDENT = 80, 22
"""Characters of a line; those before the text of a flag."""


class Everyday(NamedTuple):
    """A flag of everyday use: how it is typed, what it does, an example after the name of the command."""

    typed: str
    text: str
    example: str


def _report(words: str, folder: str) -> tuple[Everyday, Everyday]:
    """The flags of every report, with examples after these words."""
    return (
        Everyday("--out DIR", "the result folder (default: results/report)", f"{words} --out results/{folder}"),
        Everyday("--open", "show the report in the browser", f"{words} --open"),
    )


RUN = {
    "input": (
        Everyday("LOG ...", "log folders, recordings or simulated logs (default: a suite of logs)", "arena:0 my_log/"),
        Everyday("--result NAME=FILE", "a path by another program, to be scored", "my_log/ --result mine=est.tum"),
        Everyday("--truth FILE", "the true path of the log or of the results", "my_log/ --truth truth.tum"),
        Everyday("--config FILE", "read flags from a TOML file", "--config my_run.toml"),
    ),
    "estimators and association": (
        Everyday("--task LIST", "localization, slam or both", "arena:0 --task slam"),
        Everyday("--estimator LIST", "filters and smoothers, also your own", "arena:0 --estimator ekf,isam2,batch"),
        Everyday("--association LIST", "association methods, also your own", "arena:0 --association known,nn,jcbb"),
        Everyday("--twins", "diagnosis without ground truth, from 99 bootstrap replicates", "my_log/ --twins"),
        Everyday("--calibrate", "estimate systematic errors of odometry and sensor", "my_log/ --calibrate"),
    ),
    "output": (
        *_report("arena:0", "arena"),
        Everyday("--quick", "a short report: fewer frames and figures", "--quick"),
        Everyday("--no-plots", "tables without figures", "arena:0 --no-plots"),
    ),
}
LAB = {
    "lab": (
        Everyday("LAB", "corridor:SEED, visual:SEED, or a folder of recorded runs", "corridor:3"),
        Everyday("--gate P", "probability of the chi-square gate (default 0.99)", "corridor:3 --gate 0.95"),
        Everyday("--ellipses FACTOR", "enlarge the ellipses of the visual lab", "visual:0 --ellipses auto"),
    ),
    "output": (
        Everyday("--write-up", "a LaTeX text to hand in", "corridor:3 --write-up"),
        Everyday("--lab-text", "each run's steps as the lab's program prints them", "corridor:3 --lab-text"),
        *_report("corridor:3", "corridor"),
    ),
}
STUDY: dict[str, tuple[Everyday, ...]] = {
    "study": (
        Everyday("NAME|FILE ...", "shipped studies, or TOML files; all: every shipped one", "arena"),
        Everyday("--runs N", "number of simulated logs", "arena --runs 100"),
        Everyday("--seed N", "first seed", "arena --runs 100 --seed 1000"),
        Everyday("--estimator LIST", "filters and smoothers, also your own", "my_world.toml --estimator ekf,batch"),
    ),
    "execution and output": (
        Everyday("--jobs N", "processes (default: one per core)", "arena --runs 100 --jobs 2"),
        Everyday("--scheduler ADDRESS", "a Dask cluster", "arena --runs 1000 --scheduler tcp://host:8786"),
        *_report("arena", "arena"),
    ),
}
EVERYDAY: dict[str, dict[str, tuple[Everyday, ...]]] = {"log": RUN, "lab": LAB, "scenario": STUDY}
"""The flags of everyday use, in groups, by the flag whose values words without a flag are."""
GROUPS = {
    "selection": "input, estimators and association",
    "results": "results of other programs",
    "setup": "association gates, SLAM and calibration",
    "opening": "ground truth, camera and laser logs",
    "study": "Monte Carlo studies and bootstrap replicates",
    "output": "output",
    "drawing": "figures for a paper",
    "execution": "execution",
    "": "configuration",
}
"""Titles of `--help-all`, by the part of `Options` that holds the flag."""
STATUS = """\
exit status: 0 fine,
1 (studies) an estimator that should be consistent failed its test,
2 wrong usage, bad data or too little memory"""


ABOUT = {
    "log": "Run filters and smoothers on identical inputs, score them with one referee,\nand write a report.",
    "lab": "Do a whole lab and answer its questions at the top of the report.",
    "scenario": "Simulate a world many times and judge the consistency of each estimator.",
}


def everyday(prog: str, positional: str) -> str:
    """The help of everyday use."""
    groups = EVERYDAY[positional]
    lines = [f"usage: {prog} [{next(iter(groups.values()))[0].typed}] [flags]", "", ABOUT[positional]]
    for title, flags in groups.items():
        lines += ["", f"{title}:"]
        for flag in flags:
            text = textwrap.wrap(flag.text, WIDTH - INDENT)
            lines += [f"  {flag.typed:<{INDENT - 2}}{text[0]}", *(" " * INDENT + line for line in text[1:])]
            lines.append(f"{'':{INDENT}}  {prog} {flag.example}")
    return "\n".join([*lines, "", f"{prog} --help-all shows every flag.", STATUS, ""])


def show_everyday(positional: str) -> type[argparse.Action]:
    """The action of `--help`: print the help of everyday use and end the process."""

    class Show(argparse.Action):
        def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
            sys.stdout.write(everyday(parser.prog, positional))
            parser.exit(0)

    return Show


EXAMPLES = f"""\
examples:
  {PROG}                                    the default report, in results/report
  {PROG} --quick                            the same, shortened
  {PROG} my_log arena:3 --open              an open log folder and a simulated log
  {PROG} --log victoria-park --task slam    one log, one task
  {PROG} intel.log.gz --keyframe-distance 0.8    a laser log (CARMEN): scans matched, loops closed
  {PROG} intel.log.gz --least-information 0.2    without the key poses of least information
  {PROG} intel.log.gz --no-odometry             scans alone tell the motion
  {PROG} intel.log.gz --relations intel.relations.csv    a laser log, scored by reference relations
  {PROG} my_log --exclude-truth 12:15.5 --keep-truth    ground truth left out there, and nowhere else
  {PROG} visual:0                           a rendered camera log
  {PROG} my_lab_folder --camera-translation m --camera-reading to-body --trust-pickle
  {PROG} visual:0:frames=40 --corner-noise depth
  {PROG} corridor:0:people+range=8          the corridor with people; any constant can be changed
  {PROG} --lab corridor:3                   the corridor lab: its six questions answered
  {PROG} --lab corridor:3+srho=0.05 --write-up     with another sensor, and a text to hand in
  {PROG} --lab corridor:3 --lab-text        each run's steps as the lab's program prints them
  {PROG} --lab visual:0 --ellipses auto     the visual lab, ellipses enlarged until they are visible
  {PROG} --data ~/datasets                  every dataset found in a folder, two levels deep
  {PROG} my_log --estimator ekf,batch-cauchy --association known
  {PROG} arena:0 --estimator ekf,mine=./mine.py:Filter --association known,./mine.py:nearest
  {PROG} my_log --twins                     diagnosis without ground truth
  {PROG} my_log --calibrate                 estimate systematic errors beside path and map
  {PROG} arena:0:curvature=0.02 --calibrate curvature,scale=0.05
  {PROG} my_log --gate-known 0.9999 --no-gate-smoothers    only filters leave out labels that fit badly
  {PROG} my_log --gate-poses none           use every fix and every closure
  {PROG} corridor:0 --association jcbb --gate 0.95 --new-gate 0.999
  {PROG} my_log --association nn --in-view  the EKF offers only landmarks in range and view
  {PROG} my_log --no-appearance              ignore descriptors and classes of landmarks
  {PROG} corridor:0:people --association jcbb --maintain    remove landmarks observed only once
  {PROG} victoria-park --estimator ekf --forget-after 60
  {PROG} victoria-park --estimator ekf --deactivate-after 60
  {PROG} --full                             every method with every estimator; takes minutes
  {PROG} --runs 100 --seed 1000 --jobs 2    a consistency study: 100 arenas, two processes
  {PROG} --scenario circle --runs 100       a published study: ours beside the printed numbers
  {PROG} --scenario arena --runs 1000 --scheduler tcp://host:8786    on a Dask cluster
  {PROG} arena:0 --estimator isam2,fixed-lag --lag 20
  {PROG} --formats csv,tex --out results/paper --no-plots
  {PROG} my_log --result mine=est.tum --cov est.cov      another program's result beside ours
  {PROG} my_log --result a=a.tum --result b=bag:/odom --align se2 --cov-frame b=world
  {PROG} --truth gt.tum --truth-gap 0.2 --result a=a.csv     results alone, against a truth
  {PROG} --truth gt.tum --result a=a.csv --time-offset auto    of another clock
  {PROG} --truth gt.txt --result a=kitti.txt --times times.txt --axes truth=robot    KITTI poses, a truth with z up
  {PROG} --truth gt.csv --result a=vio.txt --align yaw --pairs openvins    in 3-D, as OpenVINS pairs poses
  {PROG} --truth gt.csv --result a=a.tum --cov-order rotation-first --unit truth=deg    what files do not state
  {PROG} arena:0 --table-width column --columns rmse_position_m,nees_pose,nis
  {PROG} arena:0 --figure-width 3.4in --font Times --font-size 8    figures for a column
  {PROG} arena:0 --figures map,error --show ekf,batch --no-titles    for a paper, with their data
  {PROG} arena:0 --figure-width 86mm --usetex --pgf      text set by LaTeX
  {PROG} victoria-park --estimator ekf --animate --speed 20    a film at 20 times real time
  {PROG} --config my_run.toml -v            the same keys from a file; flags win
  {PROG} -q                                 print nothing but errors

{STATUS}"""
