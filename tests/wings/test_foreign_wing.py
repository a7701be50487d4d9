"""A wing of others, as the page on extending has it, adds a command, a world, a kind of log; a broken one is named."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.builders.processes import python

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text()
WING = PAGE.partition("# pond/__init__.py\n")[2].partition("```")[0]
THINGS = '''
from dataclasses import dataclass, replace
from data.logs import open_log

def main(argv=None, prog="slamref ducks"):
    print(prog, "counts", *argv)
    return 0

@dataclass(frozen=True)
class Pond:
    """A pond."""
    frames: int = 20

def simulate(pond, seed, name=None):
    return replace(open_log(f"arena:{seed}:frames={pond.frames}"), name=name or f"pond:{seed}")

def opened(folder):
    return simulate(Pond(), 3, folder.name) if (folder / "ducks.csv").exists() else None
'''


@pytest.fixture
def installed(tmp_path):
    """A folder on the path with the package `pond` and its entry point."""
    package, about = tmp_path / "pond", tmp_path / "pond-1.0.dist-info"
    package.mkdir()
    about.mkdir()
    (package / "__init__.py").write_text(WING)
    (package / "things.py").write_text(THINGS)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: pond\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[slamref.wings]\npond = pond:wing\n")
    return tmp_path


ALL = "import sys, slamref; sys.exit(max(slamref.main(command.split()) for command in sys.argv[1:]))"


def slamref(folder: Path, *commands: str) -> subprocess.CompletedProcess[str]:
    return python("-c", ALL, *commands, PYTHONPATH=str(folder))


def test_its_command_its_world_and_its_log_are_there(installed):
    log = installed / "mine"
    log.mkdir()
    (log / "log.toml").write_text("")
    (log / "ducks.csv").write_text("")
    found = slamref(installed, "ducks 7", "inspect pond:1:frames=12", f"inspect {log}", "--help")
    assert (found.returncode, found.stderr) == (0, "")
    assert "slamref ducks counts 7\n" in found.stdout
    assert "pond:1:frames=12" in found.stdout
    assert re.search(r"^  ducks +count ducks$", found.stdout, re.M)


def test_one_that_cannot_be_imported_is_named_in_a_line(installed):
    (installed / "pond" / "__init__.py").write_text("import no_such_module\n")
    found = slamref(installed, "--help")
    assert found.returncode == 2
    assert "wing pond (pond:wing): No module named 'no_such_module'" in found.stderr
    assert len(found.stderr.splitlines()) == 1
