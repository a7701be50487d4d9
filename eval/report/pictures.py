"""The pictures of one trial: when each kind applies, what it draws, and the facts of its caption."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data.result import Run
from data.wing import by_name
from eval.figures.association import bars, confusion_figure
from eval.figures.claims import claims_figure, filter_smoother_figure, nees_figure, systematic_figure
from eval.figures.error import difference_figure, error_figure, longest_sigma
from eval.figures.growth import closing_frame, growth_figure, state_figure, state_is_informative
from eval.figures.log import loop_state_figure
from eval.figures.map import map_figure
from eval.figures.plane import SIGMAS, longest_axis
from eval.figures.space import space_figure
from eval.figures.style import save
from eval.referee.given.runs import GivenRun
from eval.referee.score import Trial, confusion_of
from eval.referee.truth_free import SHARE
from eval.report import shown_runs
from eval.report.page.blocks import Picture
from eval.report.results import aligned_statement
from eval.report.rows import SYSTEMATIC, stem
from eval.report.words import paragraph

FILTER_SMOOTHER = "filter-smoother"
Variants = Sequence[Trial]
Facts = Mapping[str, Any]
"""What the caption of a picture speaks of, by the names that its macros in `pictures.md.j2` have."""


@dataclass(frozen=True)
class Kind:
    """A kind of picture: of which trials (with variants) there is one, the figure with its caption's facts."""

    applies: Callable[[Trial, Variants], bool]
    drawn: Callable[[Trial, Variants], tuple[Figure, Facts]]
    in_quick: bool = False
    macro: str = ""  # of the caption, if it is not called as the kind; of a wing with its template


def kinds(trial: Trial, variants: Variants = (), *, quick: bool = False) -> tuple[str, ...]:
    """Which pictures a trial gets, with its variants."""
    every = {**KINDS, **by_name("figures")}.items()
    return tuple(name for name, kind in every if (kind.in_quick or not quick) and kind.applies(trial, variants))


def draw(folder: Path, trial: Trial, kind: str, variants: Variants = ()) -> Picture:
    """Draw one picture of `kinds`, as files below the result folder."""
    name, own = stem(trial, kind), KINDS.get(kind) or by_name("figures")[kind]
    figure, facts = own.drawn(trial, variants)
    macro = own.macro if "#" in own.macro else f"pictures#{own.macro or kind.replace('-', '_')}"
    caption, alt = (paragraph(m, log=trial.log.name, task=trial.task, **facts) for m in (macro, f"{macro}_alt"))
    save(figure, folder / "figures", name)
    return Picture(name, caption, alt)


def _measured(trial: Trial) -> bool:
    return bool(trial.log.truth.known_poses and shown_runs.finished(trial))


def _blind(trial: Trial) -> bool:
    return bool(not trial.log.truth.known_poses and shown_runs.finished(trial))


def _claiming(trial: Trial) -> list[Run]:
    """Estimates that say how certain they are."""
    return [r for r in shown_runs.finished(trial) if shown_runs.has_covariance(r)]


def _unclaimed(run: Run) -> str:
    """Why one that reached its end is not shown among estimates that say how certain they are."""
    return "room" if shown_runs.has_covariance(run) else "covariance"


def has_outcomes(trial: Trial, variants: Variants = ()) -> bool:
    """Whether decisions were made (not only labels read) that can be scored."""
    return any(
        confusion_of(r, t.log, "online") is not None
        for t in (trial, *variants)
        for r in t.runs
        if r.association != "known" and r.failure is None
    )


