"""The first minute of a new user, measured: `python -m tests.research.first_minute [--here]`.

Makes a fresh environment in a temporary folder, installs slamref there as README says, and prints a Markdown table:
processor time until the table of `slamref run arena:0` stands on the terminal and until the command ends, the first
time and warm, of compiling everything, and the size of the installation. `--here`: in this environment, with a copy of
the source without compiled kernels.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
TICK = os.sysconf("SC_CLK_TCK")
NOT_SOURCE = {".git", ".venv", "results", "build", "tests"}


def ignored(folder: str, names: list[str]) -> set[str]:
    """What is not copied: all that a fresh clone lacks, and tests."""
    return {n for n in names if n == "__pycache__" or (Path(folder) == ROOT and n in NOT_SOURCE)}


class Cost(NamedTuple):
    """Processor and wall time [s] until the table stands there, and until the end."""

    table_cpu: float
    table_wall: float
    cpu: float
    wall: float


def processor_time(pid: int) -> float:
    """Of a process and its ended children [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return sum(int(f) for f in fields[11:15]) / TICK


def run(command: list[str], folder: Path, environment: dict[str, str]) -> Cost:
    """Run a command to its end. The table stands there with the line that says whom to trust."""
    begin = time.monotonic()
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,  # its background compiler stays in this group
    )
    assert process.stdout is not None
    cpu = wall = float("nan")
    for line in process.stdout:
        if line.startswith("arena:0, localization:"):
            cpu, wall = processor_time(process.pid), time.monotonic() - begin
    process.stdout.close()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    if status:
        raise SystemExit(f"{' '.join(command)}: status {status}")
    return Cost(cpu, wall, used.ru_utime + used.ru_stime, time.monotonic() - begin)


def size(folder: Path) -> float:
    return sum(f.stat().st_size for f in folder.rglob("*") if f.is_file() and not f.is_symlink()) / 1e6


def measure(here: bool) -> list[tuple[str, str]]:
    """Rows of the table: what, how much."""
    rows = []
    with tempfile.TemporaryDirectory() as place:
        source, work = Path(place) / "source", Path(place) / "work"
        shutil.copytree(ROOT, source, ignore=ignored)
        work.mkdir()
        environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "NUMBA_DISABLE_JIT")}
        if here:
            python, command = sys.executable, [sys.executable, str(source / "slamref.py")]
        else:
            python = str(Path(place) / "venv" / "bin" / "python")
            subprocess.run([sys.executable, "-m", "venv", str(Path(place) / "venv")], check=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", str(source)], check=True)
            command = [str(Path(place) / "venv" / "bin" / "slamref")]
            rows.append(("installed size", f"{size(Path(place) / 'venv'):.0f} MB"))
        asked = [*command, "run", "arena:0", "--out", str(work / "out")]
        first = run(asked, work, environment)
        rows.append(("first run: table", f"{first.table_cpu:.1f} s, {first.table_wall:.1f} s wall"))
        rows.append(("first run: report", f"{first.cpu:.1f} s, {first.wall:.1f} s wall"))
        warm = run([*command, "warm"], work, environment)
        rows.append(("all kernels compiled (`slamref warm`)", f"{warm.cpu:.1f} s"))
        again = sorted(run(asked, work, environment) for _ in range(3))[1]
        rows.append(("warm: table", f"{again.table_cpu:.1f} s, {again.table_wall:.1f} s wall"))
        rows.append(("warm: report", f"{again.cpu:.1f} s, {again.wall:.1f} s wall"))
        rows.append(("first run / warm run, to the end", f"{first.cpu / again.cpu:.2f}"))
    return rows


def main() -> int:
    print("| `slamref run arena:0` | processor time |\n|---|---:|")
    for what, value in measure("--here" in sys.argv):
        print(f"| {what} | {value} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
