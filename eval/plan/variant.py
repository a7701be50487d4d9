"""The same recording through other numbers, as one more row: how a published tutorial treats it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Variant:
    """The same recording through other numbers, as one more row: how a published tutorial treats it.

    Attributes:
        name: appended to the log's name.
        task: the one task it is about.
        grid: s, instants to which odometry and readings are brought.
        model: motion model; alphas: displacement noise (see `data.motion.VelocityNoise`).
        sigma: of range [m] and bearing [rad].
        prior_variance: of x, y [m^2] and heading [rad^2].
        each: one update per observation instead of one per frame.
        new_variance: m^2, variance of a new landmark, uncorrelated; None: exact augmentation.
        new_variance_per_square: the same as a share of the squared range.
        association: how it pairs; gate, new_gate: probabilities, None for no gate.
        notes: what is not reproduced of the original, one sentence each.
    """

    name: str
    task: str
    grid: float
    model: str
    alphas: tuple[float, float, float, float]
    sigma: tuple[float, float]
    prior_variance: float
    each: bool = False
    new_variance: float | None = None
    new_variance_per_square: float | None = None
    association: str = "known"
    gate: float | None = None
    new_gate: float | None = None
    notes: tuple[str, ...] = ()
