"""Logs with images: `visual:SEED` is rendered, a folder in the lab's format is read; pictures are detected in both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data.formats.lab.configuration import unit_suspicion
from data.formats.lab.folder import LabRecording, open_lab
from data.log import Log
from data.pictures import Found, InView, VisualRecording
from data.terminal import counted
from data.visual.observations import cached, find_pictures, log_of
from data.visual.rendering.render import Rendered
from data.worlds import registry
from data.worlds.gallery import Gallery

Say = Callable[[str], None]


@dataclass(frozen=True)
class Camera:
    """How a recording with images is read.

    Attributes:
        translation: unit of T in the lab's configuration, `cm`, `mm` or `m`.
        reading: `to-camera`, p_c = R p_b + T as the lab applies it, or `to-body`, the inverse.
        noise: of the corners, `lab` or `depth`, see `data.visual.observations.noise_of`.
        trust_pickle: read object arrays, which can run code.
    """

    translation: str = "cm"
    reading: str = "to-camera"
    noise: str = "lab"
    trust_pickle: bool = False


def parse_name(name: str) -> tuple[Gallery, int, int | None]:
    """Parameters, seed and number of frames of `visual:SEED[:KEY=VALUE+...]`; `frames=N` reads the first N only."""
    _, gallery, seed, counts = registry.parse(name)
    return gallery, seed, counts.get("frames")


def open_recording(name: str, camera: Camera) -> VisualRecording:
    """The images of `visual:SEED[...]`, or of a folder in the lab's format."""
    if not name.startswith("visual:"):
        return _open_lab(Path(name), camera)
    gallery, seed, frames = parse_name(name)
    return Rendered(gallery, seed, frames=frames)


def _open_lab(folder: Path, camera: Camera) -> LabRecording:
    unit, reading = camera.translation, camera.reading
    return open_lab(folder, translation_unit=unit, reading=reading, trust_pickle=camera.trust_pickle)


def open_rendered(name: str, camera: Camera, say: Say, cache: Path | None) -> Log:
    """The log of `visual:SEED[:KEY=VALUE+...]`."""
    gallery, seed, frames = parse_name(name)
    recording = Rendered(gallery, seed, frames=frames)
    n = len(recording)

    def look() -> Found:
        say(f"{name}: rendering {counted(n, 'frame')} and looking for pictures")
        return find_pictures(recording)

    notes: list[str] = []
    if cache is None:
        found = find_pictures(recording)
    else:
        found, note = cached(cache, repr((gallery, seed, n)), look)
        notes += [note] if note else []
    return log_of(
        recording.setup,
        found,
        name,
        noise=camera.noise,
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


def open_lab_log(folder: Path, camera: Camera, say: Say) -> Log:
    """The log of a folder in the lab's format; detections are cached in the folder."""
    recording = _open_lab(folder, camera)

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
    return log_of(recording.setup, found, folder.name, noise=camera.noise, source=source, notes=tuple(notes))
