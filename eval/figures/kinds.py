"""Figures of a log: when each applies and where it stands, and which of many runs it shows, few enough to read."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from data.notice import Code, notice
from data.result import Run
from data.words import environment, sentence
from eval.figures import FIGURES
from eval.referee.errors import position_distance, rms
from eval.referee.given.in_space import NONE
from eval.referee.given.runs import GivenRun, log_of
from eval.referee.score import Trial
from eval.replay.settings import ESTIMATORS, FILTERS, associations

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # slow to import, and no table waits for it

Variants = Sequence[Trial]
Facts = Mapping[str, Any]  # what the caption of a figure speaks of, by the names that its macros have
FRONT, DETAILS, SECTION = "front", "details", "section"
"""Where a figure stands: in the report itself, on the page of the log, or in a section about its subject."""


@dataclass(frozen=True)
class Kind:
    """A kind of figure: of which trials (with variants) there is one, the figure with its caption's facts."""

    applies: Callable[[Trial, Variants], bool]
    drawn: Callable[[Trial, Variants], "tuple[Figure, Facts]"]
    in_quick: bool = False
    macro: str = ""  # of the caption with its template; blank: as it is called, in `pictures.md.j2`
    place: str = SECTION


MODULES = ("claims", "error", "map")  # of this folder, which draw logs
KINDS: dict[str, Kind] = {}  # kinds of figures by name; the modules enter theirs when they are imported
Drawn = Callable[[Trial, Variants], "tuple[Figure, Facts]"]


def figure(
    name: str, applies: Callable[[Trial, Variants], bool], place: str = DETAILS, *, quick: bool = False
) -> Callable[[Drawn], Drawn]:
    """Decorator of a function that draws a trial: under its name in `pictures.md.j2`, where it `applies`."""

    def register(drawn: Drawn) -> Drawn:
        KINDS[name] = Kind(applies, drawn, quick, place=place)
        return drawn

    return register


def every() -> dict[str, Kind]:
    """All kinds, in the order of the report."""
    for module in MODULES:
        import_module(f"eval.figures.{module}")
    return {name: KINDS[name] for name in FIGURES}


FEW = 3  # missing runs that a caption names
MOST_PATHS = 6  # paths in one map, the dead-reckoned one included


def measured(trial: Trial, _: Variants = ()) -> bool:
    """Whether errors of estimates are known."""
    return bool(trial.log.truth.known_poses and finished(trial))


def blind(trial: Trial, _: Variants = ()) -> bool:
    """Whether there are estimates, and no truth."""
    return bool(not trial.log.truth.known_poses and finished(trial))


def claiming(trial: Trial) -> list[Run]:
    """Estimates that say how certain they are."""
    return [r for r in finished(trial) if has_covariance(r)]


def unclaimed(run: Run) -> str:
    """Why one that reached its end is not shown among estimates that say how certain they are."""
    return "room" if has_covariance(run) else "covariance"


def finished(trial: Trial) -> list[Run]:
    """The estimates that reached the end, implausible ones as well; dead reckoning is none."""
    return [r for r in trial.runs if r.failure is None and r.estimator != "dead-reckoning"]


def plausible(trial: Trial) -> list[Run]:
    """The estimates that reached the end and can be believed."""
    return [r for r in finished(trial) if r.flaw is None]


def calibrated(trial: Trial) -> list[Run]:
    """Runs that estimated systematic errors along, with the first association method that has some."""
    there = [r for r in finished(trial) if r.errors is not None and r.association != "none"]
    return [r for r in there if r.association == there[0].association and trial.variant_of is None]


def has_covariance(run: Run) -> bool:
    """Whether it says how certain it is; an estimator that is not ours need not."""
    return bool(np.isfinite(run.trajectory(run.phases[-1]).covariance).any())


def kind_of(run: Run) -> int:
    """0 filter, 1 incremental smoother, 2 batch smoother; one that is not ours by its phases."""
    if run.estimator in FILTERS or (run.estimator not in ESTIMATORS and run.final is None):
        return 0
    return 2 if run.online is None else 1


def _by_importance(runs: Sequence[Run], kinds: Sequence[tuple[int, int]]) -> list[Run]:
    """Estimators not ours, then a run for each of `kinds` (kind of estimator, place of its association), the rest."""
    order = associations(runs)
    theirs = sorted((r for r in runs if r.estimator not in ESTIMATORS), key=lambda r: _place(order, r))
    chosen = list({r.estimator: r for r in reversed(theirs)}.values())[::-1]
    for kind, place in kinds:
        fitting = (r for r in runs if kind_of(r) == kind and place < len(order) and r.association == order[place])
        first = next(fitting, None)
        if first is not None and not any(first is c for c in chosen):
            chosen.append(first)
    return [*chosen, *sorted([r for r in runs if not any(r is c for c in chosen)], key=lambda r: _place(order, r))]


def _place(order: Sequence[str], run: Run) -> int:
    return order.index(run.association) if run.association in order else len(order)


