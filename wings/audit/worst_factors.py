"""The report's section on the graph that `batch` ends with: its kinds of factors and its ten worst, by the audit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from data.inputs import Inputs, IntArray
from data.result import Run
from data.se2 import Array, covariances_in_body
from data.sensors import RANGE_BEARING, RELATIVE_POINT
from data.worlds.registry import named_log
from eval.compare import compare
from eval.plan.flags.table import Output
from eval.referee.score import Trial
from eval.report.page.blocks import Block, FinePrint, Section
from eval.report.page.files import stem, written_table
from eval.report.page.tables import number
from eval.report.words import say
from graph.batch import NONE_REJECTED, Rejected, build
from graph.problem import Start
from graph.qr.elimination import Rows
from graph.qr.rows import Linearizer
from wings.audit.audit import Statistics, statistics
from wings.audit.examined import TEN, scales, shown, tables
from wings.audit.factors import FAMILY
from wings.audit.kinds import LOOP, ODOMETRY, PRIOR, Kinds
from wings.audit.linear import Group, System
from wings.laser.scans.constraints import LaserRun
from wings.laser.slam.backends import key_inputs

HEADING = "Factors of the smoother"
FINE = FinePrint(
    HEADING,
    "T: chi-square of the residual predicted from all other factors. p, family: over all factors and kinds (Holm)."
    " Smallest error: found with 80 % power at 0.1 %. Motion: of the worst pose without the factor."
    " Component: factor of the stated variance that the residuals ask for. Definitions: docs/audit.md.",
)


FIXES = "fixes"
SEED = 0  # of the probes of variance components
DIAGONAL = 1e-9  # correlation below which a noise is diagonal


@dataclass(frozen=True, eq=False)
class Replayed:
    """Statistics of the graph of a batch smoother.

    Attributes:
        statistics: of its factors.
        frame: (F,) frame into which an increment leads, or of an observation; of key poses their number; -1: neither.
        observation: (F,) row of the observation, loop closure or fix; -1: another factor.
    """

    statistics: Statistics
    frame: IntArray
    observation: IntArray


def of_landmarks(
    inputs: Inputs,
    decisions: IntArray,
    initialized: IntArray,
    end: Start,
    rejected: Rejected = NONE_REJECTED,
    *,
    scans: bool = False,
) -> Replayed:
    """The graph of `graph.batch.smooth` at its end; arguments as there. `scans`: motion is of scan matching."""
    problem = build(inputs, decisions, initialized, rejected=rejected)
    problem = replace(problem, pose_factors=[p for p in problem.pose_factors if p.used])
    values = problem.values(end)
    linearizer = Linearizer(problem)
    rows, errors = linearizer(values), linearizer.constants(values)
    n, m, blocks = linearizer.frames, len(problem.observations), len(rows.variable)
    loops = sum(p.closure for p in problem.pose_factors)
    fixes = len(problem.pose_factors) - loops
    used = np.flatnonzero(np.where(initialized >= 0, initialized, decisions) >= 0)
    frame, observation = np.full(blocks + (len(errors) > 0), -1), np.full(blocks + (len(errors) > 0), -1)
    frame[1:n], frame[n : n + m] = np.arange(1, n), inputs.observations.frame[used]
    observation[n : n + m] = used
    for row, p in enumerate(problem.pose_factors, n + m):
        frame[row], observation[row] = max(p.frames), p.row
    motion, others = "scan matching" if scans else ODOMETRY, ("landmarks of the map", "drift", "systematic errors")
    names = [PRIOR, motion, "observations", FIXES, LOOP, *others]
    places = len(problem.priors)
    drifts = blocks - n - m - fixes - loops - places
    of = np.repeat(np.arange(8), [1, n - 1, m, fixes, loops, places, drifts, int(len(errors) > 0)])
    axes = [(), () if scans else _axes_of_odometry(inputs), _axes_of_observations(inputs, used), (), (), (), (), ()]
    some = np.unique(of)
    known = Kinds(
        np.searchsorted(some, of), tuple(names[k] for k in some), tuple(axes[k] for k in some),
        np.array(names)[of] == LOOP,
    )  # fmt: skip
    keys = [tuple(v for v in row if v >= 0) for row in rows.variable.tolist()] + [()] * (len(errors) > 0)
    # the first pose is that of the prior, in its sigmas; poses and points of the others in m
    none = np.zeros(0, np.int64)
    metres = [none, *(np.arange(2) if d > 1 else none for d in rows.dim[1:].tolist()), *[none] * (len(errors) > 0)]
    random = np.random.default_rng(SEED)
    return Replayed(statistics(system_of(rows, errors), keys, known, metres, random, brief=True), frame, observation)


def system_of(rows: Rows, errors: Array) -> System:
    """The rows as a system, a factor each block; `errors` (q,), constant ones in sigmas, are its last variable."""
    q, size = len(errors), len(rows.dim)
    dim = rows.dim if q == 0 else np.append(rows.dim, q)
    width = np.where(rows.variable >= 0, dim[rows.variable], 0)
    shape, groups = np.column_stack([rows.height, width]), []
    for each in np.unique(shape, axis=0):
        at, d = np.flatnonzero((shape == each).all(1)), int(each[0])
        there = [j for j in range(rows.variable.shape[1]) if each[1 + j]]
        A = [rows.A[at, :d, 3 * j : 3 * j + int(each[1 + j])] for j in there]
        variables = rows.variable[at][:, there]
        if q:
            A.append(rows.b[at, :d, 1:])
            variables = np.column_stack([variables, np.full(len(at), size)])
        groups.append(Group(at, variables, np.concatenate(A, axis=2), -rows.b[at, :d, 0], np.ones(len(at))))
    count = len(rows.variable)
    if q:
        groups.append(Group(np.array([count]), np.array([[size]]), np.eye(q)[None], errors[None], np.ones(1)))
    return System(range(len(dim)), dim, groups, count + (q > 0))


def _axes_of_odometry(inputs: Inputs) -> tuple[str, ...]:
    if inputs.systematic is not None:
        return ()
    C = covariances_in_body(inputs.increments.mean[1:, 2], inputs.increments.covariance[1:])
    return ("x", "y", "theta") if _diagonal(C) else ()


def _axes_of_observations(inputs: Inputs, used: IntArray) -> tuple[str, ...]:
    """Names of the residuals of all observations in use, if their noise is diagonal in them."""
    sensor, o = inputs.sensor, inputs.observations
    if sensor.translation != (0.0, 0.0) or not _diagonal(o.R[used]):
        return ()
    if sensor.kind == RELATIVE_POINT:
        return ("x", "y") if sensor.rotation == 0.0 else ()
    return ("bearing", "range") if sensor.kind == RANGE_BEARING else ()


def _diagonal(C: Array) -> bool:
    """Whether covariances (n, d, d) are."""
    sigma = np.sqrt(np.einsum("nii->ni", C))
    scale = sigma[:, :, None] * sigma[:, None, :]
    return bool((np.abs(C * (1.0 - np.eye(C.shape[1]))) <= DIAGONAL * scale).all())


def end_of(run: Run) -> Start:
    """The estimate that a batch smoother ends with."""
    assert run.final is not None
    errors = None if run.errors_final is None else run.errors_final.mean
    if run.task == "localization" and run.map is not None:
        return Start(run.final.pose, run.map.xy, errors)
    places = np.full((int(run.initialized.max(initial=-1)) + 1, 2), np.nan)
    if run.map is not None:
        held = run.map.number < len(places)
        places[run.map.number[held]] = run.map.xy[held]
    return Start(run.final.pose, places, errors)


def graph_at_end(trial: Trial, run: Run) -> Replayed:
    """The graph that a batch smoother ends with."""
    inputs = trial.log.recorded if run.task == "localization" else trial.log.recorded.without_map()
    if inputs.map is not None and run.map is None:  # taken as exact
        inputs = replace(inputs, map=inputs.map.exact)
    with threadpool_limits(1):
        if not isinstance(run, LaserRun):
            out = (None if of is None else ~of.used for of in (run.fixes_final, run.closures_final))
            return of_landmarks(inputs, run.final_decisions, run.initialized, end_of(run), Rejected(*out))
        chain, loops, pose = run.chain, run.loops, run.key_pose
        assert chain is not None
        assert loops is not None
        assert pose is not None
        given = key_inputs(inputs, chain, loops)
        none = np.empty(0, np.int64)
        found = of_landmarks(given.inputs, none, none, Start(pose, np.zeros((0, 2))), scans=True)
        rows = np.append(given.believed, -1)[found.observation]
        return replace(found, observation=rows)


def runs_of(trial: Trial) -> list[Run]:
    """The batch smoothers of a trial that reached their end, one an association.

    None where increments are singular: a published smoother was given a floor under them that the filters were not.
    """
    motion = trial.log.recorded.increments.covariance[1:]
    if len(motion) and np.linalg.eigvalsh(motion).min() <= 0.0:
        return []
    runs = [r for r in trial.runs if r.estimator == "batch" and not r.handed_in and r.flaw is None]
    return [r for r in runs if r.final is not None and (not isinstance(r, LaserRun) or r.key_pose is not None)]


def kinds_frame(graph: Replayed) -> pd.DataFrame:
    """A row for each kind of factor, and for each axis where the noise is diagonal."""
    _, kinds, components = tables(graph.statistics)
    rows = []
    for name, k in kinds.iterrows():
        rows.append({"kind": name, "factors": int(k["n"]), "unchecked": int(k["unchecked"])} | _component(k))
        rows += [{"kind": f"{name}, {c['axis']}", "factors": None, "unchecked": None} | _component(c)
                 for _, c in components[components["kind"] == name].iterrows()]  # fmt: skip
    return pd.DataFrame(rows, dtype=object)


def _component(row: pd.Series[Any]) -> dict[str, object]:
    known = np.isfinite(row["component"])
    return {
        "redundancy": number(row["redundancy"]),
        "variance component": f"{number(row['component'])} ± {number(row['se'], 2)}" if known else None,
        "sigma times": number(row["sigma_factor"]) if known else None,
        "p, family": number(row["p_family"], 2) if np.isfinite(row["p_family"]) else None,
    }


def worst_frame(trial: Trial, run: Run, graph: Replayed) -> pd.DataFrame:
    """The ten factors of least p value."""
    t = graph.statistics.factors
    order = np.argsort(t.log_p, kind="stable")
    worst, rows = order[np.isfinite(t.log_p[order])][:TEN], []
    of = shown(tables(graph.statistics)[0].iloc[worst])
    for place, i in enumerate(worst.tolist()):
        what, frames = _named(trial, run, graph, i)
        rows.append({
            "factor": what, "frames": frames, "T": number(t.deleted[i]), "dof": int(t.rank[i]),
            "p": of["p"].iat[place], "p, family": of["p_family"].iat[place],
            "smallest error [σ]": number(t.minimal_error[i]), "motion [m]": number(t.moved[i], 2),
        })  # fmt: skip
    return pd.DataFrame(rows, dtype=object)


def _named(trial: Trial, run: Run, graph: Replayed, i: int) -> tuple[str, str]:
    """A factor as a person knows it, and its frames."""
    s, frame, row = graph.statistics, int(graph.frame[i]), int(graph.observation[i])
    kind = s.kinds.names[s.kinds.of[i]]
    if isinstance(run, LaserRun):
        assert run.chain is not None
        assert run.loops is not None
        if kind == LOOP:
            ends = run.loops.key1[row], run.loops.key2[row]
            return f"{kind}, key poses {ends[0]} and {ends[1]}", ", ".join(str(run.chain.frame[k]) for k in ends)
        return kind, ", ".join(str(run.chain.frame[k]) for k in (frame - 1, frame) if k >= 0)
    if kind == LOOP and (c := trial.log.recorded.closures) is not None:
        return f"{kind} of {c.sources[c.source[row]]}", f"{c.frame1[row]}, {c.frame2[row]}"
    if kind == FIXES and (f := trial.log.recorded.fixes) is not None:
        return f"fix of {f.sources[f.source[row]].name}", str(frame)
    if row >= 0:
        first = int(np.searchsorted(trial.log.recorded.observations.frame, frame))
        number_ = run.initialized[row] if run.initialized[row] >= 0 else run.final_decisions[row]
        return f"observation {row - first} of landmark {number_}", str(frame)
    return kind, "" if frame < 0 else f"{frame - 1}, {frame}"


def graph_facts(run: Run, graph: Replayed, worst: pd.DataFrame) -> dict[str, Any]:
    """The facts of a graph; `scaled`: kinds whose stated noise is rejected, with the factors of their sigmas."""
    factors, kinds, components = tables(graph.statistics)
    scaled = scales(kinds[kinds["p_family"] < FAMILY], components[components["p_family"] < FAMILY])
    return {
        "association": run.association,
        "factors": len(factors),
        "rejected": int((factors["p_family"] < FAMILY).sum()),
        "unchecked": int(factors["unchecked"].sum()),
        "scaled": tuple((s.name, float(s.sigma)) for s in scaled),
        "worst": "" if worst.empty else str(worst["factor"].iloc[0]),
        "frames": "" if worst.empty else str(worst["frames"].iloc[0]),
    }


def worst_factors_section(folder: Path, output: Output, trial: Trial) -> list[Section]:
    """Words and both tables for each batch smoother of a log and task; none where there is none."""
    runs, facts, blocks = runs_of(trial), list[dict[str, Any]](), list[Block]()
    for run in runs:
        graph = graph_at_end(trial, run)
        worst = worst_frame(trial, run, graph)
        made = graph_facts(run, graph, worst)
        facts.append(made)
        blocks.append(say("audit#of_log", a=made, several=len(runs) > 1))
        suffix = f"-{run.association}" if len(runs) > 1 else ""
        for what, frame in (("kinds", kinds_frame(graph)), ("worst", worst)):
            if len(frame):
                caption = say(f"audit#log_{what}", where=f"{trial.log.name}, {trial.task}")
                blocks.append(written_table(frame, folder, stem(trial, what + suffix), caption, output, fine=FINE))
    heading = f"{HEADING}: {trial.log.name}, {trial.task}"
    return [Section(heading, tuple(blocks), 3, tuple(facts), page=stem(trial))] if blocks else []


def warm() -> None:
    """Compile the kernels of an audit, by that of a short drive."""
    log = named_log("arena:0:frames=12")
    (run,) = compare(log.inputs(labels=True).without_map(), "slam", ("batch",))
    graph_at_end(Trial(log, "slam", (run,)), run)
