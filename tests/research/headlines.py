"""How often the headline objects to sound logs, and prints a tick over a strong fault.

`python -m tests.research.headlines N`: sound logs are N worlds of the variety's later part, with noise and view
as stated. A strong fault is a mean pose NEES above 9 of filter or smoother, or an RMSE above 1 m: found
among the runs of nearest neighbour, and with the sensor's noise stated four times too small.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

from data.log import Log
from eval.compare import compare
from eval.judgement.judgement import Judgement, Verdict, judge
from eval.judgement.runs import RunJudgement
from eval.referee.score import Trial
from tests.research.variety.worlds import LATER, draw, indices, log_of

MOST = 4000
"""Observations of a log that is small."""
CASES = tuple((task, association) for task in ("localization", "slam") for association in ("known", "jcbb"))


def trial_of(log: Log, task: str, association: str) -> Trial:
    """Filter and smoother on a log of any world."""
    inputs = log.inputs(labels=association == "known")
    inputs = inputs.without_map() if task == "slam" else inputs
    return Trial(log, task, tuple(compare(inputs, task, ("ekf", "batch"), association)))


def facts(log: Log, task: str, association: str) -> Judgement:
    """What the first screen knows of filter and smoother on a log."""
    return judge(trial_of(log, task, association))


def understated(log: Log) -> Log:
    """The same log with noise of the sensor stated four times too small."""
    o = log.recorded.observations
    return replace(log, recorded=replace(log.recorded, observations=replace(o, R=o.R / 16.0)))


def has_strong_fault(*rows: RunJudgement | None) -> bool:
    """Whether a row of filter or smoother has a strong fault, whatever the headline says."""
    return any(r is not None and (r.nees > 9.0 or r.rmse > 1.0) for r in rows)


def main(argv: list[str]) -> int:
    """Count over the first N worlds and print the shares."""
    worlds = int(argv[0]) if argv else 60
    counts: dict[tuple[str, str], Counter[str]] = {case: Counter() for case in CASES}
    strong = Counter[str]()
    for index in indices(LATER, 400)[:worlds]:
        log = log_of(draw(index, exact=True))
        if len(log.recorded.observations.frame) > MOST:
            continue
        for task, association in CASES:
            if task == "localization" and log.recorded.map is None:
                continue
            f, c = facts(log, task, association), counts[task, association]
            c["n"] += 1
            c["objects"] += bool(f.objections)
            c["filter"] += f.verdict is Verdict.FILTER
            for o in f.objections[:1]:
                c[o.objection.value] += 1
        for case in (("slam", "nn"), ("localization", "known")):
            bad = understated(log) if case[1] == "known" else log
            if case[0] == "localization" and log.recorded.map is None:
                continue
            f = facts(bad, *case)
            if has_strong_fault(*f.compared.pair):
                tick = f.tone == "good"
                strong["n"] += 1
                strong["tick"] += tick
                strong["tick, and the smoother has the fault"] += tick and has_strong_fault(f.compared.smoothed)
    for (task, association), c in counts.items():
        print(task, association, dict(c), flush=True)
    print("strong faults", dict(strong))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
