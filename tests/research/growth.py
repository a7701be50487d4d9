"""How costs grow: one quantity doubles, all else stays. On logarithmic axes the slope is the exponent of growth.

A cost is processor time on one thread; that of `processes` is wall time.
"""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator
from threadpoolctl import threadpool_limits

from association.decide import decide
from data.inputs import FrameObservations, Inputs
from data.sensors import RangeBearing
from data.worlds.registry import named_log
from eval.benchmarks.speed import GATE, Timed, study_seconds, write
from eval.compare import compare
from eval.figures.style import Style, drawing, page_width, save, style_of
from eval.plan.execute import execute
from eval.plan.experiment import Experiment, Work
from eval.plan.experiments import Plan
from eval.plan.flags.table import Options, Output, Study
from eval.replay.frontend import FrontEnd
from eval.replay.settings import Setup
from eval.studies.scenario import load_scenario
from tests.builders.logs import increments_of, inputs_of, observations_of

ESTIMATORS = ("ekf", "batch", "isam2")
PER_METRE = 5  # landmarks per metre along the line of `line_world`
Costs = Iterator[tuple[str, int, Callable[[], object]]]
"""What grows, how much of it there is, and the work to be timed."""


def line_world(landmarks: int) -> Inputs:
    """A robot along a line, one metre a frame, until it has seen every landmark; labels granted, no map."""
    rng = np.random.default_rng(0)
    frames = landmarks // PER_METRE
    xy = np.column_stack([rng.uniform(0.0, frames, landmarks), rng.uniform(-1.5, 1.5, landmarks)])
    sensor, sigma = RangeBearing(max_range=2.0), np.array([0.02, 0.005])
    frame, label, z = [], [], []
    for k in range(frames):
        exact = sensor.predict(np.array([k + 0.5, 0.0, 0.0]), xy)
        seen = np.flatnonzero(sensor.in_view(exact))
        frame += [k] * len(seen)
        label += seen.tolist()
        z += list(exact[seen] + sigma * rng.standard_normal((len(seen), 2)))
    noise = np.array([0.02, 0.02, 0.005])
    mean = np.array([1.0, 0.0, 0.0]) + noise * rng.standard_normal((frames, 3))
    steps, seen = increments_of(mean, np.diag(noise**2)), observations_of(frame, z, np.diag(sigma**2), label)
    return inputs_of(steps, seen, sensor, start=[0.5, 0.0, 0.0], spread=np.diag([1e-4, 1e-4, 1e-6]))


def _frames(frames: int) -> Costs:
    """SLAM in a room of 25 landmarks, which are seen again and again."""
    inputs = named_log(f"arena:0:frames={frames}").inputs(labels=True).without_map()
    for name in ESTIMATORS:
        yield name, frames, partial(compare, inputs, "slam", (name,))


def _decide(front: FrontEnd, seen: FrameObservations) -> None:
    decide("jcbb", front.expect(seen), GATE, 0.99999)


def _landmarks(landmarks: int) -> Costs:
    """JCBB in the last frame of a line of landmarks: to expect and to decide, of as many observations in every map."""
    inputs = line_world(landmarks)
    last = len(inputs) - 1
    for name, setup in (("ekf", Setup()), ("ekf, in view", Setup(in_view=True)), ("isam2", Setup())):
        front = FrontEnd(name.partition(",")[0], "known", inputs, setup)
        for k in range(last):
            front.move(inputs.frame(k))
            front.update(inputs.frame(k), front.associate(inputs.frame(k)))
            front.tidy()
        front.move(inputs.frame(last))
        yield name, landmarks, partial(_decide, front, inputs.frame_observations(last))


def _closures(closures: int) -> Costs:
    """SLAM over 500 frames with loop closures and hardly any landmarks."""
    name = f"mixed:0:frames=500+landmarks=6+gps_period=0+compass_period=0+closure_period={250 / closures}"
    inputs = named_log(name).inputs(labels=True).without_map()
    assert inputs.closures is not None
    for estimator in ESTIMATORS:
        yield estimator, len(inputs.closures), partial(compare, inputs, "slam", (estimator,))


def _twins(twins: int) -> Costs:
    """The diagnosis of a log of 100 frames from its replicates, in one process."""
    experiment = Experiment(named_log("arena:0:frames=100"), "slam", (Work("known", ("ekf", "batch")),), Setup())

    def diagnosed() -> None:
        with TemporaryDirectory() as folder:
            output = Output(out=Path(folder) / "report", no_plots=True)
            execute(Plan((experiment,), ()), Options(study=Study(twins=twins), output=output), lambda done, total: None)

    yield "ekf and batch", twins, diagnosed


