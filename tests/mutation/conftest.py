"""Prints the table fault -> caught by at the end of a run of this suite."""

from __future__ import annotations


def pytest_terminal_summary(terminalreporter):
    said = {}
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            noted = dict(report.user_properties)
            if report.when == "call" and "fault" in noted:
                said[noted["fault"]] = noted.get("said", "")
    if said:
        from tests.mutation.table import lines  # not needed where no fault was put in

        terminalreporter.section("trap  fault  ->  caught by")
        for line in lines(said):
            terminalreporter.write_line(line)
