"""Grading for instructors: functions of students against the references, on seeds that the instructor chooses."""

from pathlib import Path

from data.wing import Wing

HERE = Path(__file__).parent
wing = Wing(
    "grade", commands={"grade": ("wings.grade.command:main", "grade a student's functions, or a whole class")},
    templates="wings.grade",
)  # fmt: skip


def handout(assignment: str) -> tuple[str, str]:
    """The sheet of an assignment, and the skeleton of a program on it."""
    sheet = (HERE / f"handouts/{assignment}.md").read_text(encoding="utf-8")
    return sheet, sheet.partition("```python\n")[2].partition("```")[0]
