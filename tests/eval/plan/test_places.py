"""A result folder that is handed on does not say where logs and programs lay; from elsewhere its bytes are the same."""

from __future__ import annotations

from data.convert.__main__ import main as convert
from eval.run_all import main

OWN = """
from ekf.slam import EkfSlam

class Mine(EkfSlam):
    def update(self, observations, decisions, **more):
        raise LookupError("injected")
"""


def test_logs_reports_and_tracebacks_are_without_folders(tmp_path, monkeypatch):
    (tmp_path / "start").mkdir()
    monkeypatch.chdir(tmp_path / "start")
    made = []
    for place in ("one", "another/place"):
        folder = tmp_path / place
        folder.mkdir(parents=True)
        (folder / "own.py").write_text(OWN)
        assert convert(["arena", str(folder / "log"), "--seed", "0", "--frames", "8"]) == 0
        asked = ["--out", str(folder / "r"), "--no-plots", "-q", "--jobs", "1", "--task", "slam"]
        assert main([str(folder / "log"), *asked, "--estimator", f"ekf,m={folder / 'own.py'}:Mine"]) == 0
        files = sorted(p for p in (folder / "r").rglob("*") if p.is_file() and p.name != "timing.csv")
        made.append({p.relative_to(folder / "r"): p.read_bytes() for p in files})
        assert not [name for name, content in made[-1].items() if str(folder).encode() in content]
        log = (folder / "r/run.log").read_text()
        assert 'File "own.py", line 6' in log
        assert "report: r/report.html" in log
    assert made[0] == made[1]
