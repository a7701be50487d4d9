"""`python -m eval.live`: online filters and smoothers while a small robot drives, with a recording for replay."""

from __future__ import annotations

import gc
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from data.errors import UsageError
from data.terminal import INTERRUPTED, WRONG, ending
from eval.plan.console import say
from eval.plan.flags import command_of
from eval.plan.flags.options import options_of
from eval.plan.flags.table import HELP, Options, add_flags
from eval.replay.flag import rows
from eval.replay.settings import ASSOCIATIONS, STEPPING, steps

if TYPE_CHECKING:
    from wings.robot.live.drive import Presses

PROG = "python -m eval.live"
TABLE = rows(Options)
SCAN, SCAN_ESTIMATOR = "scan", "isam2"  # the association of scans, and the only estimator with it
UNFIT = {"known": "walls have no labels", SCAN: "--lidar is needed", "jcbb-hindsight": "needs point landmarks"}
FIT = tuple(name for name in ASSOCIATIONS if name not in UNFIT)
USUAL_SIGMA = 0.01  # m, standard deviation of a lidar's range, as of the simulated one
SHARED = (
    replace(TABLE["estimator"], help=HELP["live_estimator"]),
    replace(
        TABLE["association"],
        metavar="NAME",
        help=f"of {', '.join(FIT)}, or your own (default: jcbb; with --lidar: jcbb,scan)",
    ),
    *(TABLE[name] for name in ("gate", "new_gate", "in_view", "forget_after", "deactivate_after", "lag")),
    replace(TABLE["keyframe_distance"], help="with a lidar: a key pose every M metres (default: 0.4)"),
)  # Flags as in `eval.run_all`, without `--maintain`: a wall is seen in one frame of five
DEFAULTS = {"estimator": "ekf-fej", "association": "jcbb"}
WITH_LIDAR = {"estimator": f"ekf-fej,{SCAN_ESTIMATOR}", "association": f"jcbb,{SCAN}"}
REPORT = "-report"


def read(argv: Sequence[str] | None, prog: str = PROG) -> Namespace:
    """The checked flags, with `options`, those `given` that are shared, the association `by_walls` (None: only scans),
    and whether estimates are `by_scans`; `lidar_sigma`: None without a lidar. Raises UsageError.
    """
    parser = command_of(prog, PROG, "live")
    add_flags(parser, SHARED)
    wish = parser.read(argv)
    wish.given = WITH_LIDAR if wish.lidar else DEFAULTS
    wish.given = wish.given | {row.name: getattr(wish, row.name) for row in SHARED if hasattr(wish, row.name)}
    if wish.given["association"] == SCAN and not hasattr(wish, "estimator"):
        wish.given["estimator"] = SCAN_ESTIMATOR
    wish.options = options_of(wish.given)
    _check(wish)
    asked = wish.options.selection.association
    wish.by_walls, wish.by_scans = next((name for name in asked if name != SCAN), None), SCAN in asked
    wish.lidar_sigma = (wish.lidar_sigma or USUAL_SIGMA) if wish.lidar else None
    return wish


