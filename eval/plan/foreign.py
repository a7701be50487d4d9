"""Foreign estimators and association methods of a plan: loaded and checked before any work."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from data.command import portable
from data.errors import UsageError
from eval.plan.experiment import Experiment
from eval.replay.external.load import ForeignError, Loaded, load
from eval.replay.external.make import Method, lack, tasks_of
from eval.replay.external.spec import introduce, is_foreign, name_of, place_of, shown
from eval.replay.settings import Setup
from eval.studies.scenario import Scenario


def load_all(estimators: Sequence[str], associations: Sequence[str]) -> None:
    """Raise UsageError for text that cannot be loaded, or is no estimator or association method."""
    for text in estimators:
        if is_foreign(text):
            tasks_of(load(text))
    for text in associations:
        if is_foreign(text):
            try:
                Method(load(text))
            except ForeignError as fault:
                raise UsageError(f"{place_of(text).shown}: {fault}") from fault


def introduce_all(texts: Iterable[str], results: Sequence[str] = ()) -> None:
    """Give every foreign name its own line style; `results` as NAME=FILE.

    Raises UsageError for a result with the name of a foreign estimator.
    """
    named = {name_of(text): text for text in texts if is_foreign(text)}
    handed_in = [text.partition("=")[0] for text in results]
    for name in handed_in:
        if name in named:
            raise UsageError(f"--result {name}: {shown(named[name])} has that name, too; rename one")
    introduce([*named, *handed_in])


def check_possible(experiments: Iterable[Experiment]) -> None:
    """Raise UsageError for a foreign estimator that can do none of its work; otherwise it does a part."""
    work = ((text, e, w.association) for e in experiments for w in e.work for text in w.estimators)
    _check([(text, e.task, association, e.setup) for text, e, association in work if is_foreign(text)])


def check_scenario(scenario: Scenario) -> list[str]:
    """The same for a study, after loading its members; returns messages about work that is left out."""
    names = tuple(m.name for m in scenario.members)
    load_all(names, scenario.association)
    pairs = [(task, a) for task in scenario.task for a in scenario.association]
    asked = [(n, task, a, scenario.setup) for n in names if is_foreign(n) for task, a in pairs]
    _check(asked)
    lacks = [(task, a, lack(n, task, a, setup)) for n, task, a, setup in asked]
    return [f"{scenario.name}, {task}, {name_of(a)}: left out, {why}" for task, a, why in lacks if why is not None]


def _check(asked: Sequence[tuple[str, str, str, Setup]]) -> None:
    for text in dict.fromkeys(text for text, *_ in asked):
        lacks = [lack(*one) for one in asked if one[0] == text]
        if all(lacks):
            raise UsageError(f"--estimator {place_of(text).shown}: {lacks[0]}")


def sources_of(texts: Iterable[str]) -> dict[str, object]:
    """For provenance.json: place of each foreign name, and the digest of its files."""
    found: dict[str, object] = {}
    for text in texts:
        if is_foreign(text):
            loaded: Loaded = load(text)
            place = place_of(text)
            where = portable(f"{place.file or place.module}:{place.attribute}")
            files = [portable(Path(f).as_posix()) for f in loaded.sources]
            found[loaded.name] = {"is": where, "sha256": loaded.digest, "files": files}
    return found
