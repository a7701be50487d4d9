"""Memory over a long drive, as fast as it goes: `python -m tests.wings.robot.live.soak ESTIMATOR SECONDS`.

All that `slamref live` does to a packet but the terminal and the page's server: link, recording on disk, estimators,
the line of each second, the page's chunks. Prints the robot's time [s], resident memory [MB], walls, ms a frame.
"""

import gc
import sys
import tempfile
import time
from pathlib import Path

from threadpoolctl import threadpool_limits

from eval.replay.settings import Setup
from tests.wings.robot.line import linked
from tests.wings.robot.live.driven import BAD
from wings.robot.driving import WallFollower
from wings.robot.live.drive import Looking, drive
from wings.robot.live.feed import Feed
from wings.robot.live.session import Session, rehearse
from wings.robot.traffic import Recording

SETUPS = {"ekf": Setup(deactivate_after=60.0), "fixed-lag": Setup(lag=30.0)}


def resident():
    """MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024.0


def soak(name, seconds, every=60.0, say=lambda *words: None):
    """Robot's time [s] and memory [MB], every so often."""
    setup, rows, next_row = SETUPS.get(name, Setup()), [], 0.0
    rehearse((name,), "jcbb", setup)
    session, feed = Session((name,), "jcbb", setup), Feed(1)
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        gc.collect()
        gc.freeze()
        with Recording(Path(folder) / "log") as recording:
            link, wire, clock = linked(BAD, 1, recording=recording)
            wire.keep = False
            display = Looking("soak", session, lambda: link.exchange.faults, lambda line: None, feed=feed)
            session._processed = display.take
            begin = time.monotonic()

            def look(t):
                nonlocal next_row
                if len(feed.waiting) >= 4:
                    display.say(t)
                if t >= next_row:
                    rows.append((t, resident()))
                    walls = session.estimating[0].map()
                    spent = 1e3 * (time.monotonic() - begin) / max(session.frames, 1)
                    published = sum(len(c.text) for c in feed.published.large + feed.published.small) / 1e6
                    say(
                        f"{t:8.0f} s {rows[-1][1]:8.2f} MB {len(walls.number) if walls else 0:4d} walls "
                        f"{spent:6.2f} ms a frame, page {published:.2f} MB {session.estimating[0].failure}"
                    )
                    next_row += every

            drive(link, clock, session, WallFollower(), lambda: clock.now() >= seconds, look, display.latencies)
            say(f"faults {link.exchange.faults}")
    return rows


if __name__ == "__main__":
    soak(sys.argv[1], float(sys.argv[2]), 60.0, lambda line: sys.stdout.write(line + "\n") and sys.stdout.flush())
