"""The command that converted a recording, with flags that mend what is wrong in its log."""

from __future__ import annotations

import argparse
import re
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from data.notice import Notice

PAIRS, REPEATED = ("--unit", "--columns", "--time-offset"), ("--exclude-truth",)
"""Flags of pairs KEY=VALUE, joined by commas; and flags that may be repeated. Of others the value is replaced."""


def flags_of(reader: argparse.ArgumentParser, kind: str) -> set[str]:
    """Flags of a kind."""
    choices = next(a.choices for a in reader._actions if isinstance(a, argparse._SubParsersAction))
    return {flag for action in choices[kind]._actions for flag in action.option_strings}


def mended(given: Sequence[str], flags: Sequence[str], known: Collection[str]) -> list[str]:
    """The words of a command with flags `--name`, `--name value` or `--name=value`; empty where none is `known`."""
    words, changed = list(given), False
    for flag in dict.fromkeys(flags):
        name, *value = re.split("[ =]", flag, maxsplit=1)
        if name not in known or flag in words:
            continue
        changed = True
        at = next((i for i, w in enumerate(words) if w == name or w.startswith(f"{name}=")), None)
        if not value:
            words += [name]
        elif at is not None and name not in REPEATED:
            there = at if "=" in words[at] else at + 1
            head = f"{name}=" if there == at else ""
            words[there] = f"{head}{_joined(words[there].removeprefix(head), value[0]) if name in PAIRS else value[0]}"
        else:
            words += [flag] if flag.startswith(f"{name}=") else [name, *value]
    return words if changed else []


def _joined(given: str, more: str) -> str:
    """Pairs KEY=VALUE, of which the latter replace those with the same key."""
    new = {pair.partition("=")[0] for pair in more.split(",")}
    kept = [pair for pair in given.split(",") if pair.partition("=")[0].strip() not in new]
    return ",".join([*kept, more])


def again(given: Sequence[str], questions: Sequence[Notice], reader: argparse.ArgumentParser) -> list[str]:
    """The words `given` with all flags of the questions that `reader` knows; none where there are no such."""
    flags = [str(flag) for question in questions for flag in cast("tuple[str, ...]", question.named.get("flags", ()))]
    return mended(given, flags, flags_of(reader, given[0])) if given and flags else []
