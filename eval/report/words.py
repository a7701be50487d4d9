"""Words of a report: where the facts of a section become text, from `templates/`; of notices see `data.words`."""

import math
import re
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import ChoiceLoader, Environment, FileSystemLoader

from data import words
from data.notice import Notice, Severity
from data.result import Failure
from data.wing import wings
from data.words import number, sentence, title
from eval.figures.figure_style import tex_escape
from eval.report.page.blocks import FinePrint
from eval.report.page.files import interval

GREEK: dict[str, str | int | None] = {"ω": r"$\omega$", "φ": r"$\varphi$", "ψ": r"$\psi$", "Δ": r"$\Delta$"}


@cache
def environment() -> Environment:
    """The templates of the report, with more filters than notices need."""
    env = words.environment("eval.report")
    assert env.loader is not None
    folders = [files("eval.figures") / "templates", *(files(w.templates) / "templates" for w in wings() if w.templates)]
    env.loader = ChoiceLoader([env.loader, *(FileSystemLoader(str(folder)) for folder in folders)])
    env.globals["zip"] = zip
    filters = (interval, as_sentence, one_line, listed, plus_minus, sized, distance, six, tex)
    env.filters |= {f.__name__: f for f in filters}
    env.tests["known"] = math.isfinite
    return env


def template_text(name: str) -> str:
    """A file of `templates/` as it is, not rendered."""
    env = environment()
    assert env.loader is not None
    return env.loader.get_source(env, name)[0]


def one_line(text: str) -> str:
    """Words that a template broke over several lines, on one."""
    return re.sub(r"[ \n]+", " ", text).strip()


def as_sentence(text: str) -> str:
    """Words on one line, capital first and full stop last; a name in code stays as it is, nothing stays nothing."""
    line = one_line(text)
    return f"{line[:1].upper()}{line[1:]}" + ("." if line and not line.endswith(".") else "")


def listed(parts: Iterable[str], last: str = "and") -> str:
    """`a, b and c`; one alone as it is."""
    *first, end = parts
    return f"{', '.join(first)} {last} {end}" if first else end


def plus_minus(value: float, error: float) -> str:
    """A number and its standard error, this to two digits and both to the same decimals; without an error, to three."""
    if not (math.isfinite(error) and error > 0.0):
        return number(value).replace("-", "−")
    places = max(1 - math.floor(math.log10(error)), 0)
    return f"{value:.{places}f} ± {error:.{places}f}".replace("-", "−")


def sized(value: float, unit: str, error: float = math.nan, digits: int = 3) -> str:
    """A size in its unit, with its standard error to one digit; without an error to so many digits."""
    space = "" if unit == "°" else " "
    if not (math.isfinite(error) and error > 0.0):
        return f"{number(value, digits)}{space}{unit}"
    # two digits of an error that begins with 1: half of it would be lost in rounding
    exponent = math.floor(math.log10(error))
    places = max(-exponent + (error < 1.95 * 10.0**exponent), 0)
    return f"{value:.{places}f}{space}{unit} ± {error:.{places}f}{space}{unit}"


def six(value: float) -> str:
    """Six significant digits; counts as they are."""
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e6 else f"{value:.6g}"


def tex(text: str) -> str:
    """Words as LaTeX sets them, Greek letters in math mode."""
    return tex_escape(text).translate(str.maketrans(GREEK))


def distance(metres: float) -> str:
    """A distance, below a centimetre in millimetres."""
    return f"{number(1000.0 * metres, 2)} mm" if 0.0 < metres < 0.01 else f"{number(metres)} m"


def say(template: str, facts: object = None, **more: Any) -> str:
    """A template of `templates/` rendered with the fields of `facts` and `more`, or a macro in it: `answer#lost`."""
    name, _, macro = template.partition("#")
    known = {f.name: getattr(facts, f.name) for f in fields(facts)} if is_dataclass(facts) else {}
    found = environment().get_template(f"{name}.md.j2")
    return str(getattr(found.module, macro)(**known, **more) if macro else found.render(**known, **more)).strip()


def paragraph(template: str, facts: object = None, **more: Any) -> str:
    """What `say` says as one paragraph: its sentences may stand on lines of their own in the template."""
    return one_line(say(template, facts, **more))


def fine_print(title: str) -> FinePrint:
    """What captions leave to the section on reading: the macro of `reading.md.j2` that is called as the title is."""
    return FinePrint(title, paragraph(f"reading#{re.sub(r'[^a-z0-9]+', '_', title.lower())}"))


def together(found: Iterable[Notice]) -> list[Notice]:
    """Each notice once: estimators of one log, task and association that have it are named together. Numbers about a
    source of fixes or closures are those of the first estimator.
    """
    first: dict[Hashable, Notice] = {}
    names: dict[Hashable, list[str]] = {}
    for n in found:
        of = n.named
        about_source = (n.code, n.log, n.task, n.association, of["source"], of["kind"]) if "source" in of else None
        key = about_source or n.about(estimator="")
        first.setdefault(key, n)
        names.setdefault(key, []).append(n.estimator)
    return [n.about(estimator=", ".join(dict.fromkeys(names[key]))) for key, n in first.items()]


Flaws = Mapping[tuple[str, str, str, str], Failure]
"""Why runs, named by log, task, estimator and association, stopped or are implausible."""
LOST = "lost"


def status_of(notice: Notice, flaws: Flaws) -> str:
    """What an error says of its run: the status of its flaw, or `LOST`; empty for other notices."""
    if notice.severity is not Severity.ERROR:
        return ""
    flaw = flaws.get(notice.run)
    return LOST if flaw is None or flaw.notice.code is not notice.code else flaw.status


def whose(notice: Notice) -> str:
    """The log, task and runs that it is about."""
    place = ", ".join(part for part in (notice.log, notice.task, notice.association) if part)
    return f"{place}: {notice.estimator}" if notice.estimator else place


def described(notice: Notice) -> str:
    """The runs that it is about, and the sentence."""
    return ": ".join(filter(None, (whose(notice), sentence(notice))))


def asked(notice: Notice, status: str = "") -> str:
    """A warning or an error as the terminal shows it; `status` of a run that stopped, is implausible or lost."""
    if status:
        since = "from" if status in ("implausible", LOST) else "at"
        return f"{whose(notice)} {status} {since} frame {notice.frame}: {sentence(notice)}"
    return f"{notice.severity}: {sentence(notice)} ({whose(notice).replace(': ', ', ')}, {title(notice)})"


def of_runs(found: Iterable[Notice]) -> list[str]:
    """A sentence for each, with the runs of one log in front that it is about."""
    said = []
    for n in together(found):
        method = f" ({n.association})" if n.association else ""
        said.append(f"{n.estimator}{method}: {sentence(n)}" if n.estimator else sentence(n))
    return [text if text.endswith((".", "?", "!")) else f"{text}." for text in said]
