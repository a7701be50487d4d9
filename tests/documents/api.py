"""docs/api.md, out of the signatures and docstrings of the public names."""

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import slamref
from eval.plan.flags.table import HELP

GROUPS = {
    "Logs and runs": "open_log Log compare Setup make_estimator", "Association": "decide Expectation NEW DISCARD",
    "Scores": "Trial score judge Judgement score_files notices Notice sentence",
    "Many logs, and logs without ground truth": "study Study twins Diagnosis", "Factor graphs": "audit",
    "Your own code": "Samples check_estimator check_association estimator_findings association_findings",
}  # fmt: skip
CONSTANTS = {
    "NEW": "The decision about an observation that initializes a landmark.",
    "DISCARD": "The decision about an observation that no estimator uses.",
}
WIDTH = 88
FIELD = r"(?m)^    # (.*)\n    (\w+): |^    (\w+): .*  # (.*)"  # and its comment, above or behind


def written(thing: Callable[..., object]) -> dict[str, str]:
    """Annotations of a function, or of a class's fields and constructor, as its source has them."""
    found: dict[str, str] = {}
    for each in reversed(thing.__mro__) if isinstance(thing, type) else [thing]:
        try:
            (node,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        except (OSError, TypeError):  # of no source: object, tuple
            continue
        for n in ast.walk(node):
            if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name) and isinstance(thing, type):
                found.setdefault(n.target.id, ast.unparse(n.annotation))
            elif isinstance(n, ast.FunctionDef) and n.name == ("__init__" if isinstance(thing, type) else node.name):
                arguments = (*n.args.posonlyargs, *n.args.args, *n.args.kwonlyargs, n.args.vararg, n.args.kwarg)
                found |= {p.arg: ast.unparse(p.annotation) for p in arguments if p is not None and p.annotation}
                found |= {"return": ast.unparse(n.returns)} if n.returns else {}
    return {name: kind.replace("'", '"') for name, kind in found.items()}


def signature(name: str, thing: Callable[..., object], width: int = WIDTH) -> str:
    """The call of a function, method or class, one parameter a line where it is wider than `width`."""
    shown, kinds, keyword_only = [], written(thing), False
    for p in inspect.signature(thing).parameters.values():
        if p.name == "self":
            continue
        if p.kind is p.KEYWORD_ONLY and not keyword_only:
            shown.append("*")
            keyword_only = True
        star = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        annotation = f": {kinds[p.name]}" if p.name in kinds else ""
        default = "" if p.default is p.empty else f" = {value(p.default)}"
        shown.append(f"{star}{p.name}{annotation}{default}")
    arrow = "" if isinstance(thing, type) or "return" not in kinds else f" -> {kinds['return']}"
    line = f"{name}({', '.join(shown)}){arrow}"
    broken = "".join(f"    {part},\n" for part in shown)
    return line if len(line) <= width else f"{name}(\n{broken}){arrow}"


def value(default: object) -> str:
    if isinstance(default, str | int | float | tuple | type(None)):
        return repr(default).replace("'", '"')
    made = type(default).__name__
    return "..." if callable(default) or made.startswith("_") else f"{made}()"


def sections(doc: str) -> Iterator[tuple[str, str]]:
    heading, lines = "", list[str]()
    for line in doc.splitlines():
        if re.fullmatch(r"(Args|Returns|Raises|Example):", line):
            yield heading, "\n".join(lines).strip("\n")
            heading, lines = line[:-1], []
        else:
            lines.append(line)
    yield heading, "\n".join(lines).strip("\n")


def described(doc: str) -> Iterator[str]:
    for heading, text in sections(doc):
        if heading == "":
            yield text
        elif heading == "Example":
            code = re.sub(r"^(>>>|\.\.\.) ?", "", inspect.cleandoc(text), flags=re.MULTILINE)
            code = re.sub(r"^(import \w+)\n", r"\1\n\n", code)  # as `ruff format` has it
            yield f"```python\n{code}\n```"
        elif heading == "Returns":
            yield f"Returns: {' '.join(text.split())}"
        else:
            items = re.split(r"\n(?=\S)", inspect.cleandoc(text))
            pairs = [re.match(r"(?s)([\w, `*]+): (.*)", item) for item in items]
            listed = "\n".join(f"* `{p[1]}`: {' '.join(p[2].split())}" for p in pairs if p)
            yield f"{heading}:\n\n{listed}"


def methods(thing: type) -> Iterator[tuple[str, str]]:
    inherited = {f.name for f in fields(thing)} if is_dataclass(thing) else set()
    for name, member in vars(thing).items():
        if name.startswith("_") or name in inherited:
            continue
        plain = getattr(member, "__func__", getattr(member, "fget", None) or getattr(member, "func", None) or member)
        doc = inspect.getdoc(plain)
        if doc and callable(plain) and not isinstance(plain, type):
            called = signature(name, getattr(thing, name), 9999) if callable(getattr(thing, name)) else name
            keys = re.search(r"(?s)\n    more: (.*?)\n\n", doc)  # of `**more`
            yield called, " ".join([*doc.partition("\n\n")[0].split(), *(f"`more`: {keys[1]}" if keys else "").split()])


def members(thing: type) -> Iterator[str]:
    held = getattr(thing, "__dataclass_fields__", {}).values()
    told = {f.name: HELP[f.name] for f in held if "flag" in f.metadata}
    told |= {a or c: b or d for b, a, c, d in re.findall(FIELD, inspect.getsource(thing))}
    for title, listed in ("Attributes", told.items()), ("Methods", methods(thing)):
        if rows := [f"* `{name}`: {about}" for name, about in listed]:
            yield f"{title}:\n\n" + "\n".join(rows)


def entry(name: str) -> Iterator[str]:
    thing = getattr(slamref, name)
    yield f"### {name}"
    if name in CONSTANTS:
        yield f"`{name} = {thing}`. {CONSTANTS[name]}"
        return
    yield f"```python\n{signature(name, thing)}\n```"
    yield from described(inspect.getdoc(thing) or "")
    if isinstance(thing, type):
        yield from members(thing)


def page() -> str:
    parts = [Path(__file__).with_name("api.md").read_text(encoding="utf-8").rstrip()]
    for title, names in GROUPS.items():
        parts += [f"## {title}", *(part for name in names.split() for part in entry(name))]
    return "\n\n".join(parts) + "\n"
