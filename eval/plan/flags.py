"""The flags of `python -m eval.run_all` and the names they take, with an example of each in `--help`.

Imports nothing heavy, so that `--help` and a mistyped flag answer at once.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from eval.replay.names import ASSOCIATIONS, ESTIMATORS
from eval.studies.shipped import scenarios

FORMATS = ("csv", "md", "tex")
CHOICES = {
    "camera_translation": ("cm", "mm", "m"),
    "camera_reading": ("to-camera", "to-body"),
    "corner_noise": ("lab", "depth"),
}
"""Options that take one word of a few."""
DEFAULT_ESTIMATORS = ("dead-reckoning", "ekf", "isam2", "batch")
QUICK_RUNS = 2
CONFIGS = Path(__file__).parents[1] / "configs"

EPILOG = """\
examples:
  python -m eval.run_all                                    the default report, in results/report
  python -m eval.run_all --quick                            the same, shortened (a check that all works)
  python -m eval.run_all --log my_log --log arena:3         an open log folder and a simulated log
  python -m eval.run_all --log victoria-park --task slam    one log, one task
  python -m eval.run_all --log visual:0                     a rendered camera log: pictures found, corners used
  python -m eval.run_all --log my_lab_folder --camera-translation m --camera-reading to-body --trust-pickle
  python -m eval.run_all --log visual:0:frames=40 --corner-noise depth
  python -m eval.run_all --log corridor:0:people+range=8    the corridor lab: people in the way, any constant changed
  python -m eval.run_all --data ~/datasets                  every dataset found in a folder, two levels deep
  python -m eval.run_all --log my_log --estimator ekf,batch-cauchy --association known
  python -m eval.run_all --log arena:0 --task slam --estimator ekf,ekf-invariant,isam2,batch
  python -m eval.run_all --log my_log --gate-known 0.9999   leave labelled readings out that fit badly
  python -m eval.run_all --log my_log --task slam --association known,nn,jcbb    unknown labels beside known ones
  python -m eval.run_all --log corridor:0 --association jcbb --gate 0.95 --new-gate 0.999
  python -m eval.run_all --log my_log --association ml --gate none   no gate: every reading is paired
  python -m eval.run_all --log my_log --association nn --in-view     the EKF, too, offers only what may be in view
  python -m eval.run_all --log corridor:0:people --association jcbb --maintain    drop landmarks seen only once
  python -m eval.run_all --log victoria-park --estimator ekf --forget-after 60
  python -m eval.run_all --log victoria-park --estimator ekf --deactivate-after 60
  python -m eval.run_all --full                             every method with every estimator; takes minutes
  python -m eval.run_all --runs 100 --seed 1000 --jobs 2    the consistency study: 100 arenas, two processes
  python -m eval.run_all --scenario circle --runs 100       a published study: ours beside the printed numbers
  python -m eval.run_all --scenario my_world.toml --estimator ekf,ekf-fej,batch
  python -m eval.run_all --scenario all --data DIR          every shipped scenario; DIR: the recording of esde-replay
  python -m eval.run_all --scenario arena --runs 1000 --scheduler tcp://host:8786    on a Dask cluster
  python -m eval.run_all --log arena:0 --estimator isam2,fixed-lag --lag 20
  python -m eval.run_all --formats csv,tex --out results/paper --no-plots
  python -m eval.run_all --log arena:0 --animate            a film of each estimator beside the figures
  python -m eval.run_all --config my_run.toml -v            the same keys from a file; flags win; a table
                                                            [corridor] (seed, people, range, ...) is a log, too
  python -m eval.run_all --log DIR --config tutorial-step1 --config tutorial-step3   (DIR made by data.convert mrclam)
  python -m eval.run_all -q                                 print nothing but errors

