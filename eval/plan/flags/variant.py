"""The same recording through other numbers, as one more row: how a published tutorial treats it."""

from __future__ import annotations

from dataclasses import dataclass, field

from data.errors import UsageError
from eval.replay.flag import flag, numbers, one_of, positive, positive_or_none, probability, switch, text, texts, whole
from eval.replay.names import ASSOCIATIONS, TASKS


def alphas_of(label: str, value: object) -> tuple[float, ...]:
    """Four numbers, or six."""
    found: tuple[float, ...] = numbers(6 if isinstance(value, (list, tuple)) and len(value) == 6 else 4)(label, value)
    return found


@dataclass(frozen=True)
class Variant:
    """The same recording through other numbers, as one more row: how a published tutorial treats it.

    Attributes:
        name: appended to the log's name.
        task: the one task it is about.
        grid: s, instants to which odometry and readings are brought.
        model: motion model; noise: the convention of its alphas (see `data.motion.velocity.VelocityNoise`).
        sigma: of range [m] and bearing [rad].
        prior_variance: of x, y [m^2] and heading [rad^2].
        each: one update per observation instead of one per frame.
        new_variance: m^2, variance of a new landmark, uncorrelated; None: exact augmentation.
        new_variance_per_square: the same as a share of the squared range.
        association: how it pairs; gate, new_gate: probabilities, None for no gate.
        start: s after the first ground-truth row; the log begins no earlier.
        own_odometry, gapless, skip_led_by: see `data.mrclam.frames.Grid`.
        filled_prior: all nine entries of the prior's covariance are its variance, not the three on the diagonal.
        gain_before_prediction, running_minimum: faults of the programs, see `eval.plan.tutorials.programs`.
        original: what the original program gives on `original_log`: sum of squared errors of position [m^2], and
            position RMSE [m].
        notes: what the original does otherwise than the algorithm it teaches, and what of it is not reproduced.
    """

    name: str = field(metadata=flag(text("a name")))
    task: str = field(metadata=flag(one_of(TASKS)))
    grid: float = field(metadata=flag(positive))
    model: str = field(metadata=flag(one_of(("unicycle", "half_angle"))))
    alphas: tuple[float, ...] = field(metadata=flag(alphas_of))
    sigma: tuple[float, float] = field(metadata=flag(numbers(2)))
    prior_variance: float = field(metadata=flag(positive))
    noise: str = field(default="displacement", metadata=flag(one_of(("displacement", "textbook"))))
    each: bool = field(default=False, metadata=flag(switch))
    new_variance: float | None = field(default=None, metadata=flag(positive_or_none))
    new_variance_per_square: float | None = field(default=None, metadata=flag(positive_or_none))
    association: str = field(default="known", metadata=flag(one_of(ASSOCIATIONS)))
    gate: float | None = field(default=None, metadata=flag(probability))
    new_gate: float | None = field(default=None, metadata=flag(probability))
    start: float | None = field(default=None, metadata=flag(positive_or_none))
    own_odometry: bool = field(default=False, metadata=flag(switch))
    gapless: bool = field(default=False, metadata=flag(switch))
    skip_led_by: int | None = field(default=None, metadata=flag(whole(0, "must not be negative")))
    filled_prior: bool = field(default=False, metadata=flag(switch))
    gain_before_prediction: bool = field(default=False, metadata=flag(switch))
    running_minimum: bool = field(default=False, metadata=flag(switch))
    original: tuple[float, float] | None = field(default=None, metadata=flag(numbers(2)))
    original_log: str = field(default="", metadata=flag(text("a name")))
    notes: tuple[str, ...] = field(default=(), metadata=flag(texts))

    def __post_init__(self) -> None:
        if len(self.alphas) == 6 and self.noise != "textbook":
            raise UsageError(f"{self.name}: six alphas go with noise = 'textbook', {self.noise!r} takes four")
        if self.gain_before_prediction and (self.task, self.association) != ("localization", "known"):
            raise UsageError(f"{self.name}: gain_before_prediction is for localization with labels")
        if self.running_minimum and self.association != "ml-ratio":
            raise UsageError(f"{self.name}: running_minimum is of the association ml-ratio")
