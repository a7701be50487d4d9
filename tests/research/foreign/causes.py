"""How often the diagnosis by twins rejects sound foreign logs, and which causes it names for each fault."""

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

from data.truth import Truth
from eval.compare import compare
from eval.judgement.judgement import judge
from eval.plan.execute import trusted
from eval.plan.experiment import Experiment, Unfinished, Work
from eval.plan.flags.table import Execution, Options, Output, Study
from eval.referee.attribution import CONTRADICTED, NOTHING, UNLISTED, Finding
from eval.referee.score import Trial, score
from eval.replay.settings import Setup
from tests.research.foreign.faults import FAULTS
from tests.research.foreign.study import Case, counted, done_all, share, table
from tests.research.foreign.world import make

OR, AND = "|", "; "
FAULTY = 200_000
"""First seed of logs with faults: they share none with sound ones, nor with those of the headlines."""
SOUND = 300_000
MISSED, UNNAMED, RIGHT, ONE_OF, LATER, WRONG = "missed", "not in my list", "right", "or", "right later", "wrong"


class Row(NamedTuple):
    """The diagnosis of a log: smallest family-wise p, whether it rejects, and what it names.

    nees_filter, nees_smoother: mean NEES by the truth, which the diagnosis is not given; named: `kind name` of each
    finding, the head first, or the kind of contradiction of the `input`; those that cannot be told from it after `|`;
    word: of the headline; statistics: the rejected ones; failure: why there is no diagnosis, a rejection.
    """

    shape: str
    seed: int
    fault: str
    task: str
    association: str
    strength: float
    twins: int
    nees_filter: float
    nees_smoother: float
    p: float = math.nan
    objected: bool = True
    cause: str = ""
    word: str = ""
    named: str = ""
    statistics: str = ""
    seconds: float = 0.0
    failure: str = ""


def cases(
    faults: Sequence[str], shapes: Sequence[str], count: int, sound: int, method: str, first: int,
    strengths: Sequence[float],
) -> list[Case]:  # fmt: skip
    """`count` logs of each fault and strength and `sound` sound ones, over shapes and tasks in turn."""
    found = []
    groups = [("", sound, SOUND), *((f, count, FAULTY) for f in faults)]
    for i in range(first, first + max(count, sound)):
        lap = i // len(shapes) if len(shapes) % 2 == 0 else 0  # so that every shape gets both tasks
        for fault, number, seed in groups:
            tasks = FAULTS[fault].tasks if fault else ("localization", "slam")
            task = tasks[::-1][(i + lap) % len(tasks)]
            if i < first + number:
                own = Case(shapes[i % len(shapes)], seed + i, fault, task, method)
                found += [own._replace(strength=s) for s in (strengths if fault else (1.0,))]
    return found


def name_of(finding: Finding) -> str:
    """A finding, and what it cannot be told from."""
    return OR.join(f"{finding.kind} {name}" for name in (finding.name, *finding.other))


