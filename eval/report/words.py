"""Words: the only place where facts become sentences, from the templates beside it, for terminal, Markdown and HTML.

A template gets facts (dataclasses, numbers, names) and gives Markdown. What a template does not find is an error.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from data.notice import Notice
from data.terminal import counted
from eval.report.page.tables import number

NOTICES = "notices.j2"
"""A macro for each `Code`, its dashes as underscores; it gets the notice."""


@cache
def environment() -> Environment:
    """All templates, with the filters that numbers and counts need."""
    # Markdown, not HTML: the page escapes what it renders
    env = Environment(
        loader=PackageLoader("eval.report", "templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=False,
        autoescape=False,
    )
    env.filters |= {"number": number, "counted": counted, "percent": percent}
    return env


def template_text(name: str) -> str:
    """A file of `templates/` as it is, not rendered."""
    env = environment()
    assert env.loader is not None
    return env.loader.get_source(env, name)[0]


def percent(share: float, digits: int = 1) -> str:
    """A share in percent, with so many decimals and the sign."""
    return f"{100.0 * share:.{digits}f} %"


def say(template: str, facts: object = None, **more: Any) -> str:
    """A template of `templates/` (its name without `.md.j2`), rendered with the fields of `facts` and what is named.

    A name behind `#` is that of a macro in it, called with the same names as arguments: `say("answer#lost", row=row)`.
    Empty lines around the text are removed.
    """
    name, _, macro = template.partition("#")
    known = {f.name: getattr(facts, f.name) for f in fields(facts)} if is_dataclass(facts) else {}
    found = environment().get_template(f"{name}.md.j2")
    text = getattr(found.module, macro)(**known, **more) if macro else found.render(**known, **more)
    return str(text).strip()


def sentence(notice: Notice) -> str:
    """A notice in words, without a full stop and without whom it is about."""
    macro = getattr(environment().get_template(NOTICES).module, notice.code.replace("-", "_"))
    return str(macro(notice, **notice.named)).strip()
