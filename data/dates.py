"""Dates and times of day as stamps."""

import re
from datetime import UTC, datetime

DATE = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d{8}(?=T)|\d{4}-?W\d\d|\d\d?-[A-Za-z]{3}-\d{4}|\d\d?:\d\d:\d\d)(\D|$)"
)  # How they begin
ISO = "iso"  # Unit of time of dates
EXAMPLE = "2024-05-01T12:00:00.5"
IN_SECONDS = "in s since 1970 (UTC where no zone is written; times of day since midnight)"


def is_date(field: str) -> bool:
    """Whether a field looks like a date or a time of day."""
    return DATE.match(field) is not None


def seconds_of(field: str) -> float:
    """Seconds since 1970 of a date, as 2024-05-01T12:00:00.5, 2024/5/1 12:00 or 01-May-2024 12:00:00; since midnight of
    a time of day. UTC without a zone; ValueError for anything else.
    """
    if day := re.fullmatch(r"(\d\d?):(\d\d):(\d\d(?:\.\d*)?)", field):
        return 3600.0 * int(day[1]) + 60.0 * int(day[2]) + float(day[3])
    if named := re.match(r"\d\d?-[A-Za-z]{3}-\d{4}", field):
        field = datetime.strptime(named[0], "%d-%b-%Y").strftime("%Y-%m-%d") + field[named.end() :]
    elif dashed := re.match(r"(\d{4})[-/.](\d\d?)[-/.](\d\d?)", field):
        field = f"{dashed[1]}-{int(dashed[2]):02d}-{int(dashed[3]):02d}" + field[dashed.end() :]
    date = datetime.fromisoformat(field)
    return (date if date.tzinfo is not None else date.replace(tzinfo=UTC)).timestamp()
