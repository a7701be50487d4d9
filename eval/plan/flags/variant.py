"""The same recording through other numbers, as one more row: how a published tutorial treats it."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.replay.flag import flag, numbers, one_of, positive, positive_or_none, probability, switch, text, texts
from eval.replay.names import ASSOCIATIONS, TASKS


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

    name: str = field(metadata=flag(text("a name")))
    task: str = field(metadata=flag(one_of(TASKS)))
    grid: float = field(metadata=flag(positive))
    model: str = field(metadata=flag(one_of(("unicycle", "half_angle"))))
    alphas: tuple[float, float, float, float] = field(metadata=flag(numbers(4)))
    sigma: tuple[float, float] = field(metadata=flag(numbers(2)))
    prior_variance: float = field(metadata=flag(positive))
    each: bool = field(default=False, metadata=flag(switch))
    new_variance: float | None = field(default=None, metadata=flag(positive_or_none))
    new_variance_per_square: float | None = field(default=None, metadata=flag(positive_or_none))
    association: str = field(default="known", metadata=flag(one_of(ASSOCIATIONS)))
    gate: float | None = field(default=None, metadata=flag(probability))
    new_gate: float | None = field(default=None, metadata=flag(probability))
    notes: tuple[str, ...] = field(default=(), metadata=flag(texts))
