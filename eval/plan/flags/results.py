"""Flags of results that other programs made: what is scored, against which truth, and how its files are read."""

from __future__ import annotations

from dataclasses import dataclass, field

from eval.replay.flag import flag, one_of, positive, text, texts

ALIGNMENTS = ("none", "first", "se2")
AXES = ("robot", "camera")


@dataclass(frozen=True)
class Reading:
    """How the files of results are read and matched with the truth; `score` has these flags, too."""

    cov: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FILE", "covariances of a TUM file, as smfeval writes them: stamp and the lower triangle of "
            "6x6 a line (NAME= where there are several results)", repeatable=True,
        ),
    )  # fmt: skip
    times: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FILE", "stamps [s] of KITTI poses, one a line (NAME= for one of several; truth= for the "
            "truth)", repeatable=True,
        ),
    )  # fmt: skip
    cov_frame: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "[NAME=]FRAME", "what covariances are of: world (errors added in the world's axes), local (right "
            "perturbation, the body's axes) or left (default: as the format has it)", repeatable=True,
        ),
    )  # fmt: skip
    axes: str = field(
        default="robot",
        metadata=flag(
            one_of(AXES), "AXES", "of poses in space, robot (z up, default) or camera (z forward, y down, as KITTI's)"
        ),
    )  # fmt: skip
    align: str = field(
        default="none",
        metadata=flag(
            one_of(ALIGNMENTS), "HOW", "move each result onto the truth: none (default), first (the first matched "
            "pose) or se2 (best rigid fit); ours are never moved",
        ),
    )  # fmt: skip
    truth_gap: float = field(
        default=1.0,
        metadata=flag(
            positive, "S", "no truth is interpolated between two that are farther apart (default: 1 s)"
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Results(Reading):
    """The rows of `run_all`."""

    result: tuple[str, ...] = field(
        default=(),
        metadata=flag(
            texts, "NAME=FILE", "a trajectory that another program made, scored beside ours: our CSV, TUM (with "
            "covariance), SQUARE, EuRoC, KITTI, ROS bag (FILE:/TOPIC), or the folder of a run (repeatable; "
            "docs/results-files.md)", repeatable=True,
        ),
    )  # fmt: skip
    truth: str | None = field(
        default=None,
        metadata=flag(
            text("a file"), "FILE", "the true path, in any of these formats: of the one --log, or alone with --result"
        ),
    )  # fmt: skip
