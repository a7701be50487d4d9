"""Consistency of every log without ground truth, per association method: statistics and twins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from data.errors import UsageError
from data.log import Log
from data.notice import Code, Notice, notice
from data.result import Run
from eval.plan.experiment import MISSING_RUN, Experiment, Unfinished
from eval.plan.flags.table import TWINS, Options, Study
from eval.plan.work import Job, cached, work
from eval.referee.score import Trial
from eval.replay.external.spec import is_foreign, name_of
from eval.replay.settings import FILTERS, Setup, steps
from eval.studies import sampled, store
from eval.studies.diagnosis import FEWEST, Trust, judged, settled, slopes_p
from eval.studies.sampled import Sample, one_twin, sample_of, smoother_of
from eval.studies.twins import Source, digest_of, inputs_of, source_of

LOOK = 20  # twins after which it is asked whether more would change the answer
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Group:
    """All runs of a log and task with one association method; `twins`: estimators to run on twins (none: no twins).
    `association` and `twins` are spelled as for `compare`, names in `runs` as in tables.
    """

    log: Log
    task: str
    association: str
    setup: Setup
    runs: tuple[Run, ...]
    twins: tuple[str, ...]

    def lacks(self, lost: Unfinished, why: Notice, seed: int | None = None) -> None:
        """Report to `lost` that a result is missing."""
        about = MISSING_RUN.about(log=self.log.name, task=self.task, association=name_of(self.association))
        lost.say("trust", why, about, seed=seed)


def trusted(
    experiments: Sequence[Experiment], trials: Sequence[Trial], options: Options, lost: Unfinished, progress: Progress
) -> tuple[Trust, ...]:
    """Consistency of each log and association method, in order; what runs out of memory is reported to `lost`."""
    groups = [g for e, t in zip(experiments, trials, strict=True) for g in _groups(e, t, options.study)]
    jobs = [Job(i, statistics_of, (g,)) for i, g in enumerate(groups)]
    found = dict(work(jobs, options.execution, lost=lambda i, why: groups[i].lacks(lost, why)))
    return _with_twins([(groups[i], *found[i]) for i in sorted(found)], _count(options.study), options, lost, progress)


def _count(study: Study) -> int:
    return (TWINS if study.full else 0) if study.twins is None else study.twins


def _groups(e: Experiment, trial: Trial, study: Study) -> list[Group]:
    groups = []
    for association in dict.fromkeys(w.association for w in e.work):
        runs = tuple(r for r in trial.runs if r.association == name_of(association))
        texts = {name_of(text): text for w in e.work for text in w.estimators if is_foreign(text)}
        filters = tuple(texts.get(r.estimator, r.estimator) for r in runs if r.estimator in (*FILTERS, *texts))
        twins = filters or tuple(r.estimator for r in runs if steps(r.estimator))
        if study.full and study.twins is None:
            own = tuple(f for f in filters if f == "ekf" or is_foreign(f))
            twins = own if association == "known" and "ekf" in filters else ()
        if not _count(study) or e.variant_of is not None:
            twins = ()
        groups.append(Group(e.log, e.task, association, e.setup, runs, twins))
    return [g for g in groups if any(steps(r.estimator) for r in g.runs)]


def statistics_of(group: Group) -> tuple[Sample, Run | None]:
    """Statistics of a log, and its smoother; None without batch and twins."""
    inputs = inputs_of(group.log, group.task, group.association)
    smoother = None
    if group.twins or any(r.estimator == "batch" for r in group.runs):
        smoother = smoother_of(group.runs, inputs)
    return sample_of(group.log, group.task, group.association, group.runs, smoother), smoother


def _with_twins(
    real: Sequence[tuple[Group, Sample, Run | None]], count: int, options: Options, lost: Unfinished, progress: Progress
) -> tuple[Trust, ...]:
    """Every log compared with its twins, whose statistics are cached on disk."""
    sources: dict[int, tuple[Source, Path]] = {}
    none: dict[int, Notice] = {}
    for i, (group, _, smoother) in enumerate(real):
        if group.twins and smoother is not None:
            try:
                source = source_of(group.log, smoother, group.twins, group.setup, group.association)
            except UsageError as fault:
                none[i] = notice(Code.NO_TWINS, why=str(fault))
                continue
            sources[i] = source, store.kept_folder(options.output.kept, f"{group.log.name}-twins", digest_of(source))
    seeds = range(options.study.seed, options.study.seed + count)

    def missing(owner: tuple[int, int], why: Notice) -> None:
        real[owner[0]][0].lacks(lost, why, owner[1])

    groups = {i: real[i][0] for i in sources}
    slopes = {i: slopes_p(g.log, g.task, g.association, *real[i][1:]) for i, g in groups.items()}
    kept: dict[tuple[int, int], Sample] = {}

    def own(i: int) -> list[Sample]:
        return [kept[i, seed] for seed in seeds if (i, seed) in kept]

    for before, upto in pairwise([0, *range(FEWEST, count - LOOK + 1, LOOK), count]):
        jobs = [
            (Job((i, seed), one_twin, (source, seed)), folder / f"{seed}.json")
            for i, (source, folder) in sources.items() if not (before and settled(real[i][1], own(i), slopes[i]))
            for seed in seeds[before:upto]
        ]  # fmt: skip
        kept |= cached(jobs, sampled.load, sampled.save, options.execution, missing, progress)
    judgements = []
    for i, (group, sample, smoother) in enumerate(real):
        judgements.append(Job(i, judged, (group.log, group.task, name_of(group.association), sample, own(i), smoother)))
    result = dict(work(judgements, options.execution))
    if 0 < count < FEWEST:
        few = notice(Code.TOO_FEW_TWINS, twins=count, least=FEWEST)
        none = {i: few for i, (group, _, _) in enumerate(real) if group.twins} | none
    for i, why in none.items():
        result[i] = replace(result[i], notices=(*result[i].notices, why))
    return tuple(result[i] for i in range(len(real)))
