"""Logs with images: `visual:SEED` is rendered, a folder in the lab's format is read; pictures are detected in both."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data.inputs import Observations
from data.log import Log
from data.logs import Reading
from data.pictures import Found, InView
from data.se2 import Array, pose_error
from data.sensors import RelativePoint
from data.terminal import counted
from data.truth import Truth
from data.worlds import registry
from wings.camera.detector import encoded, outlined
from wings.camera.gallery import Gallery, inputs_of
from wings.camera.lab.folder import LabRecording, open_lab
from wings.camera.observations import cached, find_pictures, log_of
from wings.camera.rendering.render import Rendered

if TYPE_CHECKING:
    from wings.camera.places import Candidate

SAME_PLACE_M, SAME_PLACE_RAD = 0.5, math.radians(20.0)
"""Of a frame that revisits a place: it sees most of what the earlier one saw, at a median depth of 2 m."""
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
            yield encoded(outlined(frame.rgb, found))


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
        recording.setup, found, name, noise=reading.corner_noise, pose=recording.scene.pose[:n],
        in_view=InView(frame, picture, np.array([s.pixels for _, s in rows], float).reshape(-1, 4, 2)),
        source={"seed": recording.seed}, notes=tuple(notes),
    )  # fmt: skip


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


def open_places(name: str, apart: float, reading: Reading) -> "tuple[Log, list[Candidate]]":
    """The log of commands and closures of a recording, and all candidates; pictures are no landmarks in it."""
    from eval.referee.consistency import true_inliers  # detections, which are kept, do not depend on these
    from wings.camera.places import candidates, closures_of, key_frames

    rendered = _rendered(name) if name.startswith("visual:") else None
    recording = rendered or _open_lab(Path(name), reading)
    camera, keys, time, commands = key_frames(recording.frames(), recording.setup)
    nothing = Observations(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2, 2)))
    sensor = RelativePoint(1.0, -math.pi, math.pi, recording.setup.rotation, recording.setup.translation)
    inputs = replace(inputs_of(recording.setup, time, commands, nothing, sensor), map=None)
    found = candidates(camera, keys, time, inputs.increments, apart)
    closures = closures_of(found, keys, inputs.increments)
    truth, notes = Truth(), [f"Places: {counted(len(keys), 'key frame')}, {counted(len(found), 'candidate')}."]
    if rendered is not None:
        pose = rendered.scene.pose[: len(time)]
        inlier = None if closures is None else true_inliers(closures, pose)
        truth = Truth(pose, closure_inlier=inlier)
        right = {} if closures is None or inlier is None else dict(zip(closures.later.tolist(), inlier, strict=True))
        decided = [(key.frame, right.get(key.frame)) for key in keys]
        again = [_seen_again(pose, time, [key.frame for key in keys], k, apart) for k, _ in decided]
        tp, fp = sum(r == 1 for _, r in decided), sum(r == 0 for _, r in decided)
        fn = sum(r is None and a for (_, r), a in zip(decided, again, strict=True))
        shares = f"precision {tp / max(tp + fp, 1):.3f}, recall {tp / max(tp + fn, 1):.3f}"
        notes.append(f"Of key frames: TP {tp}, TN {len(keys) - tp - fp - fn}, FP {fp}, FN {fn}; {shares}.")
    inputs = replace(inputs, closures=closures)
    return Log(name, inputs, truth, source={"kind": "places", "recording": name}, notes=tuple(notes)), found


def _seen_again(pose: Array, time: Array, keys: Sequence[int], frame: int, apart: float) -> bool:
    """Whether an earlier key frame is within half a metre and 20 degrees of a frame."""
    old = pose[[k for k in keys if time[k] <= time[frame] - apart]]
    off = np.abs(pose_error(np.broadcast_to(pose[frame], old.shape), old))
    return bool(((np.hypot(off[:, 0], off[:, 1]) < SAME_PLACE_M) & (off[:, 2] < SAME_PLACE_RAD)).any())
