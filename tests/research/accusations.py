"""`python -m tests.research.accusations [SEEDS]`: how often sound logs are accused, and how long it takes.

Every seed has three levels of noise, and each log all its parts, or lacks the truth, the ids, the map, or all three.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from data.questions.asked import ask
from data.words import sentence
from tests.mistakes import log_of, world

PARTS: tuple[dict[str, bool], ...] = (
    {}, {"truth": False}, {"ids": False}, {"known": False}, {"truth": False, "known": False, "ids": False},
)  # fmt: skip


def main(seeds: int) -> None:
    """Print each accusation, and the share."""
    accused, logs, spent = 0, 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(100, 100 + seeds):
            for noise in (0.3, 1.0, 3.0):
                for parts in PARTS:
                    log = log_of(Path(folder), world(seed, noise), **parts)
                    begin = time.process_time()
                    found = ask(log)
                    spent, logs = spent + time.process_time() - begin, logs + 1
                    if found:
                        accused += 1
                        print(seed, noise, parts, sentence(found[0]), flush=True)
    print(f"{accused} of {logs} sound logs accused; {1e3 * spent / logs:.0f} ms each")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