def _check(wish: Namespace) -> None:
    """Raise UsageError for an association or an estimator that does not fit a robot with or without a lidar."""
    asked, lidar = wish.options.selection, wish.lidar
    for name in asked.association:
        if name in UNFIT and not (lidar and name == SCAN):
            raise UsageError(f"--association {name}: {UNFIT[name]}; {', '.join(FIT)} do")
    if len([name for name in asked.association if name != SCAN]) > 1:
        more = f", and {SCAN}" if lidar else ""
        raise UsageError(f"--association {','.join(asked.association)}: one name is needed{more}")
    for name in asked.estimator:
        if not steps(name):
            raise UsageError(f"--estimator {name}: does not work step by step; {', '.join(STEPPING)} do")
    if not lidar:
        for name in ("lidar_sigma", "keyframe_distance"):
            if (value := getattr(wish, name, None)) is not None:
                raise UsageError(f"--{name.replace('_', '-')} {value}: --lidar is needed")
    if wish.drive == "explore" and SCAN not in asked.association:
        raise UsageError("--drive explore: the map of scans is needed; --lidar, and an --association with scan")
    if SCAN in asked.association:
        other = [name for name in asked.estimator if name != SCAN_ESTIMATOR]
        if SCAN_ESTIMATOR not in asked.estimator:
            raise UsageError(f"--estimator {other[0]}: with --association {SCAN} {SCAN_ESTIMATOR} is needed")
        if other and len(asked.association) == 1:
            raise UsageError(f"--estimator {other[0]}: --association {SCAN} has {SCAN_ESTIMATOR} alone")


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The whole command, called `prog`; returns the exit status."""
    wish = read(argv, prog)
    from wings.robot.live.drive import Presses

    say("getting ready ...")
    with ExitStack() as stack:
        presses = stack.enter_context(Presses())
        _drive(wish, presses, stack)
        from wings.robot.log import complete

        for note in complete(wish.out).notes:
            say(note)
        from eval import run_all  # before Ctrl-C raises: exceptions during imports may be lost

        say(f"log: {wish.out}")
        status = INTERRUPTED
        if presses.count < 2:
            presses.heed()  # from here on both signals end the report
            with suppress(KeyboardInterrupt):
                status = run_all.main(report_words(wish))
        if status in (INTERRUPTED, WRONG):
            say(f"no report; the log is whole: {wish.out}")
        return status


def _drive(wish: Namespace, presses: Presses, stack: ExitStack) -> None:
    """Drive until Ctrl-C or the end of time, then close the recording; the page stays."""
    from threadpoolctl import threadpool_limits

    from eval.plan.experiment import load_all
    from eval.plan.warming import compile_if_needed
    from eval.player.document import live_document
    from wings.robot.driving import WallFollower
    from wings.robot.exploring import Explorer
    from wings.robot.link import Clock, Link
    from wings.robot.live.drive import Looking, drive
    from wings.robot.live.feed import Feed, Server
    from wings.robot.live.session import GridPainter, ScanEstimating, Session, Taken, estimates, rehearse
    from wings.robot.log import USUAL
    from wings.robot.traffic import Recording

    setup, name = wish.options.setup, wish.out.absolute().name
    association = wish.by_walls or DEFAULTS["association"]
    estimators = wish.options.selection.estimator if wish.by_walls else ()
    load_all(estimators, [association])
    compile_if_needed()
    scanning, painter = None, None
    if wish.by_scans and wish.lidar_sigma is not None:
        scanning = ScanEstimating(setup, wish.lidar_sigma)
    rehearse(estimators, association, setup, None if scanning is None else ScanEstimating(setup, wish.lidar_sigma))
    if presses.count:
        raise KeyboardInterrupt
    stated = {"slip": wish.slip, "sonar_sigma": wish.sonar_sigma}
    noise = USUAL._replace(**{name: value for name, value in stated.items() if value is not None})
    feed = Feed(len(estimators) + (scanning is not None)) if wish.page else None
    if feed is not None:
        painter = None if scanning is None else GridPainter(scanning.scans, feed.show)
        server = stack.enter_context(Server(int(wish.port), live_document(name).encode(), lambda: feed.published))
    receivers: list[Callable[[Taken], None]] = []

    def processed(taken: Taken) -> None:
        for receiver in receivers:
            receiver(taken)

    session = Session(estimators, association, setup, noise, processed, wish.fit, scanning)
    gc.collect()  # objects made so far stay; collecting them again would delay frames
    gc.freeze()
    with ExitStack() as driving:
        driving.enter_context(threadpool_limits(1))  # as in a replay
        with_frames = wish.framed or wish.lidar_sigma is not None
        recording = driving.enter_context(
            Recording(wish.out, framed=with_frames, noise=tuple(noise), fit=wish.fit, lidar_sigma=wish.lidar_sigma)
        )
        clock = Clock(wish.speed)
        try:
            link = driving.enter_context(
                Link(str(wish.link), clock, recording, with_frames=with_frames, with_scans=wish.lidar_sigma is not None)
            )
            if wish.estimates is not None:
                titles = [each.title for each in session.estimating]
                receivers.append(driving.enter_context(estimates(wish.estimates, titles)))
        except UsageError:
            recording.discard()
            raise
        shown = Looking(name, session, lambda: link.exchange.faults, say, feed=feed, speed=wish.speed, painter=painter)
        receivers.append(shown.take)
        if feed is not None:
            say(f"page: {server.address}")
        say(f"recording to {wish.out}; Ctrl-C ends the drive")
        explorer = None
        if wish.drive == "explore" and scanning is not None:
            explorer = Explorer(scanning.scans, lambda: scanning.pose)
        policy = explorer or (WallFollower(wish.fit) if wish.drive == "walls" else lambda _: (0.0, 0.0))

        def over() -> bool:
            return presses.count > 0 or clock.now() >= wish.seconds or (explorer is not None and explorer.finished)

        drive(link, clock, session, policy, over, shown.look, shown.latencies)
        shown.end(clock.now())
    if feed is not None:
        feed.end()
    say(f"{session.frames} frames, {session.observations} walls seen")


def report_words(wish: Namespace) -> list[str]:
    """The words of `eval.run_all` that make the report of the log by the same estimators."""
    words = ["--log", str(wish.out), "--task", "slam", "--out", f"{wish.out}{REPORT}"]
    for row in SHARED:
        if row.name in wish.given:
            words += row.words(row.of(wish.options))
    return words
