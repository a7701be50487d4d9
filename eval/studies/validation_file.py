"""Studies of the battery from TOML files, `study = "validation"` at the top; every key checked, every fault named."""

from __future__ import annotations

from data.errors import UsageError
from data.toml_table import TomlTable, load_toml
from data.worlds.registry import SIMULATORS
from eval.replay.names import TASKS
from eval.studies.broken import BROKEN
from eval.studies.faults import FAULTS
from eval.studies.scenario_file import paragraph, parameters, parameters_of_kind
from eval.studies.shipped import path_of
from eval.studies.trusted import FEWEST
from eval.studies.validation import Validation, World

VALIDATION = "validation"
KNOWN = {
    "": ("study", "name", "about", "runs", "twins", "worlds", "power"),
    "power": ("world", "runs", "faults", "broken"),
}
"""Keys of each table; those of a world are `kind`, `name`, `task` and the parameters of its kind."""


def load_validation(name: str) -> Validation | None:
    """A study of the battery, shipped or by file; None where the file is missing or of another kind of study.

    UsageError names what is wrong in it.
    """

    def fault(what: str) -> UsageError:
        return UsageError(f"--scenario {name}: {what}")

    path = path_of(name)
    table = load_toml(path, fault) if path.is_file() else {}
    if table.get("study") is None:
        return None
    top = TomlTable(fault, table, KNOWN)
    top.one_of("study", (VALIDATION,))
    worlds = tuple(_world(t) for t in top.tables_of("worlds"))
    names = [w.name for w in worlds]
    if not worlds or len(set(names)) < len(names):
        raise fault("[[worlds]]: at least one is needed, and none of the same name")
    power = top.optional_table("power")
    if power is None:
        power = TomlTable(fault, {"runs": 0}, {})
    try:
        for world in worlds:
            world.parameters()
    except UsageError as wrong:  # the simulator's own checks, before anything runs
        raise fault(str(wrong)) from None
    where = power.one_of("world", names, names[0])
    task = worlds[names.index(where)].task
    fitting = tuple(name for name, broken in BROKEN.items() if task in broken.tasks)
    return Validation(
        name=top.text("name", path.stem),
        source=name,
        about=paragraph(top.text("about")),
        worlds=worlds,
        runs=top.whole("runs", 200, least=1),
        twins=top.whole("twins", 39, least=FEWEST),
        power=where,
        power_runs=power.whole("runs", 20, least=0),
        faults=power.names("faults", tuple(FAULTS), tuple(FAULTS)),
        broken=power.names("broken", fitting, fitting),
    )


def _world(table: TomlTable) -> World:
    kind = table.one_of("kind", tuple(SIMULATORS))
    own = ("kind", "name", "task")
    checked = TomlTable(table.fault, table.table, {"worlds": (*own, *parameters_of_kind(kind))}, "worlds")
    values = {key: value for key, value in checked.table.items() if key not in own}
    return World(
        name=checked.text("name", kind),
        kind=kind,
        task=checked.one_of("task", TASKS, "slam"),
        values=parameters(TomlTable(table.fault, values, {}, "worlds"), kind),
    )
