"""The table fault -> caught by: its rows, and how the outcome of a test run is written into it."""

from __future__ import annotations

from collections.abc import Mapping

from tests.mutation import in_the_association, in_the_data, in_the_filter, in_the_referee, in_the_smoother
from tests.mutation.faults import Fault

WHERE = (in_the_filter, in_the_smoother, in_the_association, in_the_data, in_the_referee)
FAULTS: tuple[Fault, ...] = tuple(
    sorted((fault for module in WHERE for fault in module.FAULTS), key=lambda fault: fault.trap or 99)
)
WIDTH = 170


def label(fault: Fault) -> str:
    """What names a row: fault and check."""
    return f"{fault.what} -> {fault.check.name}"


def lines(said: Mapping[str, str]) -> list[str]:
    """A line for each fault; `said` is what the failing check said, by label; empty: the test failed."""
    table, wide = [], max(len(fault.what) for fault in FAULTS)
    for fault in FAULTS:
        number = "-" if fault.trap is None else str(fault.trap)
        words = said.get(label(fault), "not run") or "NOT CAUGHT, OR NOT TRUE WITHOUT THE FAULT"
        outcome = f"{fault.check.name}: {words}"
        line = f"{number:>4}  {fault.what:<{wide}}  ->  {outcome}"
        table.append(line if len(line) <= WIDTH else f"{line[: WIDTH - 3]}...")
    return table
