"""Which test files lie nearest to a product file, by who imports whom."""

import ast
from collections.abc import Iterator, Mapping
from os.path import commonpath
from pathlib import Path

PACKAGES = ("association", "data", "ekf", "eval", "graph", "wings")


def importers(root: Path) -> dict[str, set[str]]:
    """Of every file of packages and tests: the files that import it."""
    files = [p.relative_to(root).as_posix() for top in (*PACKAGES, "tests") for p in sorted((root / top).rglob("*.py"))]
    named = {path.removesuffix(".py").removesuffix("/__init__").replace("/", "."): path for path in files}
    found: dict[str, set[str]] = {path: set() for path in files}
    for path in files:
        for name in _imported(ast.parse((root / path).read_text(encoding="utf-8"))):
            if name in named:
                found[named[name]].add(path)
    return found


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def reached(path: str, by: Mapping[str, set[str]]) -> dict[str, int]:
    """Files that a change of `path` can reach, and over how many imports."""
    steps, todo = {path: 0}, [path]
    for here in todo:
        for other in sorted(by[here] - steps.keys()):
            steps[other] = steps[here] + 1
            todo.append(other)
    return steps


def nearest_tests(path: str, by: Mapping[str, set[str]]) -> list[str]:
    """Test files from which `path` is reached: first those of its own folder, then by the number of imports between."""
    steps = reached(path, by)
    tests = [t for t in steps if Path(t).name.startswith("test_") and "tests/mutation" not in t and "browser" not in t]

    def order(test: str) -> tuple[int, int, str]:
        shared = commonpath([f"tests/{path}", test]).count("/")
        named = Path(path).stem in Path(test).stem
        return (steps[test] - 2 * shared - named, steps[test], test)

    return sorted(tests, key=order)