def one(case: Case, twins: int) -> Row:
    """The diagnosis of a case with this number of replicates, whose seeds no other case has; 0: that of a plain run."""
    begin = time.perf_counter()
    log = make(case.shape, case.seed, case.fault or None, case.strength)
    inputs = log.inputs(labels=case.association == "known")
    inputs = inputs.without_map() if case.task == "slam" else inputs
    made = Trial(log, case.task, tuple(compare(inputs, case.task, ("ekf", "batch"), case.association)))
    metrics = score([made]).metrics
    nees = [float(metrics.loc[metrics.estimator == name, "nees_pose"].iloc[0]) for name in ("ekf", "batch")]
    log = replace(made.log, truth=Truth(), label=made.log.granted)
    blind = Trial(log, case.task, made.runs)
    experiment = Experiment(log, case.task, (Work(case.association, ("ekf", "batch")),), Setup())
    with tempfile.TemporaryDirectory() as folder:
        options = Options(
            study=Study(twins=twins, seed=(case.seed % 100_000) * twins),
            output=Output(out=Path(folder) / "report"),
            execution=Execution(jobs=1, quiet=True),
        )
        judged = trusted([experiment], [blind], options, Unfinished(1), lambda done, of: None)
    blame = judged[0].blame if judged else None
    row = Row(**case._asdict(), twins=twins, nees_filter=nees[0], nees_smoother=nees[1])
    row = row._replace(seconds=time.perf_counter() - begin)
    j = judge(blind, score([blind]), judged)
    if not twins:
        word, misfit = j.cause.word if j.cause is not None else NOTHING, j.misfit.nis_verdict if j.misfit else ""
        return row._replace(objected=word != NOTHING or bool(misfit), cause=word, word=word, statistics=misfit)
    contradictions = AND.join(f"input {kind}" for n in j.log_faults.conventions for kind in n.named["kinds"])
    if contradictions:
        return row._replace(
            p=math.nan if blame is None else blame.p, cause=CONTRADICTED, word=CONTRADICTED, named=contradictions
        )
    if blame is None:
        why = "; ".join(n.code.value for n in judged[0].notices) if judged else ""
        return row._replace(failure=why or "no diagnosis")
    return row._replace(
        p=blame.p, objected=bool(blame.objected), cause=blame.cause, word=j.cause.word,
        named=AND.join(name_of(f) for f in blame.findings),
        statistics=AND.join(" ".join(key) for key in blame.objected),
    )  # fmt: skip


def is_right(name: str, fault: str) -> bool:
    """Whether a finding's name, or one that it cannot be told from, is right for a fault."""
    return any(fnmatch(part, pattern) for part in name.split(OR) for pattern in FAULTS[fault].right)


def kind_of(row: Row) -> str:
    if not row.objected:
        return MISSED
    names = [name for name in row.named.split(AND) if name]
    if not names or row.cause == UNLISTED:
        return UNNAMED if FAULTS[row.fault].right else RIGHT
    if is_right(names[0], row.fault):
        return ONE_OF if OR in names[0] else RIGHT
    return LATER if any(is_right(name, row.fault) for name in names) else WRONG


def report(rows: Sequence[Row]) -> str:
    heads: Sequence[str] = ("task", "rejected", "a cause is named", "which")
    lines: list[list[object]] = []
    for task in ("localization", "slam", "both"):
        own = [r for r in rows if not r.fault and task in (r.task, "both")]
        named = [r for r in own if r.named]
        lines.append([task, share(sum(r.objected for r in own), len(own)), share(len(named), len(own))])
        lines[-1].append(counted(r.named.split(AND)[0] for r in named))
    text = "## Sound logs\n\n" + table(heads, lines)
    heads = ("fault", "logs", "strong", "detected", RIGHT, ONE_OF, LATER, WRONG, UNNAMED, "first named")
    lines, faulty = [], [r for r in rows if r.fault]
    for fault in (*dict.fromkeys(r.fault for r in faulty), *sorted({f"{r.strength:g}" for r in faulty}), ""):
        own = [r for r in faulty if fault in (r.fault, f"{r.strength:g}", "")]
        kinds = [kind_of(r) for r in own]
        strong = sum(not max(r.nees_filter, r.nees_smoother) <= 9.0 for r in own)
        counts = [kinds.count(k) for k in (RIGHT, ONE_OF, LATER, WRONG, UNNAMED)]
        first = counted(r.named.split(AND)[0] for r in own if r.objected and r.named) if fault else ""
        lines.append([fault or "all", len(own), strong, len(own) - kinds.count(MISSED), *counts, first])
    text += "\n\n## Faults\n\n" + table(heads, lines)
    said = [k for k in map(kind_of, faulty) if k not in (MISSED, UNNAMED)]
    right, wrong = share(sum(k in (RIGHT, ONE_OF) for k in said), len(said)), share(said.count(WRONG), len(said))
    return f"{text}\n\nOf all that name a cause, the first is right or an or with it: {right}; none is: {wrong}"


def study(out: Path, wanted: Sequence[Case], twins: int, jobs: int) -> None:
    """Run what is missing, then print the tables, and write them beside the rows."""
    text = report(done_all(wanted, one, Row, out / f"causes-{twins}.csv", jobs, (twins,)))
    (out / f"causes-{twins}.md").write_text(text + "\n", encoding="utf-8")
    print(text, flush=True)
