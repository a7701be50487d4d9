"""The table [variant] of a config file: settings of a published tutorial."""

from __future__ import annotations

from dataclasses import MISSING, dataclass

from data.errors import UsageError
from eval.replay.flag import numbers, one_of, positive, positive_or_none, probability, row, switch, text, texts, whole
from eval.replay.settings import ASSOCIATIONS, TASKS


def alphas_of(label: str, value: object) -> tuple[float, ...]:
    """Four or six numbers."""
    found: tuple[float, ...] = numbers(6 if isinstance(value, (list, tuple)) and len(value) == 6 else 4)(label, value)
    return found


@dataclass(frozen=True)
class Variant:
    """A further row of a recording, with the settings of a published tutorial.

    Attributes:
        name: appended to the name of the log.
        grid: [s] spacing of the times to which odometry and observations are shifted.
        model: motion model; noise: convention of its alphas (`data.motion.velocity.VelocityNoise`).
        sigma: of range [m] and bearing [rad].
        prior_variance: of x, y [m^2] and heading [rad^2].
        each: one update per observation instead of one per frame.
        new_variance: [m^2] of a new landmark, uncorrelated; None: exact augmentation.
        new_variance_per_square: the same as a share of the squared range.
        association: method; gate, new_gate: probabilities, None for no gate.
        start: [s] earliest start of the log after the first true pose.
        own_odometry, gapless, skip_led_by: see `data.formats.mrclam.load.Grid`.
        filled_prior: all nine entries of the prior's covariance equal its variance.
        gain_before_prediction, running_minimum: faults of the programs, see `eval.plan.tutorials`.
        original: sum of squared position errors [m^2] and position RMSE [m] of the original program on `original_log`
            with the landmark file of SHA-256 `original_landmarks`.
        notes: differences of the original from the algorithm it teaches, and what is not reproduced.
    """

    name: str = row(MISSING, text("a name"))
    task: str = row(MISSING, one_of(TASKS))
    grid: float = row(MISSING, positive)
    model: str = row(MISSING, one_of(("unicycle", "half_angle")))
    alphas: tuple[float, ...] = row(MISSING, alphas_of)
    sigma: tuple[float, float] = row(MISSING, numbers(2))
    prior_variance: float = row(MISSING, positive)
    noise: str = row("displacement", one_of(("displacement", "textbook")))
    each: bool = row(False, switch)
    new_variance: float | None = row(None, positive_or_none)
    new_variance_per_square: float | None = row(None, positive_or_none)
    association: str = row("known", one_of(ASSOCIATIONS))
    gate: float | None = row(None, probability)
    new_gate: float | None = row(None, probability)
    start: float | None = row(None, positive_or_none)
    own_odometry: bool = row(False, switch)
    gapless: bool = row(False, switch)
    skip_led_by: int | None = row(None, whole(0, "must not be negative"))
    filled_prior: bool = row(False, switch)
    gain_before_prediction: bool = row(False, switch)
    running_minimum: bool = row(False, switch)
    original: tuple[float, float] | None = row(None, numbers(2))
    original_log: str = row("", text("a name"))
    original_landmarks: str = row("", text("a SHA-256"))
    notes: tuple[str, ...] = row((), texts)

    def __post_init__(self) -> None:
        if len(self.alphas) == 6 and self.noise != "textbook":
            raise UsageError(f"{self.name}: six alphas go with noise = 'textbook', {self.noise!r} takes four")
        if self.gain_before_prediction and (self.task, self.association) != ("localization", "known"):
            raise UsageError(f"{self.name}: gain_before_prediction is for localization with labels")
        if self.running_minimum and self.association != "ml-ratio":
            raise UsageError(f"{self.name}: running_minimum is for association ml-ratio")
