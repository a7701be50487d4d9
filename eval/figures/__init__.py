"""Every figure a report can use: functions that take data and return a `Figure`; none is shown.

A figure of a log is a function with the decorator `eval.figures.kinds.figure`, and two macros in
`templates/pictures.md.j2`: its caption, and what it shows for those who cannot see it.
"""

import re
from pathlib import Path

_CAPTIONS = (Path(__file__).parent / "templates" / "pictures.md.j2").read_text(encoding="utf-8")
FIGURES = tuple(name.replace("_", "-") for name in re.findall(r"macro figure_(\w+)_alt\(", _CAPTIONS))
"""Names of the figures of a log, in the order of the report; flags name them before matplotlib is loaded."""
