"""What a wing adds to the core: commands, names of the Python API, kinds of logs, sections of the report, and so on.

The core imports no wing. It asks `wings()` for tables of texts `module:function`, and imports what it uses. Ours are
the folders of the package `wings`; those of others are entry points of the group `slamref.wings`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module, metadata, resources
from pathlib import Path
from typing import Any

from data.errors import UsageError

GROUP = "slamref.wings"


@dataclass(frozen=True)
class World:
    """A world and its texts.

    Attributes:
        module: with its function `simulate(parameters, seed, name)`.
        parameters: in that module, the dataclass of its parameters.
        example: names of its logs.
        counts: further keys of its names, whole numbers from 1 up that are no parameters.
        help, description, examples: of its kind of `python -m data.convert`; empty if that writes something else.
        opens: of a world with images, function of (name, reading, say) that opens a log by its name; blank: `simulate`.
    """

    module: str
    parameters: str
    example: str
    help: str = ""
    description: str = ""
    examples: str = ""
    counts: tuple[str, ...] = ()
    opens: str = ""


@dataclass(frozen=True)
class Recording:
    """A kind of folder without a `log.toml` that is a log.

    Attributes:
        recognized: function of (folder) that says whether it is one.
        opens: function of (folder, reading, say).
        kind: of `python -m data.convert`.
        what: in a message.
    """

    recognized: str
    opens: str
    kind: str
    what: str


@dataclass(frozen=True)
class Wing:
    """One wing; every text is `module:function`, imported when it is used.

    Attributes:
        name: of its folder, or entry point.
        commands: subcommands of `slamref`: function of (arguments, name of the command), and what it does.
        api: names of the Python API, and their modules.
        worlds: simulated worlds by name.
        logs: functions of (path) that open a folder with a `log.toml` if it is one of theirs, else return None.
        recordings: kinds of folders without one.
        conversions: modules of kinds of `python -m data.convert`, as its `SOURCES`.
        variants: functions of (options, experiments) that give further experiments, variants of their logs.
        images: functions of (name, log) that give an image of each frame, PNG; none of a log that is not theirs.
        log_sections: functions of (folder, output, trial) that give sections of the report on one log and task.
        sections: functions of (folder, output, trials, in_lab, factor) that give sections of the report.
        benchmarks: functions of (quick) that give lines of a table of `slamref benchmark`.
        plans: functions of (name, estimators, setup, reading, say) that give the experiments of `--lab`.
        hand_in: functions of (folder, options, trials, scores, unfinished) that give sections that come first.
        last_sections: functions of (trials, scores, answered_above) that give sections after those on logs.
        write_up: functions of (folder, trials, scores, sections of `hand_in`, other sections) of `--write-up`.
        settings: functions of (options, trials) that give settings by log, kept in `provenance.json`.
        templates: package with a folder `templates` of words of the report; blank: none.
    """

    name: str
    commands: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    api: Mapping[str, str] = field(default_factory=dict)
    worlds: Mapping[str, World] = field(default_factory=dict)
    logs: tuple[str, ...] = ()
    recordings: tuple[Recording, ...] = ()
    conversions: tuple[str, ...] = ()
    variants: tuple[str, ...] = ()
    images: tuple[str, ...] = ()
    log_sections: tuple[str, ...] = ()
    sections: tuple[str, ...] = ()
    benchmarks: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()
    hand_in: tuple[str, ...] = ()
    last_sections: tuple[str, ...] = ()
    write_up: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    templates: str = ""


@cache
def wings() -> tuple[Wing, ...]:
    """Ours by name, then those of others.

    Raises:
        UsageError: an entry point that cannot be imported, or is no `Wing`.
    """
    folders = resources.files("wings").iterdir()
    ours = sorted(f.name for f in folders if f.is_dir() and (f / "__init__.py").is_file())
    found = [import_module(f"wings.{name}").wing for name in ours]
    for entry in metadata.entry_points(group=GROUP):
        try:
            wing = entry.load()
        except (ImportError, AttributeError) as fault:
            raise UsageError(f"wing {entry.name} ({entry.value}): {fault}") from fault
        if not isinstance(wing, Wing):
            raise UsageError(f"wing {entry.name} ({entry.value}): not a data.wing.Wing")
        found.append(wing)
    return tuple(found)


def template_folders() -> list[str]:
    """Folders `templates` of wings, for words of the report."""
    return [str(resources.files(wing.templates) / "templates") for wing in wings() if wing.templates]


def of_all(table: str) -> list[Any]:
    """The functions that a table of all wings names."""
    return [used(text) for wing in wings() for text in getattr(wing, table)]


def used(text: str) -> Any:
    """The function that a text `module:function` names."""
    module, _, name = text.partition(":")
    return getattr(import_module(module), name)


def recording_in(folder: Path) -> Recording | None:
    """The kind of recording in a folder without a `log.toml`; None: of no wing."""
    return next((r for wing in wings() for r in wing.recordings if used(r.recognized)(folder)), None)