exit status: 0 fine, 1 an estimator that is declared consistent was rejected, 2 wrong usage or bad data"""


def parser() -> argparse.ArgumentParser:
    """The flags. Defaults are left out here (None), so that a config file can tell what was given."""
    p = argparse.ArgumentParser(
        prog="python -m eval.run_all",
        description="Run filters and smoothers on identical inputs, score them with one referee, and write the report.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = p.add_argument
    add(
        "--log",
        action="append",
        metavar="PATH|NAME",
        help="open log folder, victoria-park, arena:SEED, circle:SEED, linear:SEED, or "
        "corridor:SEED:people+no-odometry+KEY=VALUE (repeatable; default: victoria-park, arena:0, corridor:0 in "
        "five variants, a short visual:0)",
    )
    add(
        "--data",
        action="append",
        metavar="DIR",
        help="add every dataset found in DIR: open logs, UTIAS MRCLAM folders or zips; with --scenario only where the "
        "recording of esde-replay is looked for",
    )
    add(
        "--scenario",
        action="append",
        metavar="NAME|FILE|all",
        help=f"Monte Carlo study of a world: {', '.join(scenarios())}, a TOML file, or all of those (repeatable)",
    )
    add("--task", metavar="LIST", help="localization,slam (default: localization where there is a map, else slam)")
    add("--estimator", metavar="LIST", help=f"of {', '.join(ESTIMATORS)} (default: {','.join(DEFAULT_ESTIMATORS)})")
    add(
        "--association",
        metavar="LIST",
        help=f"of {', '.join(ASSOCIATIONS)} (default: known where the log has labels, else jcbb)",
    )
    add(
        "--gate",
        metavar="P",
        help="chi-square probability of the association gate, or none (default: 0.99; known is not gated)",
    )
    add(
        "--new-gate",
        metavar="P",
        help="an observation starts a landmark only outside this gate of every other (default: 0.99999; the lab: 0.99; "
        "ml-ratio decides by itself)",
    )
    add("--gate-known", metavar="P", help="gate for readings paired by label, too (default: none)")
    add("--in-view", action="store_true", default=None, help="the EKF offers only landmarks in range and view")
    add(
        "--maintain",
        action="store_true",
        default=None,
        help="SLAM: remove landmarks seen once and more than two frames ago",
    )
    add("--forget-after", metavar="S", help="EKF-SLAM drops landmarks unseen for S seconds (frames without stamps)")
    add("--deactivate-after", metavar="S", help="EKF-SLAM parks such landmarks, and takes them back when seen again")
    add("--camera-translation", metavar="UNIT", help="of T in a lab folder's configuration: cm (default), mm, m")
    add(
        "--camera-reading",
        metavar="WAY",
        help="R, T of a lab folder: to-camera, p_c = R p_b + T (default), or to-body, the other way round",
    )
    add(
        "--corner-noise",
        metavar="KIND",
        help="of picture corners: lab, 2 cm and 5 cm (default), or depth, along the ray and growing with its square",
    )
    add(
        "--trust-pickle",
        action="store_true",
        default=None,
        help="read object arrays of a lab folder: they can run code",
    )
    add("--lag", metavar="S", help="fixed-lag keeps poses for S seconds (frames without stamps; default: 30)")
    add(
        "--runs",
        metavar="N",
        help=f"runs of the consistency study (default: 50, or what a scenario says; {QUICK_RUNS} with --quick; "
        "0: none, the default with --log)",
    )
    add("--seed", metavar="N", help="first seed of the consistency study (default: 0)")
    add("--jobs", metavar="N", help="processes (default: one per core)")
    add("--scheduler", metavar="ADDRESS", help="do the study's runs on a Dask cluster, as in tcp://host:8786")
    add(
        "--quick",
        action="store_true",
        default=None,
        help="a short report in seconds: fewer frames and pictures, PNG only, too few runs for verdicts",
    )
    add("--full", action="store_true", default=None, help="the default suite with every method; takes minutes")
    add("--out", metavar="DIR", help="result folder, replaced as a whole when done (default: results/report)")
    add("--formats", metavar="LIST", help="table formats of csv,md,tex (default: all)")
    add("--no-plots", action="store_true", default=None, help="tables only")
    add("--animate", action="store_true", default=None, help="an MP4 per log, task and estimator")
    add(
        "--config",
        action="append",
        metavar="FILE|NAME",
        help="TOML file with the same keys, or a shipped one: " + ", ".join(shipped()),
    )
    add("-q", "--quiet", action="store_true", default=None, help="print only errors")
    add("-v", "--verbose", action="store_true", default=None, help="print more")
    return p


def shipped() -> list[str]:
    """Names of the configurations that come with the package."""
    return sorted(f.stem for f in CONFIGS.glob("*.toml"))
