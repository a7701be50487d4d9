"""`slamref grade SUBMISSION`: a student's functions against the references, or a class; `--handout` writes the task."""

import argparse
import sys
from collections.abc import Sequence

from data.errors import UsageError
from data.terminal import ending
from eval.plan.flags import command_of
from wings.grade import HERE, handout

PROG = "slamref grade"


def _seeds(text: str) -> tuple[int, ...]:
    if not all(word.isdecimal() for word in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r}: whole numbers with commas are needed, as in 7,8,9")
    return tuple(map(int, text.split(",")))


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    options = command_of(prog, PROG, "grade", seeds=_seeds).read(argv)
    texts = {options.place: (HERE / "weights.toml").read_text(encoding="utf-8")} if options.default_weights else {}
    if name := options.handout:
        texts = dict(zip((options.place / "sheet.md", options.place / f"{name}.py"), handout(name), strict=True))
    for file, text in texts.items():
        if file.exists():
            raise UsageError(f"{file} exists")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8", newline="\n")
        sys.stdout.write(f"written: {file}\n")
    if not texts:
        if options.assignment is None:
            raise UsageError("--assignment: one of corridor, visual, utias, filter is needed")
        from wings.grade.classes import grade  # slow to load

        grade(options)
