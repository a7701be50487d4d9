"""How observations are paired and how much of the map is kept: what a person chooses beside estimator and method."""

from __future__ import annotations

from dataclasses import dataclass


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

    gate: float | None = 0.99
    new_gate: float | None = 0.99999
    gate_known: float | None = None
    gate_smoothers: bool = True
    in_view: bool = False
    maintain: bool = False
    forget_after: float | None = None
    deactivate_after: float | None = None
    lag: float = 30.0

    @property
    def manages_map(self) -> bool:
        """Whether landmarks may leave the map or the state."""
        return self.maintain or self.forget_after is not None or self.deactivate_after is not None
