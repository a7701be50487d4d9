"""What commands say stays as it is, word by word; what of it is right is said elsewhere."""

from __future__ import annotations

import math

import pytest

import slamref
from tests.kept.compare import assert_kept

CASES = {
    "inspect": ["inspect", "corridor:0:people"],
    "tune": ["tune", "arena:0:frames=60", "OUT"],
    "check": ["check", "eval.replay.estimators:EkfSlam"],
    "check-association": ["check", "association.methods:gnn"],
    "twin": ["twin", "arena:0:frames=60", "OUT"],
    "score": ["score", "given.tum", "truth.tum"],
}


@pytest.mark.parametrize("case", CASES)
def test_a_command_says_what_it_said(case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, off in (("truth.tum", 0.0), ("given.tum", 0.05)):
        turns = [(math.sin(0.01 * k), math.cos(0.01 * k)) for k in range(30)]
        lines = [
            f"{0.5 * k} {0.3 * k + off} {0.01 * k**2 - off * k / 30} 0 0 0 {s!r} {c!r}"
            for k, (s, c) in enumerate(turns)
        ]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    assert slamref.main(CASES[case]) == 0
    assert_kept(f"commands/{case}", capsys.readouterr().out.replace(str(tmp_path), "HERE"))
