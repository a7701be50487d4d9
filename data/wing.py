"""What a wing adds to the core: commands, names of the Python API, kinds of logs, sections of the report, and so on.

The core imports no wing. It asks `wings()` for tables of texts `module:function`, and imports what it uses. Ours are
the folders of the package `wings`; those of others are entry points of the group `slamref.wings`.
"""

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
    """A world and its texts."""

    module: str  # with its function `simulate(parameters, seed, name)`
    parameters: str  # in that module, the dataclass of its parameters; a field's metadata `help` is its flag's
    example: str  # names of its logs
    help: str = ""  # of its kind of `python -m data.convert`; empty if that writes something else
    counts: tuple[str, ...] = ()  # further keys of its names, whole numbers from 1 up that are no parameters
    opens: str = ""  # of a world with images, function of (name, reading, say) that opens a log; blank: `simulate`


@dataclass(frozen=True)
class Recording:
    """A kind of file, or of folder without a `log.toml`, that is a log."""

    recognized: str  # function of (path) that says whether it is one
    opens: str  # function of (path, reading, say)
    kind: str  # of `python -m data.convert`
    what: str  # in a message
    # function of (paths in a folder, say) that gives those it knows, with their loaders (None: of no log of its own);
    # blank: `slamref run --data` does not search for them
    found: str = ""


@dataclass(frozen=True)
class Wing:
    """One wing; every text is `module:function`, imported when it is used."""

    name: str  # of its folder, or entry point
    # subcommands of `slamref`: function of (arguments, name of the command), and what it does
    commands: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    api: Mapping[str, str] = field(default_factory=dict)  # names of the Python API, and their modules
    worlds: Mapping[str, World] = field(default_factory=dict)  # simulated worlds by name
    # functions of (path) that open a folder with a `log.toml` if it is one of theirs, else return None
    logs: tuple[str, ...] = ()
    recordings: tuple[Recording, ...] = ()  # kinds of files, and of folders without one
    conversions: tuple[str, ...] = ()  # modules of kinds of `python -m data.convert`, as its `SOURCES`
    questions: tuple[str, ...] = ()  # functions of (log) that give notices for its author
    # functions of (inputs, task, estimators, association, setup, judge) that give the runs of `compare`, or None for
    # what is not theirs
    replays: tuple[str, ...] = ()
    kernels: Mapping[str, str] = field(default_factory=dict)  # parts to compile, by name: functions without arguments
    # functions of (run, log, phase) that give columns of `association.csv`, of runs that decide about something else
    # than observations, or None
    outcomes: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()  # functions of (trial, trials) that give notices about a trial's runs
    # functions of (pack, key, run, trial, step) that add a run's loops to the player, and give their states
    player: tuple[str, ...] = ()
    # functions of (trials of a player, all trials) that give other robots for it, or None; their `add(pack, (key,
    # trial, run) of each run, step)` adds them and gives their header
    company: tuple[str, ...] = ()
    files: tuple[str, ...] = ()  # functions of (folder, trial) that write files about a log
    run_files: tuple[str, ...] = ()  # functions of (folder of a run, output, trial, run) that write files about a run
    # kinds of figures of a trial, by name (`eval.report.pictures.Kind`)
    figures: Mapping[str, str] = field(default_factory=dict)
    # functions of (name, log) that give an image of each frame, PNG; none of a log that is not theirs
    images: tuple[str, ...] = ()
    # functions of (folder, output, trial) that give sections of the report on one log and task
    log_sections: tuple[str, ...] = ()
    sections: tuple[str, ...] = ()  # functions of (folder, output, trials, pictures of each, in_lab, factor): sections
    plans: tuple[str, ...] = ()  # functions of (name, estimators, setup, reading, say) to the experiments of `--lab`
    # functions of (name, selection, setup, reading, say) that give the experiments of `--cooperative`
    teams: tuple[str, ...] = ()
    # functions of (folder, options, trials, scores, unfinished) that give sections that come first
    hand_in: tuple[str, ...] = ()
    # functions of (folder, trials, scores, sections of `hand_in`, other sections) of `--write-up`
    write_up: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()  # functions of (options, trials) to settings by log, kept in `provenance.json`
    templates: str = ""  # package with a folder `templates` of words of the report; blank: none


@cache
def wings() -> tuple[Wing, ...]:
    """Ours by name, then those of others. UsageError: an entry point that cannot be imported, or is no `Wing`."""
    ours = sorted(f.name for f in resources.files("wings").iterdir() if f.is_dir() and (f / "__init__.py").is_file())
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


def of_all(table: str) -> list[Any]:
    """The functions that a table of all wings names."""
    return [used(text) for wing in wings() for text in getattr(wing, table)]


def by_name(table: str) -> dict[str, Any]:
    """As `of_all`, of a table with names."""
    return {name: used(text) for wing in wings() for name, text in getattr(wing, table).items()}


def used(text: str) -> Any:
    """The function that a text `module:function` names."""
    module, _, name = text.partition(":")
    return getattr(import_module(module), name)


def recordings() -> list[Recording]:
    """The kinds of recordings of all wings."""
    return [recording for wing in wings() for recording in wing.recordings]


def recording_in(path: Path) -> Recording | None:
    """The kind of recording that a file is, or a folder without a `log.toml`; None: of no wing."""
    return next((r for r in recordings() if used(r.recognized)(path)), None)
