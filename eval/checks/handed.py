"""Checks of what an estimator is handed and hands back: inputs stay unchanged, covariances are covariances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any, NamedTuple

import numpy as np

from data.inputs import Increment, LandmarkMap, Prior, Sightings
from eval.checks import worlds
from eval.checks.estimators import inputs_for
from eval.checks.finding import Finding
from eval.replay.estimators import make_estimator
from eval.replay.foreign.guard import ForeignError
from eval.replay.given import Beginning
from eval.replay.known import KnownAssociation


class Kept(NamedTuple):
    """An array that was handed out, what it was, and what it is called."""

    name: str
    handed: Any
    before: Any


def purity(text: str, task: str) -> Iterator[Finding]:
    """Nothing that it is handed is changed; here it could be, in a run the arrays are locked and writing raises."""
    inputs = inputs_for(worlds.arena_log(), task)
    prior: Prior = _writable(inputs.prior)
    known: LandmarkMap | None = None if inputs.map is None else _writable(inputs.map)
    kept = [_kept("prior.mean", prior.mean), _kept("prior.covariance", prior.covariance)]
    if known is not None:
        kept += [_kept("map.id", known.id), _kept("map.xy", known.xy)]
    try:
        estimator = make_estimator(text, Beginning(prior, inputs.sensor, known))
        association = KnownAssociation(known)
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            if frame.increment is not None:
                increment = Increment(*(np.array(a) for a in frame.increment))
                kept += [
                    _kept(f"increment.{n} of frame {k}", a) for n, a in zip(increment._fields, increment, strict=True)
                ]
                estimator.predict(increment)
            estimator.stamp(frame.time)
            sightings = Sightings(*(np.array(a) for a in frame.sightings))
            kept += [_kept(f"sightings.{n} of frame {k}", a) for n, a in zip(sightings._fields, sightings, strict=True)]
            if len(sightings.z):
                done = estimator.update(sightings, association.decide(frame))
                association.initialized(frame, done.created)
            estimator.estimate()
    except ForeignError as stop:
        yield Finding("purity", False, f"{stop}")
        return
    changed = next((k for k in kept if not np.array_equal(k.handed, k.before)), None)
    if changed is None:
        yield Finding("purity", True, f"{len(kept)} arrays that it was handed are as they were")
        return
    by = float(np.abs(changed.handed - changed.before).max())
    yield Finding(
        "purity",
        False,
        f"{changed.name} was changed by up to {by:.3g}: copy what is kept (in a run inputs are locked,"
        " so that writing raises ValueError)",
    )


def _kept(name: str, handed: Any) -> Kept:
    return Kept(name, handed, handed.copy())


def _writable(locked: Any) -> Any:
    """A copy of a frozen dataclass whose arrays can be changed."""
    copy = replace(locked)
    for f in fields(copy):
        object.__setattr__(copy, f.name, np.array(getattr(copy, f.name)))
    return copy


def covariances(text: str, task: str) -> Iterator[Finding]:
    """Every covariance that it gives is symmetric and positive semidefinite, rounding aside."""
    name = "symmetric covariance"
    inputs = inputs_for(worlds.arena_log(), task)
    estimator = make_estimator(text, inputs)
    association = KnownAssociation(inputs.map)
    off, least, blank = 0.0, np.inf, False
    try:
        for k in range(len(inputs)):
            frame = inputs.frame(k)
            if frame.increment is not None:
                estimator.predict(frame.increment)
            estimator.stamp(frame.time)
            done = estimator.update(frame.sightings, association.decide(frame))
            association.initialized(frame, done.created)
            P = estimator.estimate().covariance
            blank |= not np.isfinite(P).all()
            if not blank:
                off = max(off, float(np.abs(P - P.T).max()) / max(float(np.trace(P)), 1e-300))
                least = min(least, float(np.linalg.eigvalsh(P)[0]))
    except ForeignError as stop:
        yield Finding(name, False, f"frame {k}: {stop}")
        return
    yield Finding(
        name,
        True,
        "it gives none" if blank else f"asymmetry at most {off:.1g} of the trace, least eigenvalue {least:.2g}",
    )
