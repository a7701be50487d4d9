"""Logs by name or path, and the datasets in a folder."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

from data.errors import UsageError
from data.log import Log
from data.origin import Origin
from data.terminal import meant
from data.truth_windows import scored
from data.wing import of_all, recording_in, recordings, used
from data.worlds import registry

NAMES = ", ".join(["victoria-park", *(f"{world}:SEED[:KEYS]" for world in registry.SIMULATORS)]) + (
    ", KEYS as in people+no-odometry+range=8"
)


@dataclass(frozen=True)
class Reading:
    """How logs are read."""

    camera_translation: str = "cm"  # of a folder with images, unit of T in its configuration, `cm`, `mm` or `m`
    camera_reading: str = "to-camera"  # of R and T there, `to-camera`, p_c = R p_b + T, or `to-body`, the inverse
    corner_noise: str = "lab"  # of pictures' corners, `lab` or `depth`
    trust_pickle: bool = False  # read object arrays, which can run code
    cache: Path | None = None  # folder of detections in rendered images
    relations: Path | None = None  # file of a laser log's reference relations; None: the one beside it
    no_odometry: bool = False  # leave out a laser log's odometry
    # of a log that is scored, stretches of its truth to leave out [s of its recording]
    exclude_truth: tuple[tuple[float, float], ...] = ()
    keep_truth: bool = False  # windows of bad truth are scored, too


def open_log(
    name: str | os.PathLike[str], reading: Reading = Reading(), say: Callable[[str], None] = lambda text: None
) -> Log:
    """Open a log by name (`victoria-park`, `arena:SEED`, `corridor:SEED:KEYS`), folder, or CARMEN file.

    Its truth is that of the file. Windows of bad truth are left out when it is scored (`Trial`, `study`, all commands);
    `data.truth_windows.scored(log, keep=True)` keeps them.

    Args:
        name: name or path.
        reading: options of logs with images, and of laser logs.
        say: called with messages, for instance about progress of a detection.

    Returns:
        The log: `log.inputs(labels=True)` for estimators, `log.truth` for the referee.

    Raises:
        UsageError: unknown name, or options that do not fit the log.
        DataError: invalid contents, with file and line.

    Example:
        >>> log = slamref.open_log("arena:0")
        >>> log.recorded.increments.mean.shape  # (N, 3): frames of dx, dy [m], dtheta [rad]
    """
    log = _opened(os.fspath(name), reading, say)
    if not reading.no_odometry:
        return log
    if log.recorded.scans is None:
        raise UsageError(f"--no-odometry: {log.name} has no laser scans, which alone tell the motion then")
    from data.formats.recordings.laser import without_odometry

    origins = {**log.origins, "odometry_noise": Origin.ASSUMED}
    return replace(log, recorded=without_odometry(log.recorded), origins=origins)


def open_scored(
    name: str | os.PathLike[str], reading: Reading = Reading(), say: Callable[[str], None] = lambda text: None
) -> Log:
    """As `open_log`, with the ground truth that is scored."""
    return as_scored(open_log(name, reading, say), reading)


def as_scored(log: Log, reading: Reading) -> Log:
    """The log with the ground truth that is scored (`data.truth_windows.scored`)."""
    return scored(log, reading.exclude_truth, keep=reading.keep_truth)


def _opened(name: str, reading: Reading, say: Callable[[str], None]) -> Log:
    path = Path(name)
    if os.path.isfile(path):  # unlike Path.is_file, also false for a name the system refuses
        return cast("Log", _recorded(path, reading, say))
    if reading.relations is not None and not os.path.exists(path / "log.toml"):
        raise UsageError(f"--relations {reading.relations}: {name} takes none; name a CARMEN log or an open log folder")
    if name == "victoria-park":
        from data.formats.recordings.victoria_park import load_victoria_park

        return load_victoria_park()
    if registry.is_simulated(name):
        opens = registry.SIMULATORS[name.partition(":")[0]].opens
        made: Log = used(opens)(name, reading, say) if opens else registry.named_log(name)
        return made
    if path.is_dir():
        log = None if (path / "log.toml").exists() else _recorded(path, reading, say)
        return _with_header(path, reading.relations) if log is None else log
    if path.exists():
        raise UsageError(f"{name}: neither a folder nor a file")
    if name in registry.SIMULATORS:
        raise UsageError(f"{name}: the seed is missing, as in {registry.SIMULATORS[name].example}")
    hint = unknown_world(name) or f"; known names: {NAMES}"
    raise UsageError(f"{name}: no such log or folder{hint}")


def unknown_world(name: str) -> str:
    """The hint of a message about a name that is neither a file nor a world."""
    return meant(name, ["victoria-park", *registry.SIMULATORS, *(f"{world}:0" for world in registry.SIMULATORS)])


def require_log(name: str | os.PathLike[str]) -> None:
    """UsageError with the command to type for a file or folder that is no log."""
    path = Path(name)
    if not os.path.exists(path) or os.path.exists(path / "log.toml") or recording_in(path) is not None:
        return
    from data.formats.recognize import what_to_type

    if said := what_to_type(path):
        raise UsageError(f"{path}: {said}")


def _recorded(path: Path, reading: Reading, say: Callable[[str], None]) -> Log | None:
    """The recording of a wing that is a file, or a folder without a `log.toml`; None for a folder of no wing."""
    if (recording := recording_in(path)) is not None:
        log: Log = used(recording.opens)(path, reading, say)
        return log
    require_log(path)
    if path.is_dir():
        return None
    right = "an open log folder, a CARMEN log (.log, .clf, also .gz, .bz2) or a world such as arena:0"
    raise UsageError(
        f"{path}: a file of unknown type; expected {right}, or numbers as CSV: slamref convert table --help"
    )


def _with_header(path: Path, relations: Path | None = None) -> Log:
    """A folder with a `log.toml`: one of a wing, or an open log."""
    for opened in of_all("logs"):
        log: Log | None = opened(path)
        if log is not None:
            if relations is not None:
                raise UsageError(f"--relations {relations}: {path} takes none; name a log with scans")
            return log
    from data.formats.open_log import load_folder

    return load_folder(path, relations)


def find_logs(folder: Path, say: Callable[[str], None]) -> Iterator[Callable[[], Log]]:
    """Loaders of every dataset in a folder, two levels deep: open logs, MRCLAM datasets (each robot), and recordings of
    wings, such as CARMEN logs. `say` reports what is skipped. Nothing is loaded before a loader is called.
    """
    if not folder.is_dir():
        raise UsageError(f"--data {folder}: no such folder")
    yield from _search(folder, 2, say)


def _search(folder: Path, depth: int, say: Callable[[str], None]) -> Iterator[Callable[[], Log]]:
    from data.formats.mrclam import is_mrclam

    inside = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    theirs = {path: load for r in recordings() if r.found for path, load in used(r.found)(inside, say).items()}
    for path in inside:
        if path in theirs:
            if theirs[path] is not None:
                yield theirs[path]
            continue
        if path.is_dir() and (path / "log.toml").exists():
            yield lambda path=path: _with_header(path)  # type: ignore[misc]
        elif is_mrclam(path):
            yield from _mrclam(path, say)
        elif path.is_dir() and depth > 1:
            yield from _search(path, depth - 1, say)
        elif path.is_dir() or path.suffix not in {".md", ".txt", ".dat"}:
            say(f"skipped {path}: not a known dataset")


def _mrclam(path: Path, say: Callable[[str], None]) -> Iterator[Callable[[], Log]]:
    from data.formats.mrclam import Treatment, corrected_landmarks, load_mrclam, robots

    landmarks = corrected_landmarks(path)
    if landmarks is not None:
        say(f"{path.name}: landmark positions are read from {landmarks.name} beside it")
    for robot in robots(path):
        yield lambda robot=robot: load_mrclam(path, robot, Treatment(landmarks=landmarks))  # type: ignore[misc]
