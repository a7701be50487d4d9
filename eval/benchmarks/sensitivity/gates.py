"""The gates of a run by default, which a person may choose: they are varied beside the constants."""

from __future__ import annotations

from eval.replay.settings import Setup

GATE = Setup().gate
NEW_GATE = Setup().new_gate


def setup() -> Setup:
    """The settings of a run, with these gates as they are now."""
    return Setup(gate=GATE, new_gate=NEW_GATE)