GROWTH: Mapping[str, tuple[Callable[[int], Costs], tuple[int, ...]]] = {
    "frames": (_frames, (250, 500, 1000, 2000)), "landmarks": (_landmarks, (75, 150, 300, 600, 1200, 2400)),
    "closures": (_closures, (30, 60, 120, 240, 480)), "twins": (_twins, (5, 10, 20, 40, 80)),
}  # fmt: skip
LONG, REPEATS = 1.0, 7
"""s of work, above which it is timed once; else, how often."""


def cost(work: Callable[[], object]) -> float:
    """Processor time [s] of work that was done before, the least of several times."""
    taken = list[float]()
    for _ in range(1 + REPEATS):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
        if len(taken) > 1 and taken[-1] > LONG:
            break
    return min(taken[1:])


def lines(what: str, quick: bool) -> list[Timed]:
    if what == "processes":
        runs, most = (10, 2) if quick else (100, max(os.cpu_count() or 1, 2))
        scenario = load_scenario("circle").only(("ekf",))
        counts = [2**i for i in range(most.bit_length())]
        return [Timed(f"study of {runs} runs", study_seconds(scenario, runs, n), n, what) for n in counts]
    costs, sizes = GROWTH[what]
    with threadpool_limits(1):
        return [
            Timed(name, cost(work), n, what) for size in sizes[: 3 if quick else None] for name, n, work in costs(size)
        ]


def series(found: Sequence[Timed]) -> dict[tuple[str, str], tuple[list[int], list[float]]]:
    made: dict[tuple[str, str], tuple[list[int], list[float]]] = {}
    for t in found:
        sizes, costs = made.setdefault((t.unit, t.what), ([], []))
        sizes.append(t.units)
        costs.append(t.seconds)
    return made


def text(found: Sequence[Timed]) -> str:
    return "\n".join(
        f"{unit:10s} {what:20s} n^{slope(sizes, costs):5.2f}   "
        + "  ".join(f"{n}: {s:.3g} s" for n, s in zip(sizes, costs, strict=True))
        for (unit, what), (sizes, costs) in series(found).items()
    )


def growth_figure(found: Sequence[Timed]) -> Figure:
    """Cost over each quantity that grew, a panel for each, both axes logarithmic."""
    with drawing():
        units = list(dict.fromkeys(t.unit for t in found))
        columns = min(3, len(units))
        rows = -(-len(units) // columns)
        fig = Figure(figsize=(page_width(), 2.9 * rows))
        panels = dict(zip(units, fig.subplots(rows, columns, squeeze=False).flat, strict=False))
        for (unit, what), (sizes, costs) in series(found).items():
            draw_growth(panels[unit], style_of(what), sizes, costs)
        for unit, ax in panels.items():
            drawn = [t for t in found if t.unit == unit]
            sizes, low, high = sorted({t.units for t in drawn}), *(f(t.seconds for t in drawn) for f in (min, max))
            ax.set_xticks(sizes, [str(n) for n in sizes])
            ax.xaxis.set_minor_locator(NullLocator())
            ax.set_ylim(10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))  # whole decades
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.set(xlabel=f"{unit} n [–]", ylabel="wall time [s]" if unit == "processes" else "processor time [s]")
            ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))
        for ax in fig.axes[len(units) :]:
            ax.remove()
        return fig


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Exponent of growth: slope of log(values) against log(sizes), by least squares over the larger two thirds."""
    x, y = np.log(np.asarray(sizes, float)), np.log(np.asarray(values, float))
    last = slice(len(x) // 3, None)
    return float(np.polyfit(x[last], y[last], 1)[0])


def draw_growth(ax: Axes, style: Style, sizes: Sequence[float], values: Sequence[float]) -> None:
    """A line on logarithmic axes; its label has the exponent, where three points or more show one."""
    exponent = f", $n^{{{slope(sizes, values):.2f}}}$" if len(sizes) > 2 else ""
    ax.plot(sizes, values, label=style.label + exponent, **style.look)
    ax.set(xscale="log", yscale="log")


def study(out: Path, asked: Sequence[str], *, quick: bool) -> None:
    """Print each table when it is done, and write all so far to OUT/growth.csv and OUT/growth.png."""
    done: dict[str, list[Timed]] = {}
    for name in asked:
        done[name] = lines(name, quick)
        print(text(done[name]), flush=True)
        write(done, out / "growth.csv")
        save(growth_figure([line for found in done.values() for line in found]), out, "growth", ("png",))
