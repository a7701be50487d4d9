"""Every command says what it takes within 0.3 s: the parser does not wait for the numerical libraries."""

from __future__ import annotations

import resource
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "scipy", "numba", "pandas", "gtsam", "matplotlib", "cv2", "joblib", "tqdm")
SOON = 0.3
"""s of processor time."""
COMMANDS = {
    "run": "eval.run_all", "step": "eval.step", "play": "eval.play", "convert": "data.convert.__main__",
    "detect": "eval.detect", "inspect": "eval.inspect", "live": "eval.live.__main__",
    "tune": "eval.tune", "twin": "eval.twin", "score": "eval.score", "check": "eval.check",
    "benchmark": "eval.benchmark", "warm": "eval.warm",
}  # fmt: skip
HELP = """
import sys
from {module} import main
try:
    main({arguments!r})
except SystemExit as end:
    assert not end.code
print([name for name in {heavy!r} if name in sys.modules])
"""


def children_cpu() -> float:
    """s of processor time that finished subprocesses used, on a busy machine as on an idle one."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, cwd=ROOT, check=False)


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        *((module, ["--help"]) for module in COMMANDS.values()),
        *(("slamref", [*name, "--help"]) for name in ([], *([c] for c in COMMANDS))),
    ],
)
def test_help_answers_at_once_and_loads_nothing_heavy(module, arguments):
    begin = children_cpu()
    done = python("-c", HELP.format(module=module, arguments=arguments, heavy=HEAVY))
    assert children_cpu() - begin < SOON
    assert done.stdout.startswith("usage: ")
    assert done.stdout.endswith("\n[]\n"), done.stdout[-200:] + done.stderr


@pytest.mark.parametrize(("name", "module"), COMMANDS.items())
def test_a_subcommand_is_the_module_under_another_name(name, module):
    module = module.removesuffix(".__main__")
    ours, theirs = (" ".join(python("-m", *words, "--help").stdout.split()) for words in (["slamref", name], [module]))
    assert ours.startswith(f"usage: slamref {name} ")
    assert theirs.startswith(f"usage: python -m {module} ")
    assert ours.replace(f"slamref {name}", f"python -m {module}") == theirs


@pytest.mark.parametrize(("name", "wrong", "words"), [
    ("run", ["--gate", "1"], "error: --gate 1: a probability"),
    ("step", [], "error: --log: a log is needed"),
    ("inspect", ["nowhere"], "error: --log nowhere: no such folder"),
    ("convert", ["moon"], "slamref convert: argument KIND: invalid choice: 'moon'"),
])  # fmt: skip
def test_a_subcommand_hands_on_its_exit_status(name, wrong, words):
    done = python("-m", "slamref", name, *wrong)
    assert done.returncode == 2
    assert done.stderr.startswith(words)
    assert done.stderr.count("\n") == 1
