"""Studies of the battery done: each log with its twins is a job, kept on disk as soon as it is done."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from data.log import folder_name
from data.notice import Notice
from eval.plan.flags.table import Options
from eval.plan.unfinished import Unfinished
from eval.plan.work import Job, work
from eval.studies import store, validation
from eval.studies.validation import Case, Examined, Validation


def validated(
    studies: Sequence[Validation], options: Options, lost: Unfinished, progress: Callable[[int, int], None]
) -> tuple[tuple[Validation, tuple[Examined, ...]], ...]:
    """What came out for every log of each study, in the order of `validation.cases`; `lost` hears what did not."""
    every = [validation.cases(study, options.study.seed) for study in studies]
    folders = [store.kept_folder(options.output.kept, study.name, content_digest(study)) for study in studies]
    kept: dict[tuple[int, int], tuple[Examined, ...]] = {}
    jobs: list[Job[tuple[int, int]]] = []
    for i, study in enumerate(studies):
        for k, case in enumerate(every[i]):
            found = validation.load(folders[i] / file_of(case))
            if found is None:
                jobs.append(Job((i, k), validation.examined, (study, case)))
            else:
                kept[i, k] = found

    def missing(owner: tuple[int, int], why: Notice) -> None:
        case = every[owner[0]][owner[1]]
        lost.say("validation", why, name=studies[owner[0]].name, world=case.world.name, seed=case.seed)

    for done, ((i, k), result) in enumerate(work(jobs, options.execution, far=True, lost=missing), start=1):
        validation.save(folders[i] / file_of(every[i][k]), result)
        kept[i, k] = result
        progress(done, len(jobs))
    return tuple(
        (study, tuple(e for k in range(len(every[i])) for e in kept.get((i, k), ()))) for i, study in enumerate(studies)
    )


def content_digest(study: Validation) -> str:
    """Digest of what the judgement of one log depends on, beside the program; which logs is in the files' names."""
    said = (study.twins, study.estimators, study.setup)
    return hashlib.sha256(repr(said).encode()).hexdigest()


def file_of(case: Case) -> str:
    """Name of the file of a case: world, fault, seed, and a digest of all else that it consists of."""
    what = "broken" if case.broken else case.fault or "sound"
    digest = hashlib.sha256(repr((case.world, case.size, case.broken)).encode()).hexdigest()[: store.DIGITS]
    return f"{folder_name(case.world.name)}-{what}-{digest}-{case.seed}.json"
