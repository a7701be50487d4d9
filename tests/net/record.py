"""The record: one file for each case, a line for each column."""

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import process_time

from tests.net.cases import CASES, run
from tests.net.digest import Columns, columns_of, digests, files_of

RECORDED = Path(__file__).parent / "recorded"


@dataclass(frozen=True)
class Record:
    """What is kept of a case: its exit status, and of each file each column's digest."""

    status: int
    files: dict[str, dict[str, str]]

    @staticmethod
    def read(case: str) -> "Record | None":
        """As it was committed; None: there is none."""
        path = RECORDED / f"{case}.json"
        if not path.is_file():
            return None
        held = json.loads(path.read_text("utf-8"))
        whole: dict[str, str] = {}
        files: dict[str, dict[str, str]] = {}
        for name, columns in held["files"].items():
            files[name] = {c: whole.setdefault(text.split()[0], text) for c, text in columns.items()}
        return Record(held["status"], files)

    def write(self, case: str) -> None:
        """For good. Of a column that stands further up already, the exact digest alone is written."""
        known: set[str] = set()
        files: dict[str, dict[str, str]] = {}
        for name, columns in self.files.items():
            files[name] = {}
            for column, text in columns.items():
                exact = text.split()[0]
                files[name][column] = exact if exact in known else text
                known.add(exact)
        RECORDED.mkdir(exist_ok=True)
        text = json.dumps({"status": self.status, "files": files}, indent=0, ensure_ascii=False)
        (RECORDED / f"{case}.json").write_text(text + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Done:
    record: Record  # what would be kept of it
    columns: dict[str, Columns]  # of each file that something is kept of
    files: list[str]  # all files of the result folder
    seconds: float  # of CPU


def done(name: str, save: Path | None) -> Done | str:
    """A case done; what went wrong, if it wrote nothing. This is what the processes do."""
    start = process_time()
    folder = Path(tempfile.mkdtemp(prefix=f"net-{name}-"))
    try:
        status, out = run(CASES[name], folder)
    except Exception as error:  # noqa: BLE001, a case that breaks is told like one that moved, and the others go on
        return f"{type(error).__name__}: {error}"
    if save is not None:
        shutil.rmtree(save / name, ignore_errors=True)
        shutil.copytree(out, save / name)
    columns = columns_of(out, CASES[name].runs)
    files = files_of(out)
    shutil.rmtree(folder)
    return Done(Record(status, digests(columns)), columns, files, process_time() - start)
