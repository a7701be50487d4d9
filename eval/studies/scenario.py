"""Scenarios: a world, the estimators that run in it, what is declared of them, and published numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from data.errors import UsageError
from data.log import Log
from data.motion.priors import systematic
from data.worlds import registry
from eval.replay.foreign.spec import name_of
from eval.replay.settings import Setup
from eval.studies.published import Published

RECORDED = "esde"
"""The world that is a recording: one stored run of others, found through `--data`."""


@dataclass(frozen=True)
class Member:
    """An estimator of a scenario: tasks in which it is declared consistent, parameters of the world that differ for it.

    `name` is one of ours, or the settled text of a foreign one. `world` may change only what an estimator is told (a
    published filter's own noise columns), never what happened.
    """

    name: str
    must_be_consistent: tuple[str, ...] = ()
    world: tuple[tuple[str, object], ...] = ()


@dataclass(frozen=True)
class Scenario:
    """One study.

    Attributes:
        name: stands in every table; `source` is what a person calls it by (a shipped name or a file).
        about: what it is and what is special, one paragraph.
        cite: where it comes from.
        runs: how many, unless asked otherwise.
        task, association: names; every estimator runs with each.
        members: the estimators.
        kind, values: the simulator and its parameters.
        setup: gates and the like.
        from_frame: the NEES of earlier frames does not count (an exact start has singular covariances).
        wrong: share of observations whose label names another landmark than the one that was seen.
        rates: the shares of an outlier study, each of which becomes a scenario of its own with `wrong` set,
        part: which this one is.
        published: numbers to compare with.
    """

    name: str
    source: str
    about: str
    cite: str
    runs: int
    task: tuple[str, ...]
    association: tuple[str, ...]
    members: tuple[Member, ...]
    kind: str
    values: tuple[tuple[str, object], ...]
    setup: Setup = field(default_factory=Setup)
    from_frame: int = 0
    wrong: float = 0.0
    rates: tuple[float, ...] = ()
    part: bool = False
    published: Published | None = None

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names of the members, as in tables."""
        return tuple(name_of(m.name) for m in self.members)

    @property
    def recorded(self) -> bool:
        """Whether it is a recording, not a simulation."""
        return self.kind == RECORDED

    def declared(self, task: str, estimator: str) -> bool:
        """Whether the exit status depends on this estimator."""
        return any(task in m.must_be_consistent for m in self.members if name_of(m.name) == estimator)

    def world(self, changed: tuple[tuple[str, object], ...] = ()) -> Any:
        """Parameters of the simulator, some of them changed."""
        return registry.parameters_of(self.kind)(**{**dict(self.values), **dict(changed)})

    def simulate(self, seed: int, changed: tuple[tuple[str, object], ...] = ()) -> Log:
        """The log of a seed, under the scenario's name; wrong labels, if any, are the same for every estimator."""
        world = self.world(changed)
        log = registry.simulate(self.kind, world, seed, f"{self.name}:{seed}")
        log = replace(log, source={**log.source, "kind": f"scenario {self.name}", self.kind: asdict(world)})
        if self.setup.calibrate:
            log = replace(log, recorded=replace(log.recorded, systematic=systematic(self.setup.calibrate)))
        return with_wrong_labels(log, self.wrong, seed) if self.wrong else log

    def parts(self) -> tuple[Scenario, ...]:
        """An outlier study as one scenario for each rate; one whose estimators calibrate also with plain ones, of which
        nothing is demanded; any other scenario as it is.
        """
        if self.setup.calibrate and not self.part:
            plain = replace(
                self,
                name=f"{self.name}:plain",
                members=tuple(replace(m, must_be_consistent=()) for m in self.members),
                setup=replace(self.setup, calibrate=()),
                part=True,
            )
            return (plain, replace(self, name=f"{self.name}:calibrated", part=True))
        if not self.rates:
            return (self,)
        return tuple(
            replace(self, name=f"{self.name}:{rate:g}", wrong=rate, rates=(), part=True) for rate in self.rates
        )

    def only(self, estimators: tuple[str, ...]) -> Scenario:
        """The same with these estimators instead; declarations and stated parameters of those it has stay."""
        own = {m.name: m for m in self.members}
        return replace(self, members=tuple(own.get(name, Member(name)) for name in estimators))


def with_wrong_labels(log: Log, rate: float, seed: int) -> Log:
    """The log with a share of its labels naming another landmark, drawn from a stream of its own of the seed.

    Rates are nested: what is wrong at one rate is wrong, and names the same landmark, at every higher one.
    """
    true_id = log.truth.landmark_of
    if true_id is None or log.truth.landmarks is None:
        raise UsageError(f"{log.name}: wrong labels need true ones, and this log has none")
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0BAD1D]))
    chosen = (rng.random(len(true_id)) < rate) & (true_id >= 0)
    ids = log.truth.landmarks.id
    shift = rng.integers(1, len(ids), len(true_id))
    row = np.searchsorted(ids, np.maximum(true_id, ids[0]))
    return replace(log, label=np.where(chosen, ids[(row + shift) % len(ids)], true_id))