def _in_order(chosen: Sequence[Run]) -> list[Run]:
    """The runs by association, those of one association as they came by kind of estimator."""
    order = associations(chosen)
    return sorted(chosen, key=lambda r: (_place(order, r), kind_of(r)))


def worst(trial: Trial) -> Run | None:
    """The run that ended furthest from the true path (RMS position), of those that decide for themselves."""
    truth = trial.log.truth.pose
    own = (r for r in finished(trial) if log_of(r, trial.log) is trial.log)
    deciding = [r for r in own if r.association not in ("known", "none")]
    if truth is None or not trial.log.truth.known_poses or not deciding:
        return None
    return max(deciding, key=lambda r: rms(position_distance(r.trajectory(r.phases[-1]).pose, truth)))


def for_map(trial: Trial) -> list[Run]:
    """All runs while they are few; else a filter and a smoother, with known and other association, and the worst."""
    if len(trial.runs) <= MOST_PATHS:
        return _final_only(trial.runs)
    others = [r for r in trial.runs if r.estimator == "dead-reckoning"]
    astray, estimates = worst(trial), finished(trial)
    handed = [r for r in estimates if r.handed_in]
    ours = [r for r in estimates if not r.handed_in]
    ranked = [*handed, *_by_importance(ours, ((0, 0), (2, 0), (0, 1), (2, 1), (1, 0), (1, 1)))]
    room = MOST_PATHS - len(others) - (astray is not None)
    chosen = [r for r in ranked if r is not astray][:room]
    return _final_only([*others, *_in_order(chosen), *([] if astray is None else [astray])])


def _final_only(runs: Sequence[Run]) -> list[Run]:
    if len(associations(runs)) <= 1:
        return list(runs)
    return [replace(r, online=None) if r.final is not None and r.online is not None else r for r in runs]


def same(a: Run, b: Run) -> bool:
    """Whether two are the same run, though perhaps with other phases."""
    return (a.estimator, a.association) == (b.estimator, b.association)


MOST_PANELS = 4


def for_panels(runs: Sequence[Run], complete: Sequence[str] = ()) -> list[Run]:
    """Runs for figures with a panel per phase: all if they fit; else filter, smoothers, and decided association first.
    An incremental smoother is shown online only where batch's path is there, or in `complete`, by association.
    """
    if sum(len(r.phases) for r in runs) <= MOST_PANELS:
        return list(runs)
    complete = [*complete, *(r.association for r in runs if r.estimator == "batch")]
    doubled = [kind_of(r) == 1 and len(r.phases) > 1 and r.association in complete for r in runs]
    single = [replace(r, final=None) if twice else r for r, twice in zip(runs, doubled, strict=True)]
    if len(associations(runs)) == 1:
        ranked = _by_importance(single, ((0, 0), (1, 0), (2, 0)))
    else:
        ranked = _by_importance(single, ((0, 0), (0, 1), (1, 1), (2, 1), (1, 0), (2, 0)))
    chosen: list[Run] = []
    room = MOST_PANELS - 1  # what was handed in is what the reader came for; at least one of ours is shown with it
    ranked.sort(key=lambda r: not r.handed_in)
    for run in ranked:
        if sum(len(r.phases) for r in (*chosen, run)) <= (room if run.handed_in else MOST_PANELS):
            chosen.append(run)
    return _in_order(chosen)


def left_out(trial: Trial, shown: Sequence[Run], why: Callable[[Run], str] = lambda run: "room") -> str:
    """Sentences for the caption: which runs are not shown, and why; of many who are shown; empty if all are. `why`: of
    a run that reached its end, a key of `reasons` in the templates.
    """
    missing: dict[str, list[str]] = {}
    for run in (r for r in trial.runs if not any(same(r, s) for s in shown)):
        missing.setdefault("stopped" if run.failure is not None else why(run), []).extend(_names([run]))
    if not any(missing.values()):
        return ""
    few = sum(map(len, missing.values())) <= FEW
    return " " + _said("shown", names=_names(shown), missing=missing if few else {})


def aligned_statement(trial: Trial) -> str:
    """Which results were moved onto the truth, for captions; empty where none was."""
    moved = [r for r in trial.runs if isinstance(r, GivenRun) and r.aligned != NONE]
    if not moved:
        return ""
    names, how = dict.fromkeys(r.estimator for r in moved), moved[0].aligned
    about = sentence(notice(Code.ALIGNED, how=how, in_space=bool(moved[0].space)))
    return " " + _said("aligned", names=list(names), about=about, how=how)


def _said(macro: str, **facts: Any) -> str:
    made = getattr(environment("eval.figures").get_template("pictures.md.j2").module, macro)
    return " ".join(str(made(**facts)).split())


def _names(runs: Sequence[Run]) -> list[str]:
    named = [r for r in runs if r.estimator != "dead-reckoning"]
    return [r.estimator + f" with {r.association}" * (r.association != "none") for r in named]
