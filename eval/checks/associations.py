"""Checks of a way of association, `f(expectation, gate) -> decisions`, on problems drawn from fixed seeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from association.expectation import Expectation, gate_threshold
from association.jcbb import jcbb_first
from association.methods import ml, ml_ratio, nn
from data.inputs import IntArray
from data.result import NEW
from data.se2 import Array, wrap_angle
from eval.checks.finding import Finding
from eval.replay.external.guard import ForeignError

Method = Callable[[Expectation, float | None], IntArray]
PROBLEMS = 30
GATE = 0.99
MANY_TO_ONE = (nn, ml, ml_ratio, jcbb_first)
"""Ours that let several observations take one landmark; others say so by an attribute `one_to_one = False`."""
IN_ORDER = (jcbb_first,)
"""Ours for which the order of the candidates decides between equals, as in a recorded program; others say so by
`any_order = False`."""


def polar_residual(z: Array, z_hat: Array) -> Array:
    """Range [m] and bearing [rad], the bearing wrapped."""
    off: Array = np.asarray(z, float) - np.asarray(z_hat, float)
    off[..., 1] = wrap_angle(off[..., 1])
    return off


def problem(seed: int, *, spread: float = 3.0, near: float = 1.0, most: int = 8) -> Expectation:
    """Candidates in polar coordinates, correlated through the pose; most observations are of one of them.

    Landmark numbers are neither ascending nor 0, 1, 2, ... `near` scales the noise of the observations.
    """
    rng = np.random.default_rng([seed, 0xA550C])
    n, m = (int(rng.integers(1, most)) for _ in range(2))
    z_hat = np.column_stack([rng.uniform(2.0, 2.0 + spread, n), rng.uniform(-math.pi, math.pi, n)])
    pose = rng.normal(0.0, 0.15, (2 * n, 3))
    joint = pose @ pose.T + np.diag(rng.uniform(0.002, 0.02, 2 * n))
    R = np.tile(np.diag([0.02, 0.005]), (m, 1, 1))
    of = rng.integers(0, n, m)
    z = z_hat[of] + near * (
        rng.multivariate_normal(np.zeros(2 * n), joint).reshape(n, 2)[of] + 0.1 * rng.normal(size=(m, 2))
    )
    z[:, 1] = wrap_angle(z[:, 1])
    number = rng.permutation(3 * n)[:n]
    return Expectation.from_arrays(z, z_hat, joint, R, polar_residual, number=number)


def apart(seed: int) -> tuple[Expectation, IntArray]:
    """Candidates far from each other, all seen exactly, in another order; and the right decisions."""
    rng = np.random.default_rng([seed, 0xFA4])
    n = 6
    angle = wrap_angle(math.pi + 2.0 * math.pi * np.arange(n) / n)
    z_hat = np.column_stack([np.full(n, 5.0), angle])
    order = rng.permutation(n)
    number = rng.permutation(4 * n)[:n]
    e = Expectation.from_arrays(
        z_hat[order], z_hat, 1e-3 * np.eye(2 * n), np.tile(1e-3 * np.eye(2), (n, 1, 1)), polar_residual, number=number
    )
    return e, number[order]


def exact_readings(f: Method) -> Iterator[Finding]:
    """Landmarks far apart, seen exactly: everybody pairs all of them, by their numbers."""
    for seed in range(PROBLEMS):
        e, right = apart(seed)
        for gate in (GATE, 0.5):
            found = f(e, gate)
            if not np.array_equal(found, right):
                i = int(np.argmax(found != right))
                yield Finding(
                    "exact readings",
                    False,
                    f"observation {i} is exactly landmark {right[i]}, decided is {found[i]}"
                    f" (numbers of the candidates: {e.number.tolist()}; a decision is a number, not a row)",
                )
                return
    yield Finding("exact readings", True, f"{2 * PROBLEMS * 6} readings of landmarks far apart go to their landmarks")


def seam(f: Method) -> Iterator[Finding]:
    """A bearing just below pi and one just above -pi are the same direction."""
    for side in (1.0, -1.0):
        z_hat, z = np.array([[5.0, side * (math.pi - 0.01)]]), np.array([[5.0, -side * (math.pi - 0.01)]])
        e = Expectation.from_arrays(
            z, z_hat, 1e-3 * np.eye(2), 1e-3 * np.eye(2)[None], polar_residual, number=np.array([7])
        )
        found = f(e, GATE)
        if found.tolist() != [7]:
            yield Finding(
                "angle seams",
                False,
                f"bearings {z_hat[0, 1]:.4f} and {z[0, 1]:.4f} are 0.02 rad apart, decided is {found[0]}, "
                f"not 7: use expectation.innovations() or .residual, which wraps",
            )
            return
    yield Finding("angle seams", True, "bearings on both sides of +-pi are paired")


def twice(f: Method, *, allowed: bool) -> Iterator[Finding]:
    """No landmark is paired with two observations of a frame, unless the method says that it does so."""
    count, first = 0, ""
    for seed in range(PROBLEMS):
        found = f(problem(seed, spread=0.5), GATE)
        paired, times = np.unique(found[found >= 0], return_counts=True)
        if (times > 1).any():
            count += 1
            number = paired[times > 1][0]
            rows = " and ".join(map(str, np.flatnonzero(found == number)))
            first = first or f"landmark {number} goes to observations {rows}"
    if not count:
        yield Finding("no landmark twice", True, f"in {PROBLEMS} crowded frames no landmark is paired twice")
        return
    said = f"in {count} of {PROBLEMS} crowded frames a landmark is paired twice ({first})"
    yield Finding("no landmark twice", allowed, f"{said}{', as it says of itself' if allowed else ''}")


def empty(f: Method) -> Iterator[Finding]:
    """No observations, no candidates, neither."""
    for n, m in ((3, 0), (0, 3), (0, 0)):
        e = Expectation.from_arrays(
            np.ones((m, 2)), np.ones((n, 2)), np.eye(2 * n), np.tile(np.eye(2), (m, 1, 1)), polar_residual
        )
        found = f(e, GATE)
        if found.tolist() != [NEW] * m:
            yield Finding(
                "empty frames", False, f"{m} observations and {n} candidates: {found.tolist()}, not {[NEW] * m} (NEW)"
            )
            return
    yield Finding("empty frames", True, "no observations, no candidates, neither: nothing is paired")


def gate(f: Method) -> Iterator[Finding]:
    """Nothing outside the gate is paired; without a gate, a single far landmark is."""
    for p in (GATE, 0.5):
        for seed in range(PROBLEMS):
            e = problem(seed, near=2.0)
            found = f(e, p)
            d2 = e.individual_distances()[e.paired(found)]
            limit = gate_threshold(p)
            if (d2 > limit * (1.0 + 1e-9)).any():
                yield Finding(
                    "gate",
                    False,
                    f"a pair of squared distance {d2.max():.4g} passed the gate {p:g}, which is {limit:.4g} "
                    "(chi-square, 2 dof)",
                )
                return
    far = Expectation.from_arrays(
        np.array([[5.0, 0.0]]), np.array([[6.0, 0.0]]), 1e-2 * np.eye(2), 1e-2 * np.eye(2)[None], polar_residual
    )
    open_gate = f(far, None).tolist() == [0]
    also = (
        "without a gate the only landmark is paired at any distance"
        if open_gate
        else ("without a gate it leaves a landmark at 7 sigma unpaired, by a limit of its own")
    )
    yield Finding("gate", True, f"no pair is outside the gates of {GATE:g} and 0.5; {also}")


def order(f: Method, *, allowed: bool) -> Iterator[Finding]:
    """Candidates in another order: the same decisions, unless the method says otherwise."""
    rng = np.random.default_rng(5)
    for seed in range(PROBLEMS):
        e = problem(seed)
        found, other = f(e, GATE), f(e.only(rng.permutation(len(e.number))), GATE)
        if not np.array_equal(found, other):
            i = int(np.argmax(found != other))
            said = f"observation {i} goes to {found[i]}, and to {other[i]} with the same candidates in another order"
            yield Finding("order of candidates", allowed, f"{said}{', as it says of itself' if allowed else ''}")
            return
    yield Finding("order of candidates", True, f"does not matter in {PROBLEMS} frames")


def purity(f: Method) -> Iterator[Finding]:
    """The expectation is as it was; here it could be changed, in a run its arrays are locked and writing raises."""
    for seed in range(PROBLEMS):
        e = problem(seed)
        names = [x.name for x in fields(e) if isinstance(getattr(e, x.name), np.ndarray)]
        writable: dict[str, Any] = {name: np.array(getattr(e, name)) for name in names}
        e = replace(e, **writable)
        before = {name: getattr(e, name).copy() for name in names}
        f(e, GATE)
        changed = [name for name in names if not np.array_equal(getattr(e, name), before[name])]
        if changed:
            yield Finding("purity", False, f"it changed expectation.{changed[0]}: work on a copy")
            return
    yield Finding("purity", True, f"{PROBLEMS} expectations are as they were")


def determinism(f: Method) -> Iterator[Finding]:
    """Asked again, it decides the same."""
    for seed in range(PROBLEMS):
        first, second = f(problem(seed), GATE), f(problem(seed), GATE)
        if not np.array_equal(first, second):
            yield Finding(
                "determinism",
                False,
                f"the same frame twice: {first.tolist()}, then {second.tolist()}; random numbers need a fixed seed",
            )
            return
    yield Finding("determinism", True, f"{PROBLEMS} frames asked twice, the same decisions")


def run(f: Method, original: Callable[..., Any]) -> Iterator[Finding]:
    """All checks of a function; a crash fails the check that met it. `original`: what says how it is meant."""
    many = original in MANY_TO_ONE or not getattr(original, "one_to_one", True)
    ordered = original in IN_ORDER or not getattr(original, "any_order", True)
    checks: dict[str, Callable[[Method], Iterator[Finding]]] = {
        "exact readings": exact_readings,
        "angle seams": seam,
        "no landmark twice": partial(twice, allowed=many),
        "empty frames": empty,
        "gate": gate,
        "order of candidates": partial(order, allowed=ordered),
        "purity": purity,
        "determinism": determinism,
    }
    for name, check in checks.items():
        try:
            yield from check(f)
        except ForeignError as stop:
            yield Finding(name, False, str(stop))
