"""Logs with images: `visual:SEED` is rendered, a folder in the lab's format is read; pictures are detected in both."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from data.log import Log
from data.logs import Reading
from data.pictures import Found, InView
from data.terminal import counted
from data.worlds import registry
from wings.camera.gallery import Gallery
from wings.camera.lab.folder import LabRecording, open_lab
from wings.camera.observations import cached, find_pictures, log_of
from wings.camera.outlined import outlined, png_of
from wings.camera.rendering.render import Rendered

Say = Callable[[str], None]


def parse_name(name: str) -> tuple[Gallery, int, int | None]:
    """Parameters, seed and number of frames of `visual:SEED[:KEY=VALUE+...]`; `frames=N` reads the first N only."""
    _, gallery, seed, counts = registry.parse(name)
    return gallery, seed, counts.get("frames")


def images_of(name: str, log: Log) -> Iterator[bytes]:
    """PNG of every frame of a log made from images, by its name or folder, with its detections."""
    if log.evidence is not None:
        recording = _rendered(name) if name.startswith("visual:") else _open_lab(Path(name), Reading())
        for k, frame in enumerate(recording.frames()):
            here = np.flatnonzero(log.evidence.found.frame == k)
            found = [(str(log.evidence.found.picture[d]), log.evidence.found.pixels[d]) for d in here]
            yield png_of(outlined(frame.rgb, found))


def _rendered(name: str) -> Rendered:
    gallery, seed, frames = parse_name(name)
    return Rendered(gallery, seed, frames=frames)


def _open_lab(folder: Path, reading: Reading) -> LabRecording:
    unit, direction = reading.camera_translation, reading.camera_reading
    return open_lab(folder, translation_unit=unit, reading=direction, trust_pickle=reading.trust_pickle)


def open_rendered(name: str, reading: Reading, say: Say) -> Log:
    """The log of `visual:SEED[:KEY=VALUE+...]`."""
    recording = _rendered(name)
    n = len(recording)

    def look() -> Found:
        say(f"{name}: rendering {counted(n, 'frame')} and looking for pictures")
        return find_pictures(recording)

    notes: list[str] = []
    if reading.cache is None:
        found = find_pictures(recording)
    else:
        found, note = cached(reading.cache, repr((recording.gallery, recording.seed, n)), look)
        notes += [note] if note else []
    rows = [(k, s) for k in range(n) for s in recording.in_view(k)]
    frame, picture = np.array([(k, s.picture) for k, s in rows], np.int64).reshape(-1, 2).T
    return log_of(
        recording.setup,
        found,
        name,
        noise=reading.corner_noise,
        pose=recording.scene.pose[:n],
        in_view=InView(frame, picture, np.array([s.pixels for _, s in rows], float).reshape(-1, 4, 2)),
        source={"seed": recording.seed},
        notes=tuple(notes),
    )


def open_lab_log(folder: Path, reading: Reading, say: Say) -> Log:
    """The log of a folder in the lab's format; detections are cached in the folder."""
    recording = _open_lab(folder, reading)

    def look() -> Found:
        say(f"{folder.name}: looking for pictures in {counted(len(recording), 'frame')}")
        return find_pictures(recording)

    found, note = cached(folder, recording.digest(), look)
    notes = [*recording.notes, *([note] if note else [])]
    if not len(found.frame):
        why = ", ".join(f"{reason} ({count})" for reason, count in found.rejected.items())
        notes.append(f"No picture was found in any image ({why}): this is dead reckoning. Are the map's lengths in cm?")
        say(f"{folder.name}: {notes[-1]}")
    source: dict[str, object] = {"folder": folder.name}
    return log_of(recording.setup, found, folder.name, noise=reading.corner_noise, source=source, notes=tuple(notes))
