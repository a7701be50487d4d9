"""The violated assumption that a diagnosis names, in a word, and its evidence in a person's units."""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from data.inputs import Inputs
from data.notice import Code
from data.sensors import Bearing, Range, RangeBearing
from eval.referee.attribution import ASSOCIATIONS, CONTRADICTED, ESTIMATOR, NOTHING, UNLISTED, UNTELLABLE, Finding
from eval.referee.score import Trial
from eval.referee.sources import source_in
from eval.replay.settings import ESTIMATORS, FILTERS, associations
from eval.studies.diagnosis import Trust
from eval.studies.twins import PLAIN, STAND_IN

STANDS_OUT = 3.0  # standard errors from which a slope is named without bootstrap replicates
METRES, SECONDS, DRIFT, SPEED = ("m", 1.0), ("s", 1.0), ("rad/s", 1.0), ("m/s", 1.0)
_OWN = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
UNITS, OF_SOURCES, OF_POINTS = (
    {name: (unit, _OWN["factors"].get(unit, 1.0)) for unit, names in _OWN[part].items() for name in names}
    for part in ("systematic", "sources", "points")
)  # by error a person's unit and its factor from SI
OF_FRAMES = {SECONDS: ("frames", 1.0), DRIFT: ("rad/frame", 1.0), SPEED: ("m/frame", 1.0)}
"""Units of a log without stamps, whose time is the number of the frame."""
LATE = ("latency", "latency_growth", "odometry_latency")  # errors of time stamps


@dataclass(frozen=True)
class Terms:
    """Names of a log's quantities: ranges and bearings, else points; time in seconds, else frames."""

    polar: bool = True
    stamped: bool = True
    observed: bool = True  # without observations `tune` has nothing to fit to

    def unit(self, name: str) -> tuple[str, float]:
        """The unit of a systematic error for a person, and its factor from SI."""
        if ":" in name:
            unit = OF_SOURCES.get(name.rpartition("/")[2], METRES)
        else:
            unit = UNITS.get(name, SECONDS) if self.polar else OF_POINTS.get(name, UNITS.get(name, SECONDS))
        return unit if self.stamped else OF_FRAMES.get(unit, unit)


def terms_of(inputs: Inputs) -> Terms:
    """The terms of a log."""
    observed = len(inputs.observations.frame) > 0
    return Terms(isinstance(inputs.sensor, RangeBearing | Range | Bearing), not inputs.time_is_index, observed)


def explanations(findings: Sequence[Finding], terms: Terms) -> tuple[Finding, ...]:
    """Findings of known size in a person's units, in their order; of an estimator's phases the furthest off."""
    shown: dict[tuple[str, str], Finding] = {}
    for f in (f for f in findings if math.isfinite(f.size)):
        same = shown.get((f.kind, f.name))
        if same is None or abs(math.log(abs(f.size))) > abs(math.log(abs(same.size))):
            shown[f.kind, f.name] = f
    return tuple(in_unit(f, terms) for f in shown.values())


def main_findings(trust: Trust) -> list[Finding]:
    """The finding that removes most, and the weightiest systematic error if that is another one, for a first page.
    Without replicates what is indicated; none where the cause cannot be determined.
    """
    if trust.blame is None:
        return [f for f in (trust.indicated,) if f is not None]
    if trust.blame.cause in (NOTHING, CONTRADICTED, UNLISTED, UNTELLABLE):
        return []
    first, rest = list(trust.blame.findings[:1]), trust.blame.findings[1:]
    return first + [f for f in rest if f.kind == "systematic" and first[0].kind != "systematic"][:1]


def in_unit(finding: Finding, terms: Terms) -> Finding:
    """A finding with the size of a systematic error in a person's unit instead of SI units."""
    if finding.kind != "systematic":
        return finding
    unit, factor = terms.unit(finding.name)
    parts = tuple(in_unit(part, terms) for part in finding.parts)
    return replace(finding, size=factor * finding.size, error=factor * finding.error, unit=unit, parts=parts)


def of_trial(trial: Trial, diagnoses: Sequence[Trust]) -> list[Trust]:
    """The diagnoses of a log and task: all association methods with replicates, else the first one."""
    own = [t for t in diagnoses if (t.log, t.task) == (trial.log.name, trial.task) and trial.variant_of is None]
    order = associations(trial.runs)
    own.sort(key=lambda t: order.index(t.association) if t.association in order else len(order))
    asked = [t for t in own if t.twins or any(n.code == Code.NO_TWINS for n in t.notices)]
    return asked or [t for t in own if online(t)][:1]


def online(trust: Trust) -> list[str]:
    """Estimators that have a distance from the smoothed path, filters first."""
    names = (*ESTIMATORS, *(name for name in trust.real.apart if name not in ESTIMATORS))
    found = [name for name in names if math.isfinite(trust.real.apart.get(name, math.nan))]
    return sorted(found, key=lambda name: name not in FILTERS)


ODOMETRY, SENSOR = "odometry", "sensor"


def cause_word(trust: Trust) -> str:
    """The violated assumption (of noise, its side), or what is indicated without replicates; "": a smoother failed."""
    blame = trust.blame
    if blame is None and not trust.real.failures.keys().isdisjoint((PLAIN, STAND_IN)):
        return UNTELLABLE
    if blame is None:
        return NOTHING if trust.indicated is None else side_of(trust.indicated)
    if blame.cause in (NOTHING, ASSOCIATIONS, CONTRADICTED, ESTIMATOR, UNLISTED, UNTELLABLE):
        return blame.cause
    found = next((f for f in blame.findings if f.cause == blame.cause), None)
    if found is not None:
        return side_of(found)
    # no finding has a name: the side of most residuals outside the range of the replicates
    sides = [side(name.split("_", 1)[1]) for _, name in blame.objected if name.startswith(("slope_", "residual_"))]
    return max(dict.fromkeys(sides), key=sides.count, default=SENSOR)


def side_of(found: Finding) -> str:
    """What a finding is a fault of: odometry, sensor, map, time stamps, pairings, a source of fixes or closures."""
    if found.cause == ASSOCIATIONS:
        return ASSOCIATIONS
    if found.name in LATE:
        return "time stamps"
    return "map" if found.kind in ("displaced", "landmark") or found.name == "map_scale" else side(found.name)


def side(component: str) -> str:
    """Whether a component belongs to odometry, to the sensor, or to a source of fixes or closures (its name)."""
    if (source := source_in(component)) is not None:
        return source
    return ODOMETRY if component.startswith("odometry") else SENSOR
