"""`slamref grade SUBMISSION`: a student's functions against the references, or a class; `--handout` writes the task."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from data.command import Command
from data.errors import UsageError
from data.terminal import ending
from wings.grade import HERE, handout

PROG = "slamref grade"
NAMES = ("corridor", "visual", "utias", "filter")


def _seeds(text: str) -> tuple[int, ...]:
    if not all(word.isdecimal() for word in text.split(",")):
        raise argparse.ArgumentTypeError(f"{text!r}: whole numbers with commas are needed, as in 7,8,9")
    return tuple(map(int, text.split(",")))


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    about, _, examples = (HERE / "help.txt").read_text(encoding="utf-8").partition("\n\nexamples:")
    parser = Command(prog, PROG, about, f"examples:{examples.rstrip()}")
    text = "file, folder or class; with the last two flags what to write"
    parser.add_argument("place", metavar="SUBMISSION", type=Path, help=text)
    parser.add_argument("--assignment", choices=NAMES, metavar="NAME", help=f"one of {', '.join(NAMES)}")
    parser.add_argument("--part", metavar="NAME", action="append", help="mark this part alone (repeatable)")
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder for JSON and page (a class: results/grade)")
    parser.add_argument("--weights", metavar="FILE", type=Path, help="points, seeds and limits (default: shipped ones)")
    parser.add_argument("--seeds", metavar="N,N", type=_seeds, help="hidden seeds (default: of the weights, public)")
    parser.add_argument("--data", metavar="MRCLAM", type=Path, help="utias: a data set instead of simulated recordings")
    parser.add_argument("--jobs", metavar="N", type=int, default=1, help="submissions at a time (default: 1)")
    parser.add_argument("--handout", choices=NAMES, metavar="NAME", help="write skeleton and sheet into a folder")
    parser.add_argument("--default-weights", action="store_true", help="write the shipped weights into a file")
    options = parser.read(argv)
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
            raise UsageError(f"--assignment: one of {', '.join(NAMES)} is needed")
        from wings.grade.classes import grade  # slow to load

        grade(options)
