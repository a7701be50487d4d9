"""A command that a text advises has the flags that stand beside it."""

import re
from pathlib import Path

from data.convert.__main__ import parser
from data.digest import ROOT

ADVICE = re.compile(
    r"`([^`]*--[^`]*)` of `slamref convert ?(\w*)|"
    r"slamref convert (\w+) ((?:(?!slamref)[^`\n\"])*--(?:(?!slamref)[^`\n\"])*)"
)


def test_a_command_has_the_flags_that_are_advised():
    kinds = parser()._subparsers._group_actions[0].choices | {"KIND": parser()}
    for path in (p for of in ("data", "eval", "wings", "docs") for p in Path(ROOT, of).rglob("*")):
        if path.suffix not in (".j2", ".py", ".toml", ".md"):
            continue
        for before, kind, other, after in ADVICE.findall(path.read_text(encoding="utf-8")):
            known = kinds[kind or other]._option_string_actions if kind or other else ()
            assert [f for f in re.findall(r"--[a-z][a-z-]*", before + after) if f not in known] == [], path
