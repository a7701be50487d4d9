"""Fixtures for every test."""

import gc
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import threadpoolctl
from hypothesis import settings

# The workers share the cores: threads of BLAS would only wait for each other. Before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


# The libraries with threads are looked for once, not in every run of every test: 10 ms each time.
threadpoolctl.ThreadpoolController = cache(threadpoolctl.ThreadpoolController)

# How long an example takes says how busy the machine is, not whether the code is right.
settings.register_profile("thorough", deadline=None, max_examples=100)
settings.register_profile("quick", deadline=None, max_examples=30)
settings.load_profile("quick")

gc.disable()  # Thousands of tests and modules are made once and stay: the garbage collector need not go through them.


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """`refused(main, words)`: the one line that a command says on the way to status 2."""
    monkeypatch.setattr("eval.plan.warming.is_compiled", lambda: True)  # of kernels, compiling them is said before

    def run(main: Callable[..., Any], words: Any) -> str:
        capsys.readouterr()
        try:
            status = main(words)
        except SystemExit as end:  # a parser's
            status = end.code
        said = capsys.readouterr().err
        assert status == 2, said
        assert said.startswith(("slamref", "python -m "))
        assert said.count("\n") == 1, said
        return said

    return run


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Recorded data that is not part of the project; tests that need it are skipped without it."""
    folder = Path(__file__).parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("no recorded data beside the project (../shared/data)")
    return folder


@pytest.fixture(scope="session")
def mrclam(shared_data: Path) -> Path:
    """Recordings of UTIAS MRCLAM, as zips."""
    folder = shared_data / "mrclam"
    if not folder.is_dir():
        pytest.skip("no MRCLAM recordings beside the project (../shared/data/mrclam)")
    return folder


@pytest.fixture(scope="module")
def tables_parsed_once() -> Iterator[None]:
    """The text of a recorded MRCLAM file is parsed once, however often its log is loaded; nobody may write into it."""
    from data.formats import mrclam as files

    plain = files.parse

    @cache
    def parse(path: str, content: bytes, columns: tuple[str, ...]) -> files.Table:
        table = plain(path, content, columns)
        for column in table.columns.values():
            column.setflags(write=False)
        return table

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "parse", parse)
        yield
