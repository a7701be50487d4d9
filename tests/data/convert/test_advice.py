"""The flags in warnings about a log, typed as they stand, make a log that raises none of them."""

import re
import shlex
from pathlib import Path

import pytest

import slamref
from data.convert.__main__ import main
from data.notice import Code
from data.worlds.arena import Arena, simulate
from tests.data.formats.tables.foreign import FLAGS, export

TABLES = {
    "bearings in degrees": (("angle=deg,", "theta=deg,"), Code.CONTRADICTION),
    "bearings to the other side": (("angle=deg,", "angle=deg,bearing=-deg,"), Code.CONTRADICTION),
    "this file's bearings": (("angle=deg,", "angle=deg,observations.bearing=-deg,"), Code.CONTRADICTION),
    "a short reach": (("--max-range 8m", "--max-range 4m"), Code.MAX_RANGE),
    "a narrow view": (("--max-range 8m", "--max-range 8m --view=-20deg,20deg"), Code.FIELD_OF_VIEW),
    "a prior elsewhere": (("--prior truth", "--prior 40m,0,0"), Code.PRIOR),
    "a truth elsewhere": (("--prior truth", "--prior 0,0,0 --truth-transform 30m,0,1"), Code.CONTRADICTION),
}

QUICK = ("bearings in degrees", "this file's bearings", "a short reach", "a prior elsewhere")


@pytest.fixture
def convert(capsys):
    """`convert(words)`: codes of the warnings by title, and the words of flags in them."""

    def run(words):
        assert main(words, "slamref convert") == 0
        said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning: ")]
        flags = [flag for line in said for flag in re.findall(r"`(--[^`]*)`", line)]
        codes = {c for c in Code for line in said if line.endswith(f"({c.replace('-', ' ')})")}
        return codes, [word for flag in dict.fromkeys(flags) for word in shlex.split(flag)]

    return run


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    return export(simulate(Arena(frames=200, landmarks=30), 0), folder)


def test_a_right_table_is_asked_nothing(robot, convert, tmp_path):
    assert convert(["table", *robot, str(tmp_path / "log"), *FLAGS]) == (set(), [])


@pytest.mark.parametrize("fault", [pytest.param(f, marks=[] if f in QUICK else pytest.mark.slow) for f in TABLES])
def test_what_is_printed_about_a_table_mends_it(fault, robot, convert, tmp_path):
    (right, wrong), code = TABLES[fault]
    flags = " ".join(shlex.quote(w) for w in FLAGS).replace(right, wrong)
    words = ["table", *robot, str(tmp_path / "log"), *shlex.split(flags)]
    found, more = convert(words)
    assert code in found
    assert convert([*words, *more]) == (set(), [])


ROOT = Path(__file__).parents[3]
PROGRAM = re.compile(r"`slamref ([^`]*)`")


def written_commands():
    for package in ("data", "association", "ekf", "graph", "eval", "wings"):
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in (".j2", ".py"):
                for words in PROGRAM.findall(re.sub(r"\{\{.*?\}\}|\{\w+\}", "NAME", path.read_text())):
                    yield path.name, words.split()


def test_commands_in_texts_have_their_verb_and_flags_and_leave_nothing_out(capsys):
    """Capitals are for the reader to replace."""
    helped = {}
    found = list(written_commands())
    assert len(found) > 30
    for place, (verb, *words) in found:
        assert verb in slamref.commands() or verb == "--help", (place, verb)
        assert not any(w == "..." for w in words), (place, words)
        flags = [w for w in words if w.startswith("--")]
        if flags and verb not in helped:
            kind = words[:1] if verb == "convert" else []
            with pytest.raises(SystemExit):
                slamref.main([verb, *kind, "--help-all" if verb == "run" else "--help"])
            helped[verb] = capsys.readouterr().out
        assert all(flag in helped[verb] for flag in flags), (place, flags)
