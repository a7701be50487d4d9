"""The text of a step word for word as the lab's program prints it, so that an output can be laid beside it.

Steps, and landmarks in the order in which they were initialized, count from 1; 0 stands for none. The first step has
nothing to pair with, and the program says nothing of it. A landmark keeps its number when others leave the map (the
program numbers the rest anew).
"""

from __future__ import annotations

import numpy as np

from data.inputs import IntArray
from eval.walk.text import TruthRow

RULE = 62 * "-"


def lab_block(frame: int, truth_row: TruthRow | None, decisions: IntArray, created: IntArray) -> str:
    """The lines of one step; arguments as of `eval.walk.text.step_block`. Empty for the first step.

    Without true ids the lines about them are left out. `created` is not used: the program does not say what is new.
    """
    if frame == 0:
        return ""
    hypothesis = np.maximum(decisions + 1, 0)
    lines = [RULE, f"Step: {frame + 1}"]
    if truth_row is not None:
        truth = np.maximum(truth_row.ground_truth + 1, 0)
        lines.append(f"GROUND  TRUTH: {_numbers(truth)}")
    lines.append(f"MY HYPOTHESIS: {_numbers(hypothesis)}")
    if truth_row is not None:
        lines.append(f"Correct (1/0)? {_numbers((truth == hypothesis).astype(np.int64))}")
    return "\n".join(lines)


def _numbers(values: IntArray) -> str:
    return "".join(f"{v:2d}  " for v in values.tolist())
