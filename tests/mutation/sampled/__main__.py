"""The fixed set of faults: which test finds which, and whether those that were found still are.

`python -m tests.mutation.sampled` (`make mutants`) tries every fault of `faults.csv` on the test that found it, then on
the test files nearest to it, then on all fast tests. It ends with status 1 if one that was found is not found any more.
`--draw 40 --seed 7` tries another sample instead and says what share is found. `--store` writes what found each into
the set. `--stale` tries nothing and lists the rows whose line or test is gone. `--missed` tries those that no test
found, `--near` tries no test but those nearest (a lower bound, in a fraction of the time).
"""

import argparse
import csv
import random
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tests.mutation.sampled.mutants import Fault, faults_of
from tests.mutation.sampled.nearest import PACKAGES, importers, nearest_tests
from tests.mutation.sampled.trees import BROKEN, HANGS, ROOT, broken, failing, load_libraries, prepared

SET = Path(__file__).with_name("faults.csv")
NEAREST = 12
"""Test files tried before the whole suite."""
LONGEST = 1800.0
"""s; the whole fast suite takes less than half of it in one process."""


class Named(NamedTuple):
    """A fault by names that last while lines move: line, what stood there, what stands there, which of equal ones."""

    path: str
    line: str
    old: str
    new: str
    nth: str
    found_by: str


def named(fault: Fault, text: str, found_by: str = "") -> Named:
    key = _key(fault, text)
    equal = [f for f in faults_of(fault.path, text) if _key(f, text) == key]
    return Named(fault.path, *key, str(equal.index(fault)), found_by)


def _key(fault: Fault, text: str) -> tuple[str, str, str]:
    line = text.splitlines()[fault.line - 1].strip()
    return line, " ".join(text[fault.start : fault.end].split()), fault.new


def fault_named(name: Named, root: Path) -> Fault | None:
    """The fault, or None where its file or line is gone."""
    if not (file := root / name.path).is_file():
        return None
    text = file.read_text("utf-8")
    equal = [f for f in faults_of(name.path, text) if _key(f, text) == name[1:4]]
    return equal[int(name.nth)] if int(name.nth) < len(equal) else None


def stored() -> list[Named]:
    with SET.open(newline="", encoding="utf-8") as file:
        return [Named(**row) for row in csv.DictReader(file)]


def store(names: Sequence[Named]) -> None:
    with SET.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([Named._fields, *sorted(names)])


def is_there(test: str) -> bool:
    """Whether the file still has the test (or is it), by name; parameters are not looked at."""
    path, _, name = test.partition("::")
    if not (file := ROOT / path).is_file():
        return test in (HANGS, BROKEN)
    return f"def {name.partition('[')[0].rpartition('::')[2]}" in file.read_text("utf-8")


def drawn(root: Path, number: int, seed: int) -> list[Named]:
    rng = random.Random(seed)
    texts = {
        p.relative_to(root).as_posix(): p.read_text("utf-8") for top in PACKAGES for p in (root / top).rglob("*.py")
    }
    paths, found = sorted(texts), dict[Named, None]()
    lengths = [texts[path].count("\n") for path in paths]
    while len(found) < number:
        path = rng.choices(paths, lengths)[0]
        faults = faults_of(path, texts[path])
        if faults and (fault := rng.choice(faults)).is_one(texts[path]):
            found[named(fault, texts[path])] = None
    return list(found)


_state: dict[str, Any] = {}


def _begin(trees: Any, by: Mapping[str, set[str]], last: Sequence[str]) -> None:
    load_libraries()
    _state.update(tree=trees.get(), by=by, last=last, sound=False)


def _found_by(name: Named) -> str:
    tree = _state["tree"]
    fault = fault_named(name, tree)
    assert fault is not None
    near = nearest_tests(name.path, _state["by"])[:NEAREST]
    if not _state["sound"]:
        assert not (failed := failing(tree, near, LONGEST)), f"{failed} fails without a fault"
        _state["sound"] = True
    with broken(tree, fault):
        known = [name.found_by] if (tree / name.found_by.partition("::")[0]).is_file() else []
        for what in (known, near, _state["last"]):
            if found := failing(tree, what, LONGEST):
                return found
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutation.sampled", description=__doc__.partition("\n\n")[0])
    parser.add_argument("--draw", type=int, default=0, metavar="N", help="try a sample of N faults instead of the set")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    parser.add_argument("--store", action="store_true", help="write the tests that found the faults into the set")
    parser.add_argument("--stale", action="store_true", help="list the rows whose line or test is gone")
    parser.add_argument("--missed", action="store_true", help="try those of the set that no test found")
    parser.add_argument("--near", action="store_true", help="try the nearest tests only, not the whole suite")
    parser.add_argument("--jobs", type=int, default=2, help="faults tried at the same time")
    parser.add_argument("--only", default="", metavar="PATH", help="faults in files that begin so")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "mutants", help="folder of the copies")
    options = parser.parse_args()
    names = [name for name in stored() if bool(name.found_by) != options.missed]
    names = drawn(ROOT, options.draw, options.seed) if options.draw else names
    names = [name for name in names if name.path.startswith(options.only)]
    gone = [name for name in names if fault_named(name, ROOT) is None]
    if options.stale:
        for name in [*gone, *(n for n in names if not (n in gone or is_there(n.found_by)))]:
            _say(f"{'line' if name in gone else 'test'} gone: {name.path}: {name.line}: {name.found_by}")
        return 0
    names = [name for name in names if name not in gone]
    context = get_context("fork")
    trees = context.Queue()
    for k in range(options.jobs):
        trees.put(prepared(options.work / str(k)))
    missed, results, last = 0, list[Named](), [] if options.near else ["tests"]
    with ProcessPoolExecutor(options.jobs, context, _begin, (trees, importers(ROOT), last)) as pool:
        for name, found in zip(names, pool.map(_found_by, names), strict=True):
            missed += not found
            results.append(name._replace(found_by=found))
            _say(f"{'found' if found else 'MISSED'} {name.path}: {name.line}: {name.old} -> {name.new} {found}")
    for name in gone:
        _say(f"gone {name.path}: {name.line}: {name.old} -> {name.new}")
    _say(f"{len(names) - missed} of {len(names)} found; the lines of {len(gone)} are gone")
    if options.store:
        store(list(({name[:5]: name for name in stored()} | {name[:5]: name for name in results}).values()))
    return 1 if missed and not (options.draw or options.missed) else 0


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
