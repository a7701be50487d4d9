"""Memory needed to write and read a lab's log as arrays does not grow with its length."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

STREAM = """
import sys
from pathlib import Path
import numpy as np
from wings.camera.lab.folder import open_lab, write_lab
from data.inputs import Prior
from data.pictures import VisualFrame, VisualSetup
folder, form, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
rgb = np.full((480, 640, 3), 7, np.uint8)
xyz = np.full((480, 640, 3), 2.5, np.float32)
class Long:
    corners = np.array([[[0, 1], [0, 0], [0, 0], [0, 1]]], float)
    setup = VisualSetup(0.0, (0.0, 0.0), corners, Prior(np.zeros(3), np.eye(3)))
    references = [np.zeros((4, 4, 3), np.uint8)]
    def __len__(self): return count
    def frames(self):
        for i in range(count): yield VisualFrame(float(i), 0.0, 0.0, rgb, xyz)
if not folder.exists():
    write_lab(folder, Long(), form=form)
recording = open_lab(folder)
assert sum(1 for f in recording.frames() if f.xyz[0, 0, 2] == np.float32(2.5)) == len(recording)
recording.digest()
status = Path("/proc/self/status").read_text()  # ru_maxrss would be a forking parent's, if that is larger
print(int(status.split("VmHWM:")[1].split()[0]) / 1024)
"""


def peak(folder: Path, form: str, count: int) -> float:
    """MiB that a process needed at most to write (unless it is there), read and hash a log of VGA frames."""
    done = subprocess.run(
        [sys.executable, "-c", STREAM, str(folder), form, str(count)],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[4],
    )
    return float(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["npy", "npz"])
def test_memory_does_not_grow_with_the_length_of_a_log(tmp_path: Path, form: str) -> None:
    short, long = peak(tmp_path / "short", form, 4), peak(tmp_path / "long", form, 180)
    size = (tmp_path / "long" / f"log.{form}").stat().st_size / 2**20
    assert size > 750
    assert long < short + 50
    assert long < 512


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length_of_a_compressed_log(tmp_path: Path) -> None:
    peaks = []
    for name, count in (("short", 4), ("long", 180)):
        folder = tmp_path / name
        peak(folder, "npz", count)
        path, other = folder / "log.npz", folder / "packed"
        with (
            zipfile.ZipFile(path) as old,
            zipfile.ZipFile(other, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as new,
        ):
            for member in old.namelist():
                with old.open(member) as source, new.open(member, "w", force_zip64=True) as sink:
                    while block := source.read(1 << 20):
                        sink.write(block)
        other.replace(path)
        peaks.append(peak(folder, "npz", count))
    assert peaks[1] < peaks[0] + 50
    assert peaks[1] < 512
