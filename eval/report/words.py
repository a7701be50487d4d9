"""Words of a report: where the facts of a section become text, from `templates/`, for terminal, Markdown and HTML.

A template gets facts (dataclasses, numbers, names) and gives Markdown. What a template does not find is an error.
Notices have their words in `data.words`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any

from jinja2 import Environment

from data import words
from data.words import number


@cache
def environment() -> Environment:
    env.globals["zip"] = zip
