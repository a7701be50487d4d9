"""Logs with images: `visual:SEED` is rendered, a folder in the lab's format is read; pictures are detected in both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from data.log import Log
from data.logs import Reading
from data.pictures import Found, InView, VisualRecording
from data.terminal import counted
from data.worlds import registry
from wings.camera.gallery import Gallery
from wings.camera.lab.configuration import unit_suspicion
from wings.camera.lab.folder import LabRecording, open_lab
from wings.camera.observations import cached, find_pictures, log_of
from wings.camera.outlined import frame_pictures
from wings.camera.rendering.render import Rendered

Say = Callable[[str], None]


def parse_name(name: str) -> tuple[Gallery, int, int | None]:
    """Parameters, seed and number of frames of `visual:SEED[:KEY=VALUE+...]`; `frames=N` reads the first N only."""
    _, gallery, seed, counts = registry.parse(name)
    return gallery, seed, counts.get("frames")


def open_recording(name: str, reading: Reading) -> VisualRecording:
    """The images of `visual:SEED[...]`, or of a folder in the lab's format."""
    if not name.startswith("visual:"):
        return _open_lab(Path(name), reading)
    gallery, seed, frames = parse_name(name)
    return Rendered(gallery, seed, frames=frames)


def images_of(name: str, log: Log) -> Iterator[bytes]:
    """PNG of every frame of a log made from images, by its name or folder, with its detections."""
    if log.evidence is not None:
        yield from frame_pictures(open_recording(name, Reading()), log.evidence.found)


def _open_lab(folder: Path, reading: Reading) -> LabRecording:
    unit, direction = reading.camera_translation, reading.camera_reading
    return open_lab(folder, translation_unit=unit, reading=direction, trust_pickle=reading.trust_pickle)


def open_rendered(name: str, reading: Reading, say: Say) -> Log:
    """The log of `visual:SEED[:KEY=VALUE+...]`."""
    gallery, seed, frames = parse_name(name)
    recording = Rendered(gallery, seed, frames=frames)
    n = len(recording)

    def look() -> Found:
        say(f"{name}: rendering {counted(n, 'frame')} and looking for pictures")
        return find_pictures(recording)

    notes: list[str] = []
    if reading.cache is None:
        found = find_pictures(recording)
    else:
        found, note = cached(reading.cache, repr((gallery, seed, n)), look)
        notes += [note] if note else []
    return log_of(
        recording.setup,
        found,
        name,
        noise=reading.corner_noise,
        pose=recording.scene.pose[:n],
        in_view=in_view_of(recording),
        source={"seed": seed},
        notes=tuple(notes),
    )


def in_view_of(recording: Rendered) -> InView:
    """Every detection opportunity of a rendered recording."""
    rows = [(k, s.picture, s.pixels) for k in range(len(recording)) for s in recording.in_view(k)]
    frame, picture = (np.array([row[i] for row in rows], np.int64) for i in (0, 1))
    return InView(frame, picture, np.array([pixels for _, _, pixels in rows], float).reshape(-1, 4, 2))


def open_lab_log(folder: Path, reading: Reading, say: Say) -> Log:
    """The log of a folder in the lab's format; detections are cached in the folder."""
    recording = _open_lab(folder, reading)

    def look() -> Found:
        say(f"{folder.name}: looking for pictures in {counted(len(recording), 'frame')}")
        return find_pictures(recording)

    found, note = cached(folder, recording.digest(), look)
    notes = [*recording.notes, *([note] if note else [])]
    if len(found.frame):
        first = found.frame == found.frame[0]
        read = {"translation_unit": recording.translation_unit, "reading": recording.reading}
        suspicion = unit_suspicion(recording.setup, found.points[first], found.picture[first], **read)
        if suspicion:
            say(f"{folder.name}: {suspicion}")
            notes.append(suspicion)
    else:
        why = ", ".join(f"{reason} ({count})" for reason, count in found.rejected.items())
        notes.append(f"No picture was found in any image ({why}): this is dead reckoning. Are the map's lengths in cm?")
        say(f"{folder.name}: {notes[-1]}")
    source: dict[str, object] = {"folder": folder.name}
    return log_of(recording.setup, found, folder.name, noise=reading.corner_noise, source=source, notes=tuple(notes))
