"""How observations are paired and how much of the map is kept: what a person chooses beside estimator and method."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.replay.flag import flag, positive, positive_or_none, probability, switch


@dataclass(frozen=True)
class Setup:
    """Gates are chi-square probabilities, None for no gate; spans are seconds (frames in a log without stamps).

    Attributes:
        gate: of the association methods' tests.
        new_gate: outside which of every landmark an observation may start a new one.
        gate_known: of pairings by label.
        gate_smoothers: what that gate leaves out is left out for the smoothers, too.
        in_view: the EKF offers only landmarks in range and view as candidates, as iSAM2 always does.
        maintain: remove landmarks seen once and more than two frames ago.
        forget_after: the EKF drops landmarks unseen for so long.
        deactivate_after: the EKF parks landmarks unseen for so long, and takes them back when they may be seen again.
        lag: a fixed-lag smoother keeps poses for so long.
    """

    gate: float | None = field(
        default=0.99,
        metadata=flag(
            probability, "P", "chi-square probability of the association gate, or none (default: 0.99; known is not "
            "gated)",
        ),
    )  # fmt: skip
    new_gate: float | None = field(
        default=0.99999,
        metadata=flag(
            probability, "P", "an observation starts a landmark only outside this gate of every other, which is not "
            "inside --gate (default: 0.99999; the lab: 0.99; ml-ratio decides by itself)",
        ),
    )  # fmt: skip
    gate_known: float | None = field(
        default=None, metadata=flag(probability, "P", "gate for readings paired by label, too (default: none)")
    )
    gate_smoothers: bool = field(
        default=True, metadata=flag(switch, "", "with --gate-known: only the filters leave those readings out")
    )
    in_view: bool = field(default=False, metadata=flag(switch, "", "the EKF offers only landmarks in range and view"))
    maintain: bool = field(
        default=False, metadata=flag(switch, "", "SLAM: remove landmarks seen once and more than two frames ago")
    )
    forget_after: float | None = field(
        default=None,
        metadata=flag(
            positive_or_none, "S", "EKF-SLAM drops landmarks unseen for S seconds (frames without stamps)"
        ),
    )  # fmt: skip
    deactivate_after: float | None = field(
        default=None,
        metadata=flag(positive_or_none, "S", "EKF-SLAM parks such landmarks, and takes them back when seen again"),
    )
    lag: float = field(
        default=30.0,
        metadata=flag(positive, "S", "fixed-lag keeps poses for S seconds (frames without stamps; default: 30)"),
    )

    @property
    def upkeep(self) -> bool:
        """Whether landmarks may leave the state."""
        return self.maintain or self.forget_after is not None or self.deactivate_after is not None
