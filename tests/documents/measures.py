"""What `make docs ARGS='--measure ...'` runs: a command for each result, and which of its numbers pages quote."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import slamref
from eval.referee.consistency import FIT
from tests.documents.measured import EXAMPLES, PRINTED, ROOT, STORE, stored

SHARED = ROOT.parent / "shared" / "data"
WORK = ROOT / "build" / "measured"
Values = Mapping[str, float]


def slamref_run(name: str, *words: str) -> Path:
    """The result folder of a command. Raises RuntimeError where it could not be run."""
    out = WORK / name
    if slamref.main([*words, "--out", str(out)]) > 1:
        raise RuntimeError(f"slamref {' '.join(words)} failed")
    return out


def metrics(out: Path, **chosen: str) -> pd.DataFrame:
    """Rows of metrics.csv whose columns have these values."""
    table = pd.read_csv(out / "metrics.csv")
    for column, value in chosen.items():
        table = table[table[column] == value]
    return table


def of_estimators(table: pd.DataFrame, column: str, estimators: Iterable[str], suffix: str = "") -> Values:
    """Mean of a column for each estimator in its last phase, `isam2` online."""
    found = {}
    for name in estimators:
        phase = "final" if name.startswith("batch") else "online"
        rows = table[(table.estimator == name) & (table.phase == phase)]
        found[name.replace("-", "_") + suffix] = float(rows[column].mean())
    return found


def arena() -> Values:
    study = slamref.study(
        lambda seed: slamref.open_log(f"arena:{seed}"), ["ekf", "isam2", "batch"], task="localization", runs=100
    )
    return of_study(study, {"ekf": "online", "isam2": "online", "batch": "final"})


def circle() -> Values:
    study = slamref.study(lambda seed: slamref.open_log(f"circle:{seed}"), ["ekf", "batch"], runs=100, jobs=2)
    return of_study(study, {"ekf": "online", "batch": "final"})


def of_study(study: slamref.Study, phases: Mapping[str, str]) -> Values:
    """RMS over the runs of the position error, and mean and bounds of the pose NEES."""
    found, verdicts = {}, study.verdicts[study.verdicts.quantity == "pose"]
    for name, phase in phases.items():
        runs = study.runs[(study.runs.estimator == name) & (study.runs.phase == phase)]
        nees = verdicts[(verdicts.estimator == name) & (verdicts.phase == phase)].iloc[0]
        found[name] = float(np.sqrt((runs.rmse_position_m**2).mean()))
        found |= {f"{name}_nees": nees["mean"], f"{name}_lower": nees["lower"], f"{name}_upper": nees["upper"]}
    return found


def dataset9() -> Values:
    spans = ("--exclude-truth", "755:836", "--exclude-truth", "945:1050")
    log = WORK / "d9r3"
    shutil.rmtree(log, ignore_errors=True)
    zipped = str(SHARED / "mrclam" / "MRCLAM_Dataset9.zip")
    assert slamref.main(["convert", "mrclam", zipped, str(log), "--robot", "3", *spans]) == 0
    out = slamref_run(
        "dataset9", "run", str(log), "--task", "localization,slam", "--estimator", "ekf,isam2,batch", "--no-plots"
    )
    found, names = {}, ("ekf", "isam2", "batch")
    for task in ("localization", "slam"):
        table = metrics(out, task=task)
        found |= of_estimators(table, "rmse_position_m", names, f"_{task}")
        found |= of_estimators(table, "rmse_landmark_m", names, f"_{task}_map") if task == "slam" else {}
        found |= of_estimators(table, "nees_pose", names, f"_{task}_nees")
    found["nis"] = float(metrics(out, task="localization", estimator="ekf").nis.iloc[0])
    return found


def intel() -> Values:
    """Intel Research Lab: errors over reference relations, all and the exact ones: mean, spread and heading [deg]."""
    out = slamref_run("intel", "run", str(SHARED / "intel" / "intel_raw_full.log.gz"), "--no-plots")
    table, found = pd.read_csv(out / "relations.csv").query("tie == 'row'"), {}
    for name, estimator, phase in (("odometry", "dead-reckoning", "online"), ("ekf", "ekf", "online"),
                                   ("batch", "batch", "final")):  # fmt: skip
        rows = table[(table.estimator == estimator) & (table.phase == phase)].set_index("subset")
        found |= {name: rows.trans_mean_m["all"], f"{name}_spread": rows.trans_std_m["all"]}
        found |= {f"{name}_deg": rows.rot_mean_deg["all"], f"{name}_exact": rows.trans_mean_m["exact"]}
    return found


def visual() -> Values:
    """The visual lab with the noise of its sheet, and with noise that grows with depth."""
    found = {}
    for name, words in {"lab": (), "depth": ("--corner-noise", "depth")}.items():
        table = metrics(slamref_run(f"visual-{name}", "run", "visual:0", "--no-plots", *words), log="visual:0")
        cm = of_estimators(table, "rmse_position_m", ("ekf", "batch"), f"_{name}_cm")
        found |= {key: 100.0 * value for key, value in cm.items()}
    return found


def victoria() -> Values:
    methods = ("known", "jcbb", "jcbb-hindsight")
    out = slamref_run(
        "victoria", "run", "victoria-park", "--estimator", "ekf,isam2,batch", "--association", ",".join(methods)
    )
    found = {}
    for method in methods:
        name = method.replace("-", "_")
        table = metrics(out, association=method)
        found |= of_estimators(table, "rms_from_batch_m", ("ekf", "batch"), f"_{name}")
        found[f"landmarks_{name}"] = float(table[table.estimator == "ekf"].landmarks.iloc[-1])
    return found


def corridor() -> Values:
    """Corridors without and with people, seeds 0 to 49."""
    logs = [f"corridor:{seed}{people}" for seed in range(50) for people in ("", ":people")]
    methods = ("known", "nn", "gnn", "jcbb", "jcbb-hindsight")
    words = ("--task", "slam", "--estimator", "ekf", "--association", ",".join(methods), "--no-plots", "--runs", "0")
    out = slamref_run("corridor", "run", *logs, *words)
    paired = pd.read_csv(out / "association.csv")
    found = {}
    for people in ("", "people"):
        for method in methods:
            name = f"{people}_{method.replace('-', '_')}".strip("_")
            rows = metrics(out, association=method, phase="online")
            rows = rows[rows.log.str.contains("people") == bool(people)]
            found[f"{name}_rmse"] = float(rows.rmse_position_m.median())
            found[f"{name}_landmarks"] = float(rows.landmarks.median())
            for phase in ("online", "final"):
                counts = paired[(paired.association == method) & (paired.phase == phase)]
                counts = counts[counts.log.str.contains("people") == bool(people)]
                if len(counts):
                    found[f"{name}_{phase}_fp"] = float(counts.fp.median())
                    found[f"{name}_{phase}_fp_mean"] = float(counts.fp.mean())
                    share = 100.0 * counts.fp / counts[["tp", "tn", "fp", "fn"]].sum(axis=1)
                    found[f"{name}_{phase}_percent"] = float(share.median())
                    found[f"{name}_{phase}_percent_mean"] = float(share.mean())
    return found


def sound() -> Values:
    """Arenas and corridors, 20 of each, whose noise is right: what headlines and words say of them."""
    logs = [slamref.open_log(f"{world}:{seed}") for world in ("arena", "corridor") for seed in range(500, 520)]
    found: dict[str, float] = {"filter": 0.0}
    for method in ("known", "jcbb"):
        runs: list[Any] = []
        for task in ("localization", "slam"):
            judged = []
            for log in logs:
                made = slamref.compare(log.inputs(labels=method == "known"), task, ["ekf", "batch"], method)
                judged.append(slamref.judge(slamref.Trial(log, task, tuple(made))))
            runs += [j.compared.filtered for j in judged]
            found["filter"] += sum(j.verdict.value == "filter" for j in judged)
            found[f"{method}_{task}"] = sum(bool(j.objections) for j in judged)
        wrong = [r for r in runs if r.counts.fp > 0.05 * (r.counts.fp + r.counts.tp)]
        found[f"{method}_correlated"] = sum(r.nis_verdict == "correlated" for r in runs)
        found |= {f"{method}_wrong": len(wrong), f"{method}_blind": sum(r.nis_verdict == FIT for r in wrong)}
    return found


def printed(name: str) -> None:
    folder = WORK / "printed" / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    where = {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "ROOT": str(ROOT)}
    command = ["bash", "-c", EXAMPLES[name]["command"]]
    done = subprocess.run(command, cwd=folder, env=os.environ | where, stdout=subprocess.PIPE, text=True)
    said = json.loads(PRINTED.read_text(encoding="utf-8")) | {name: done.stdout.replace(f"{folder}/", "")}
    text = json.dumps(said, indent=1, sort_keys=True, ensure_ascii=False)
    PRINTED.write_text(text + "\n", encoding="utf-8")


MEASURES: dict[str, Callable[[], Values]] = {
    measure.__name__: measure for measure in (arena, circle, dataset9, intel, visual, victoria, corridor, sound)
}


def measure(names: Iterable[str]) -> None:
    for name in names:
        if name in EXAMPLES:
            printed(name)
            continue
        values = {key: float(f"{value:.6g}") for key, value in MEASURES[name]().items()}
        found = stored() if STORE.exists() else {}
        found[name] = values
        STORE.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        sys.stdout.write(f"measured: {name}\n")
