"""The word about the innovations is right: as large as claimed where the noise is, larger or smaller where it is not.

600 worlds, a third each with labels, `jcbb` and `jcbb-hindsight`; filter and smoother each have their word. The table
that was measured is in docs/notes/verdict-rules.md.
"""

from collections import Counter
from collections.abc import Iterator

import pytest

from data.logs import open_log
from eval.compare import compare
from eval.referee.consistency import innovations_word
from eval.referee.score import Trial, score
from tests.eval.referee.wrecks import stated

WORLDS = ("arena:{}", "corridor:{}", "arena:{}:sensor=relative_point+landmarks=60+max_range=6")
METHODS = ("known", "jcbb", "jcbb-hindsight")
RIGHT = {0.7: "NIS too large", 1.0: "innovations fit", 1.5: "NIS too small"}


def words(world: str, method: str, seed: int, factor: float) -> Iterator[str]:
    """The filter's word and the smoother's on one world whose noise is stated at `factor` of what it is."""
    log = stated(open_log(world.format(seed)), factor)
    runs = compare(log.inputs(labels=method == "known"), "slam", ["ekf", "batch"], method)
    for row in score([Trial(log, "slam", tuple(runs))]).metrics.to_dict("records"):
        yield innovations_word(float(row["nis"]), float(row["nis_lower"]), float(row["nis_upper"]))


def share(seeds: range, factor: float, methods=METHODS) -> float:
    found = Counter(w for world in WORLDS for method in methods for s in seeds for w in words(world, method, s, factor))
    return found[RIGHT[factor]] / found.total()


@pytest.mark.slow
def test_the_word_is_right_for_right_noise():
    assert 0.92 <= share(range(1000, 1067), 1.0) <= 0.98


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.7, 1.5])
def test_the_other_word_is_right_for_wrong_noise(factor):
    assert share(range(2000, 2012), factor) >= 0.9
