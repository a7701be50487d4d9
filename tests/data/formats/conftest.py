"""Files of other programs, converted in a folder of the test."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from data.convert.__main__ import main
from data.formats.open_log import load_folder


@pytest.fixture
def convert(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> Callable[..., Any]:
    """`convert(files, *words)`: the log `out` of texts by file name, and what was said; with status 2 the one line."""
    monkeypatch.chdir(tmp_path)

    def run(files: Mapping[str, str | bytes], *words: object, status: int = 0) -> Any:
        for name, text in files.items():
            Path(name).write_bytes(text if isinstance(text, bytes) else text.encode())
        if status:
            return refused(main, [str(word) for word in words])
        assert main([str(word) for word in words]) == 0, capsys.readouterr().err
        return load_folder(Path("out")), capsys.readouterr().out

    return run
