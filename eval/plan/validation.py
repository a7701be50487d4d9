"""Validation studies of the tests without ground truth; the result of each log and its twins is cached on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from data.log import folder_name
from data.notice import Notice
from eval.plan.flags.table import Options
from eval.plan.unfinished import Unfinished
from eval.plan.work import Job, cached
from eval.studies import store, validation
from eval.studies.validation import Case, Examined, Validation


def validated(
    studies: Sequence[Validation], options: Options, lost: Unfinished, progress: Callable[[int, int], None]
) -> tuple[tuple[Validation, tuple[Examined, ...]], ...]:
    """The results of each study, in the order of `validation.cases`."""
    every = [validation.cases(study, options.study.seed) for study in studies]
    folders = [store.kept_folder(options.output.kept, study.name, content_digest(study)) for study in studies]
    jobs = [
        (Job((i, k), validation.examined, (study, case)), folders[i] / file_of(case))
        for i, study in enumerate(studies)
        for k, case in enumerate(every[i])
    ]

    def missing(owner: tuple[int, int], why: Notice) -> None:
        case = every[owner[0]][owner[1]]
        lost.say("validation", why, name=studies[owner[0]].name, world=case.world.name, seed=case.seed)

    kept = cached(jobs, validation.load, validation.save, options.execution, missing, progress)
    return tuple(
        (study, tuple(e for k in range(len(every[i])) for e in kept.get((i, k), ()))) for i, study in enumerate(studies)
    )


def content_digest(study: Validation) -> str:
    """Digest of the settings that affect the result of each log; the program and the log have digests of their own."""
    return hashlib.sha256(repr((study.twins, study.estimators, study.setup)).encode()).hexdigest()


def file_of(case: Case) -> str:
    """File name of a case: world, fault, digest of its other settings, and seed."""
    what = "broken" if case.broken else case.fault or "sound"
    digest = hashlib.sha256(repr((case.world, case.size, case.broken)).encode()).hexdigest()[: store.DIGITS]
    return f"{folder_name(case.world.name)}-{what}-{digest}-{case.seed}.json"
