"""Equations of the course, `$...$` and `$$...$$` in LaTeX, become MathML, which browsers draw without any script."""

import re
from typing import Any

from latex2mathml.converter import convert

CODE = re.compile(r"(^```.*?^```$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)
EQUATION = re.compile(r"\$\$(.+?)\$\$|\$([^$\n]+)\$", re.DOTALL)


def drawn(equation: re.Match[str]) -> str:
    """An equation in MathML, on lines of its own where it has two dollars."""
    latex = (equation[1] or equation[2]).replace("pmatrix", "matrix")  # site.css draws the parentheses
    made = convert(latex.strip(), display="block" if equation[1] else "inline")
    return f'<div class="equation">{made}</div>' if equation[1] else f"<span>{made}</span>"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Called by mkdocs for each page."""
    if not page.file.src_uri.startswith("course/"):
        return markdown
    return "".join(part if CODE.fullmatch(part) else EQUATION.sub(drawn, part) for part in CODE.split(markdown))
