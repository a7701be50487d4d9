"""The words of notices, for terminal, Markdown, HTML and CSV alike."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from data.notice import Notice
from data.terminal import counted

if TYPE_CHECKING:
    from jinja2 import Environment
    from jinja2.bccache import Bucket

NOTICES = "notices.j2"  # A macro for each `Code`, with underscores for dashes, of the notice and its values by name


@cache
def environment(package: str) -> Environment:
    """The templates of a package's folder `templates`, with filters for numbers and counts."""
    from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined

    class Cache(FileSystemBytecodeCache):
        """Compiled templates beside the modules; none where that folder cannot be written to."""

        def dump_bytecode(self, bucket: Bucket) -> None:
            with suppress(OSError):
                super().dump_bytecode(bucket)

    # Markdown: the page escapes what it renders
    env = Environment(
        loader=PackageLoader(package, "templates"), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=False, autoescape=False,
        bytecode_cache=Cache(str(Path(__file__).parent / "__pycache__")),
    )  # fmt: skip
    env.filters |= {
        "number": number, "counted": counted, "percent": percent, "degrees": math.degrees, "said": sentence,
        "told_apart": told_apart,
    }  # fmt: skip
    return env


def sentence(notice: Notice) -> str:
    """A notice in words, without its log or run and without a full stop.

    Example:
        >>> for n in slamref.notices([trial]):
        ...     print(n.log, n.estimator, slamref.sentence(n))
    """
    macro = getattr(environment("data").get_template(NOTICES).module, notice.code.replace("-", "_"))
    return str(macro(notice, **notice.named)).strip()


def title(notice: Notice) -> str:
    """The subject of a notice in a word or two."""
    return notice.code.replace("-", " ")


def number(value: float, digits: int = 3) -> str:
    """A number with `digits` significant digits, without exponent between 1e-4 and 1e6."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    rounded = float(f"{value:.{digits - 1}e}")  # 99.96 has the digits of 100
    return f"{value:.{max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)}f}"


def percent(share: float, decimals: int | None = None) -> str:
    """A share in percent, as tables have it: with three significant digits, or so many decimals."""
    return f"{number(100.0 * share) if decimals is None else f'{100.0 * share:.{decimals}f}'} %"


def told_apart(values: tuple[float, float]) -> tuple[str, str]:
    """Two numbers with as many decimals as give their difference three digits."""
    digits = max(0, 2 - math.floor(math.log10(abs(values[1] - values[0]))))
    return f"{values[0]:.{digits}f}", f"{values[1]:.{digits}f}"


def table_html(title: str, rows: Iterable[Iterable[str]]) -> str:
    """A table of texts under its title, for a notebook."""
    cells = ("".join(f"<td style='text-align:left'>{escape(text)}</td>" for text in row) for row in rows)
    return f"<div><b>{escape(title)}</b><table>{''.join(f'<tr>{row}</tr>' for row in cells)}</table></div>"
