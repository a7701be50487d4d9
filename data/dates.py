"""Dates and times of day as stamps."""

import re
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from data.errors import DataError

DATE = re.compile(
    r"(\d{4}[-/.:]\d\d?[-/.:]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d{8}(?=T)|\d{4}-?W\d\d|\d\d?-[A-Za-z]{3}-\d{4}|\d\d?:\d\d:\d\d)(\D|$)"
)  # How they begin
LAST = re.compile(r"^(\d\d?)[-/.](\d\d?)[-/.](\d{4})(?!\d)")  # with the year behind day and month
ISO, DMY, MDY = DATES = ("iso", "dmy", "mdy")  # Units of time of dates; by the order of day and month before a year
EXAMPLE = "2024-05-01T12:00:00.5"
IN_SECONDS = "in s since 1970 (UTC where no zone is written; times of day since midnight)"


def is_date(field: str) -> bool:
    """Whether a field looks like a date or a time of day."""
    return DATE.match(field) is not None


WITHIN = re.compile(
    r"(?<!\d)(20\d\d)\D?(0[1-9]|1[0-2])\D?(0[1-9]|[12]\d|3[01])\D?([01]\d|2[0-3])\D?([0-5]\d)\D?([0-5]\d)"
    r"(?:\D?(\d{1,3}|\d{6}|\d{9}))?(?!\d)|(?<!\d)(1\d{9})[._]?(\d{3}|\d{6}|\d{9}|(?<=\.)\d+)?(?!\d)"
)  # A date, a time of day and thousandths; or seconds since 1970 and a part of one


def within(word: str) -> str:
    """The date and time of day, or the stamp since 1970, in a word, such as an image's name, as in `EXAMPLE`."""
    found = WITHIN.search(word)
    if found is None or re.fullmatch(r"[-+.:/\d TZWAPMapmeE]*", word):  # a date, or a number
        return ""
    if found[8]:
        return datetime.fromtimestamp(float(f"{found[8]}.{found[9] or 0}"), UTC).isoformat()
    return "{}-{}-{}T{}:{}:{}.{:0>3}".format(*found.groups("0")[:7])


def whole_dates(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows whose only column of days has the only times of day behind it; of several days the times are both, too.
    Dates within words that ascend with the rows stand for these words.
    """
    for k in (k for k, field in enumerate(rows[0]) if within(field)):
        each = [within(row[k]) for row in rows]
        if all(each) and each == sorted(each) and each[0] != each[-1]:
            rows = [(*row[:k], date, *row[k + 1 :]) for row, date in zip(rows, each, strict=True)]
    days = [k for k, field in enumerate(rows[0]) if is_date(field) and ":" not in field]
    times = [k for k, field in enumerate(rows[0]) if is_date(field) and ":" in field[:3]]
    if len(days) != 1 or len(times) != 1:
        return rows
    (d,), (t,) = days, times
    whole = (d, t) if len({row[d] for row in rows}) > 1 else (d,)
    both = [f"{row[d]} {row[t]}" if row[d] and row[t] else "" for row in rows]
    return [tuple(b if k in whole else f for k, f in enumerate(row)) for row, b in zip(rows, both, strict=True)]


def unit_of(path: Path, fields: Iterable[str], right: str) -> str:
    """`ISO`, or the order of day and month that a number above 12 tells; DataError with what is `right` if none."""
    last = [m for field in fields if (m := LAST.match(field))]
    day, month = (any(int(m[k]) > 12 for m in last) for k in (1, 2))
    if last and day == month:
        raise DataError.at(path, f"{last[0][0]}: day or month first? {right} needed")
    return ISO if not last else DMY if day else MDY


def seconds_of(field: str, unit: str = ISO) -> float:
    """Seconds since 1970 of a date, as 2024-05-01T12:00:00.5, 2024/5/1 12:00, 01-May-2024 12:00:00 or by its unit
    1/5/2024 1:00 PM; since midnight of a time of day. UTC without a zone; ValueError for anything else.
    """
    if unit != ISO:
        field = LAST.sub(r"\3-\2-\1" if unit == DMY else r"\3-\1-\2", field)
    if half := re.fullmatch(r"(|.*?\D)(\d\d?)(:.*\d) ?([AaPp])[Mm]", field):
        field = f"{half[1]}{int(half[2]) % 12 + 12 * (half[4] in 'Pp'):02d}{half[3]}"
    if day := re.fullmatch(r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)", field):
        return 3600.0 * int(day[1]) + 60.0 * int(day[2]) + float(day[3])
    if named := re.match(r"\d\d?-[A-Za-z]{3}-\d{4}", field):
        field = datetime.strptime(named[0], "%d-%b-%Y").strftime("%Y-%m-%d") + field[named.end() :]
    elif dashed := re.match(r"(\d{4})[-/.:](\d\d?)[-/.:](\d\d?)", field):
        field = f"{dashed[1]}-{int(dashed[2]):02d}-{int(dashed[3]):02d}" + field[dashed.end() :]
    date = datetime.fromisoformat(re.sub(r" +(?=\d:)", " 0", field))
    return (date if date.tzinfo is not None else date.replace(tzinfo=UTC)).timestamp()