def _map(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    drawn, astray = shown_runs.for_map(trial), shown_runs.worst(trial)
    shown = astray is not None and len(drawn) < len(trial.runs) and any(shown_runs.same(r, astray) for r in drawn)
    facts = {"runs": drawn, "astray": astray if shown else None, "aligned": aligned_statement(trial)}
    return map_figure(trial.log, drawn), {**facts, "others": shown_runs.left_out(trial, drawn)}


def _error(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    shown = shown_runs.for_panels(shown_runs.finished(trial))
    return error_figure(trial.log, shown), {"others": shown_runs.left_out(trial, shown_runs.side_by_side(shown))}


def _spatial(trial: Trial) -> list[Run]:
    """Results in space with their truth."""
    return [r for r in shown_runs.finished(trial) if isinstance(r, GivenRun) and r.space]


def _space(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    return space_figure(_spatial(trial)), {}


def _nees(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    shown = shown_runs.for_panels(_claiming(trial))
    return nees_figure(trial.log, shown), {"others": shown_runs.left_out(trial, shown, _unclaimed)}


def _has_difference(trial: Trial, _: Variants) -> bool:
    reference = trial.find("batch")
    return _blind(trial) and reference is not None and reference.flaw is None and len(shown_runs.finished(trial)) > 1


def _difference(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    reference = trial.find("batch")
    assert reference is not None  # or there is no such picture
    rows = shown_runs.for_panels(
        [r for r in shown_runs.finished(trial) if r is not reference], complete=(reference.association,)
    )
    return difference_figure(trial.log, rows, reference), {"others": shown_runs.left_out(trial, [*rows, reference])}


def _claims(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    shown = shown_runs.for_panels(_claiming(trial))
    return claims_figure(trial.log, shown), {"others": shown_runs.left_out(trial, shown, _unclaimed)}


def _loop_state(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    shown = shown_runs.for_loop_states(trial)
    return loop_state_figure(trial.log, shown), {"others": shown_runs.left_out(trial, shown, lambda run: "method")}


def _filter_smoother(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    alike = shown_runs.for_filter_smoother(trial)
    assert alike is not None  # or there is no such picture
    runs, smoother = alike
    there = [r for r in shown_runs.plausible(trial) if r.online is not None and r.association == smoother.association]
    others = [r.estimator for r in there if not any(r is shown for shown in runs)]
    facts = {"smoother": smoother, "others": others, "share": SHARE}
    return filter_smoother_figure(trial.log, runs, smoother), facts


def _calibrated(trial: Trial) -> list[Run]:
    """Runs that estimated systematic errors along, with the first association method that has some."""
    there = [r for r in shown_runs.finished(trial) if r.errors is not None and r.association != "none"]
    return [r for r in there if r.association == there[0].association]


def _systematic(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    runs, systematic = _calibrated(trial), trial.log.recorded.systematic
    assert systematic is not None  # or nothing was estimated
    return systematic_figure(trial.log, systematic, runs), {"runs": runs}


def _growing(trial: Trial, run: Run) -> dict[str, object]:
    """Standard deviations [m] along the least certain direction: of the robot online, and of the last landmarks."""
    closed, sigma = closing_frame(trial.log, run), longest_sigma(run.trajectory("online"))
    made: dict[str, object] = {
        "estimator": run.estimator,
        "at_most": float(np.nanmax(sigma)),
        "at_end": float(sigma[-1]),
        "before_closing": float(sigma[closed - 1]) if closed is not None and closed > 0 else None,
        "landmarks": None,  # of the first, the last, and the least certain one
    }
    if run.map is not None and len(run.map):
        each = longest_axis(run.map.covariance) / SIGMAS
        largest = int(each.argmax())
        made["landmarks"] = (float(each[0]), float(each[-1]), float(each[largest]))
        made["number"] = int(run.map.number[largest])
    return made


def _growth(trial: Trial, _: Variants) -> tuple[Figure, Facts]:
    runs = shown_runs.for_growth(trial)
    grown = [_growing(trial, r) for r in runs]
    alike = replace(trial, runs=tuple(r for r in trial.runs if r.association == runs[0].association))
    others = shown_runs.left_out(alike, runs, lambda run: "online" if run.online is None or run.map is None else "room")
    return growth_figure(trial.log, runs), {"association": runs[0].association, "grown": grown, "others": others}


def _association(trial: Trial, variants: Variants) -> tuple[Figure, Facts]:
    return confusion_figure(f"{trial.log.name}, {trial.task}: decisions", bars(trial, variants)), {}


KINDS: Mapping[str, Kind] = {
    "map": Kind(lambda trial, _: True, _map, in_quick=True),
    "error": Kind(lambda trial, _: _measured(trial), _error, in_quick=True),
    "space": Kind(lambda trial, _: bool(_spatial(trial)), _space, in_quick=True),
    "nees": Kind(lambda trial, _: _measured(trial) and bool(_claiming(trial)), _nees),
    "difference": Kind(_has_difference, _difference, in_quick=True),
    "claims": Kind(lambda trial, _: _blind(trial) and bool(_claiming(trial)), _claims),
    "fate": Kind(
        lambda trial, _: _blind(trial) and bool(shown_runs.for_loop_states(trial)),
        _loop_state,
        macro="loop_state",
    ),
    FILTER_SMOOTHER: Kind(
        lambda trial, _: trial.variant_of is None and shown_runs.for_filter_smoother(trial) is not None,
        _filter_smoother,
    ),
    SYSTEMATIC: Kind(
        lambda trial, _: trial.variant_of is None and bool(_calibrated(trial)), _systematic, in_quick=True
    ),
    "growth": Kind(
        lambda trial, _: (
            trial.task == "slam" and trial.log.truth.known_poses > 0 and bool(shown_runs.for_growth(trial))
        ),
        _growth,
    ),
    "state": Kind(state_is_informative, lambda trial, variants: (state_figure(trial, variants), {})),
    "association": Kind(
        has_outcomes,
        _association,
        in_quick=True,
    ),
}  # by name, in the order of the report
