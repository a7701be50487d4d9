"""`slamref score ESTIMATE TRUTH`: score a trajectory file against a true path; one name and value per line."""

import sys
from collections.abc import Sequence
from dataclasses import replace

from data.errors import UsageError
from data.terminal import counted, ending
from eval.plan.flags import command_of
from eval.plan.flags.table import Scoring, add_flags
from eval.replay.flag import read_values, rows

PROG = "python -m eval.score"


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    parser = command_of(prog, PROG, "score")
    add_flags(parser, rows(Scoring).values())
    given = vars(parser.read(argv))
    from data.formats.results.reading import holds_both
    from eval.report.results import printed

    files, truths = given.pop("files"), given.pop("truth")
    reading = Scoring(**read_values(Scoring, given, lambda row: row.option))
    stated = any(f"{role}." in text for text in reading.columns for role in ("estimate", "truth"))
    if len(files) == 1 and not truths and (stated or holds_both(files[0])):
        files = files * 2  # a row holds both; a column without a role is the estimate's, but for the stamps
        each = [pair for text in reading.columns for pair in text.split(",")]
        own = ("" if "." in pair.partition("=")[0] or pair[:2] == "t=" else "estimate." for pair in each)
        reading = replace(reading, columns=tuple(role + pair for role, pair in zip(own, each, strict=True)))
        x = [pair.partition("=")[2] for pair in reading.columns if pair.startswith(("estimate.x=", "truth.x="))]
        if len(x) == 2 and x[0] == x[1]:
            raise UsageError(f"--columns: column {x[0]} is x of estimate and truth; name two columns")
    files, truths = _files(files, truths)
    scores, notes = printed(files, truths, reading, infer="align" not in given)
    sys.stdout.write(f"{scores}\n")
    sys.stderr.write("".join(f"note: {note}\n" for note in notes.splitlines()))


def _files(files: list[str], truths: list[str]) -> tuple[list[str], list[str]]:
    """Estimates, and the truth of each."""
    if not truths:
        if len(files) != 2:
            needed = "ESTIMATE TRUTH" if len(files) < 2 else "--truth FILE ... before the truths"
            needed += "; of a table with both --columns estimate.x=NAME,truth.x=NAME,..." * (len(files) < 2)
            raise UsageError(f"{counted(len(files), 'file')} without --truth: type {needed}")
        return files[:1], files[1:]
    if len(truths) == 1:
        return files, truths * len(files)
    if len(truths) != len(files):
        what = f"{len(truths)} truths for {counted(len(files), 'estimate')}"
        raise UsageError(f"--truth: {what}; give one, or one for each")
    return files, truths


if __name__ == "__main__":
    sys.exit(main())
