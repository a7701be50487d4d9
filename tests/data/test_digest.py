"""What is kept from run to run depends on all code that it came from: nothing that executes is outside the digests."""

import json
from importlib.metadata import packages_distributions

import pytest

from data import digest
from data.digest import ROOT, program_digest, sources
from eval.studies import store
from tests.builders.processes import python
from wings.camera import observations

OURS = """
import json, sys
from pathlib import Path
{work}
files = [Path(m.__file__).resolve() for m in list(sys.modules.values()) if getattr(m, "__file__", None)]
ours = [f.relative_to({root!r}).as_posix() for f in files if f.suffix == ".py" and f.is_relative_to({root!r})
        and f.relative_to({root!r}).parts[0] in ("association", "data", "ekf", "eval", "graph", "wings")]
print(json.dumps(sorted(ours)))
"""
STUDY = """
from dataclasses import replace
from eval.studies.montecarlo import one_run
from eval.studies.scenario import Member
from eval.studies.scenario import load_scenario
scenario = replace(
    load_scenario("arena"), task=("slam",), association=("known", "jcbb-hindsight"),
    values=(("frames", 12), ("landmarks", 8)), members=tuple(map(Member, ("ekf", "isam2", "batch", "fixed-lag"))),
)
assert all(sample.failure is None for sample in one_run(scenario, 0).values())
"""
DETECTIONS = """
import tempfile
from data.logs import Reading, open_log
from wings.camera.lab.folder import write_lab
from wings.camera.rendering.render import Rendered
from wings.camera.gallery import Gallery
with tempfile.TemporaryDirectory() as folder:
    small = "image_width=320+image_height=240+reference_width=120"
    open_log(f"visual:0:frames=1+{small}", Reading(cache=Path(folder) / "kept"))
    gallery = Gallery(image_width=320, image_height=240, reference_width=120)
    write_lab(Path(folder) / "lab", Rendered(gallery, 0, frames=1))
    open_log(f"{folder}/lab")
"""


def executed(work: str) -> set[str]:
    """The files of this program that a process with this work loads."""
    done = python("-c", OURS.format(work=work, root=str(ROOT)))
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def covered(packages: tuple[str, ...]) -> set[str]:
    return {f.relative_to(ROOT).as_posix() for f in sources(*packages)}


@pytest.mark.slow
def test_a_run_of_a_study_executes_nothing_that_its_digest_does_not_cover():
    loaded = executed(STUDY)
    assert {"eval/replay/hindsight/mapper.py", "graph/incremental.py", "data/worlds/arena.py"} <= loaded
    assert loaded - covered(store.PACKAGES) == set()


@pytest.mark.slow
def test_detections_come_from_nothing_that_their_digest_does_not_cover():
    loaded = executed(DETECTIONS)
    deciding = {"wings/camera/detector.py", "wings/camera/rendering/render.py", "wings/camera/gallery.py"}
    assert deciding | {"wings/camera/lab/folder.py", "data/sensors.py"} <= loaded
    assert loaded - covered(observations.PACKAGES) == set()


@pytest.fixture
def program(tmp_path, monkeypatch):
    for name in ("a/__init__.py", "a/deep/one.py", "b/two.py", "b/notes.txt"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    monkeypatch.setattr(digest, "ROOT", tmp_path)
    yield tmp_path
    program_digest.cache_clear()


def of(*packages: str, libraries: tuple[str, ...] = ()) -> str:
    program_digest.cache_clear()
    return program_digest(packages, libraries)


def test_every_file_below_a_package_counts_and_no_other(program):
    before = of("a", "b/two.py")
    (program / "b" / "notes.txt").write_text("other")
    (program / "b" / "three.py").write_text("")
    assert of("a", "b/two.py") == before
    (program / "a" / "deep" / "one.py").write_text("other")
    changed = of("a", "b/two.py")
    assert changed != before
    (program / "a" / "deep" / "new.py").write_text("")
    assert of("a", "b/two.py") != changed


@pytest.mark.parametrize("libraries", [store.LIBRARIES, observations.LIBRARIES])
def test_the_libraries_are_installed_under_these_names(libraries):
    known = {name for names in packages_distributions().values() for name in names}
    assert set(libraries) <= known
