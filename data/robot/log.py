"""A recording of the link as a log: the same packets, frames and numbers as while it was recorded.

`--log LOG` opens the folder finished or cut off; `complete` adds the files of an open log, which others can read.
"""

from __future__ import annotations

import os
from pathlib import Path

from data.errors import DataError
from data.log import Log
from data.open_log.writer import contents
from data.robot.frames import Framing, Noise, inputs_of
from data.robot.traffic.exchange import decoded
from data.robot.traffic.recording import PACKETS, read_recording
from data.truth import Truth


def is_recording(folder: Path) -> bool:
    """Whether a folder holds what went over a robot's link."""
    return (folder / PACKETS).exists()


def load_recording(folder: Path) -> Log:
    """The log of a recording, without labels or truth; what was cut off or went wrong on the line is in its notes.

    Raises:
        DataError: it is damaged, or not one packet came over the line.
    """
    recorded = read_recording(folder)
    packets, faults = decoded(recorded.records, framed=recorded.framed)
    if not packets:
        raise DataError.at(folder / PACKETS, f"{len(recorded.records)} records, and no answer of the robot among them")
    framing = Framing(Noise(*recorded.noise))
    frames = [framing.frame(packet) for packet in packets]
    counted = [f"{count} {name}" for name, count in faults.items() if count]
    notes = [f"Faults of the link: {', '.join(counted)}."] if counted else []
    again = sum(not packet.joined for packet in packets[1:])
    if again:
        notes.append(f"Odometry began anew {again} times; how far the robot moved meanwhile is not known.")
    if recorded.cut:
        notes.append(f"The recording was cut off: {recorded.cut} bytes of an unfinished record at its end.")
    return Log(
        folder.absolute().name, inputs_of(frames, framing.at_rest), Truth(), source=recorded.source, notes=tuple(notes)
    )


def complete(folder: Path) -> Log:
    """Add the files of an open log to a recording that has ended, each whole or not at all, `log.toml` last.

    Raises:
        DataError: as of `load_recording`, or a file cannot be written.
    """
    log = load_recording(folder)
    files = contents(log, log.name)
    header = "log.toml"
    try:
        for name in [*(n for n in files if n != header), header]:
            partial = folder / f".{name}.partial"
            partial.write_text(files[name], encoding="utf-8", newline="")
            os.replace(partial, folder / name)
    except OSError as error:
        raise DataError.at(folder, f"cannot be written: {error.strerror}") from error
    return log
