"""Scenarios from TOML files: every key checked, every fault named; the shipped ones are in `eval/scenarios`."""

from __future__ import annotations

import math
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

from data.errors import UsageError
from data.worlds.registry import SIMULATORS, parameters_of
from eval.replay.flag import read_values, rows
from eval.replay.names import ASSOCIATIONS, ESTIMATORS, TASKS
from eval.replay.settings import Setup, check_gates
from eval.studies.published import PUBLISHABLE, Ordering, Published, Row
from eval.studies.scenario import RECORDED, Member, Scenario
from eval.studies.shipped import SCENARIOS, scenarios

CONSISTENT = "consistent"


def load_scenario(name: str) -> Scenario:
    """A shipped scenario by name or any by file; UsageError names what is wrong in it."""
    path = Path(name)
    if name in scenarios():
        path = SCENARIOS / f"{name}.toml"
    elif not path.is_file():
        raise UsageError(f"--scenario {name}: no such file; shipped: {', '.join(scenarios())}, or all")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as fault:
        raise UsageError(f"--scenario {name}: {fault}") from None
    try:
        return _scenario(content, name, path.stem)
    except UsageError as fault:
        raise UsageError(f"--scenario {name}: {fault}") from None


def _known(table: object, where: str, names: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise UsageError(f"{where}: a table is needed")
    for key in table:
        if key not in names:
            raise UsageError(f"{where}: unknown key {key!r}; known: {', '.join(names)}")
    return table


def _of(value: object, kind: type | tuple[type, ...], what: str) -> Any:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        names = {str: "text", int: "a whole number", bool: "true or false", list: "a list", dict: "a table"}
        wanted = "a number" if isinstance(kind, tuple) else names[kind]
        raise UsageError(f"{what} = {value!r}: {wanted} is needed")
    return value


def _names(value: object, what: str, known: tuple[str, ...]) -> tuple[str, ...]:
    names = tuple(_of(value, list, what))
    for n in names:
        if n not in known:
            raise UsageError(f"{what}: {n!r} is unknown; known: {', '.join(known)}")
    if not names or len(set(names)) != len(names):
        raise UsageError(f"{what}: at least one name, and none twice")
    return names


KEYS = ("name", "about", "cite", "runs", "task", "association", "estimators", "world", "setup", "from_frame", "wrong",
        "published")  # fmt: skip


def _scenario(content: dict[str, Any], source: str, stem: str) -> Scenario:
    content = _known(content, "scenario", KEYS)
    for key in ("about", "estimators", "world"):
        if key not in content:
            raise UsageError(f"{key} is missing")
    runs = _of(content.get("runs", 100), int, "runs")
    if runs < 1:
        raise UsageError(f"runs = {runs}: at least 1 is needed")
    task = _names(content.get("task", ["slam"]), "task", TASKS)
    world = dict(_of(content["world"], dict, "world"))
    kind = world.pop("kind", None)
    if kind not in (*SIMULATORS, RECORDED):
        raise UsageError(f"world: kind = {kind!r} is unknown; known: {', '.join((*SIMULATORS, RECORDED))}")
    members = tuple(
        _member(n, table, task, kind) for n, table in _of(content["estimators"], dict, "estimators").items()
    )
    rates = tuple(_of(r, (int, float), "wrong") for r in _of(content.get("wrong", []), list, "wrong"))
    if any(not 0.0 <= r < 1.0 for r in rates) or list(rates) != sorted(set(rates)):
        raise UsageError(f"wrong = {list(rates)}: shares from 0 to below 1, ascending")
    first = _of(content.get("from_frame", 0), int, "from_frame")
    if first < 0:
        raise UsageError(f"from_frame = {first}: must not be negative")
    if not members:
        raise UsageError("estimators: at least one is needed")
    made = Scenario(
        name=_of(content.get("name", stem), str, "name"),
        source=source,
        about=" ".join(_of(content["about"], str, "about").split()),
        cite=" ".join(_of(content.get("cite", ""), str, "cite").split()),
        runs=runs,
        task=task,
        association=_names(content.get("association", ["known"]), "association", ASSOCIATIONS),
        members=members,
        kind=kind,
        values=_parameters(world, kind, "world"),
        setup=_setup(content.get("setup", {})),
        from_frame=first,
        rates=rates,
        published=_published(content["published"], members) if "published" in content else None,
    )
    if not made.recorded:  # the simulator's own checks, before anything runs
        for m in members:
            made.world(m.world)
    return made


def _parameters(table: dict[str, Any], kind: str, where: str) -> tuple[tuple[str, object], ...]:
    """Parameters of a world, checked against the types of its fields; angles that are kept in degrees are converted."""
    if kind == RECORDED:
        return tuple(_known(table, where, ("sha256", "speed_noise")).items())
    known = {f.name: f for f in fields(parameters_of(kind))}
    _known(table, where, tuple(known))
    result = []
    for key, value in table.items():
        like = type(known[key].default)
        real = like in (float, type(None))
        checked = _of(value, (int, float) if real else like, f"{where}: {key}")
        if real:
            checked = float(checked)
            if not math.isfinite(checked):
                raise UsageError(f"{where}: {key} = {value}: a finite number is needed")
            if known[key].metadata.get("unit") == "deg":
                checked = math.radians(checked)
        result.append((key, checked))
    return tuple(result)


def _member(name: str, table: object, task: tuple[str, ...], kind: str) -> Member:
    if name not in ESTIMATORS:
        raise UsageError(f"estimators: {name!r} is unknown; known: {', '.join(ESTIMATORS)}")
    where = f"estimators.{name}"
    given = _known(table, where, ("must_be", "task", "world"))
    if given.get("must_be", CONSISTENT) != CONSISTENT:
        raise UsageError(f"{where}: must_be = {given['must_be']!r}; only {CONSISTENT!r} can be demanded")
    tasks = _names(given.get("task", list(task)), f"{where}: task", task)
    world = _parameters(dict(_of(given.get("world", {}), dict, f"{where}: world")), kind, f"{where}: world")
    return Member(name, tasks if "must_be" in given else (), world)


def _setup(table: object) -> Setup:
    given = _known(table, "setup", tuple(rows(Setup)))
    setup = Setup(**read_values(Setup, given, lambda row: f"setup: {row.name} ="))
    check_gates(setup.gate, setup.new_gate, ("gate =", "setup: new_gate ="))
    return setup


def _published(table: object, members: tuple[Member, ...]) -> Published:
    names = ("skipped_are_zero", "per_dof", "tolerance", "row", "ordering", "note")
    given = _known(table, "published", names)
    known = tuple(m.name for m in members)
    rows = []
    for r in _of(given.get("row", []), list, "published.row"):
        r = _known(r, "published.row", ("estimator", "quantity", "value", "se", "note"))
        for key in ("estimator", "quantity", "value"):
            if key not in r:
                raise UsageError(f"published.row: {key} is missing")
        value, se = (_of(r.get(k, 0.0), (int, float), f"published.row: {k}") for k in ("value", "se"))
        if se < 0:
            raise UsageError(f"published.row: se = {se}: must not be negative")
        rows.append(Row(_member_of(r["estimator"], known), _quantity(r["quantity"]), float(value), float(se)))
    orderings = []
    for o in _of(given.get("ordering", []), list, "published.ordering"):
        o = _known(o, "published.ordering", ("quantity", "smaller", "larger"))
        smaller, larger = (_member_of(o.get(k), known) for k in ("smaller", "larger"))
        orderings.append(Ordering(_quantity(o.get("quantity", "nees_pose")), smaller, larger))
    tolerance = _of(given.get("tolerance", {}), dict, "published.tolerance")
    return Published(
        rows=tuple(rows),
        orderings=tuple(orderings),
        skipped_are_zero=_of(given.get("skipped_are_zero", False), bool, "published: skipped_are_zero"),
        per_dof=_of(given.get("per_dof", False), bool, "published: per_dof"),
        tolerance=tuple((_member_of(k, known), float(v)) for k, v in tolerance.items()),
        note=" ".join(_of(given.get("note", ""), str, "published: note").split()),
    )


def _member_of(name: object, known: tuple[str, ...]) -> str:
    if name not in known:
        raise UsageError(f"published: estimator {name!r} is not one of the scenario's: {', '.join(known)}")
    return str(name)


def _quantity(name: object) -> str:
    if name not in PUBLISHABLE:
        raise UsageError(f"published: quantity {name!r} is unknown; known: {', '.join(PUBLISHABLE)}")
    return str(name)
