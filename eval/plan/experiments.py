"""The plan of a run: given logs and scenarios, or the default suite (quick, normal or full)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from association.names import METHODS, SCAN
from data.command import stretch
from data.errors import UsageError
from data.log import Log, folder_name, shortened
from data.logs import Reading, as_scored, find_logs, open_log, open_scored
from data.wing import of_all
from eval.plan import experiment
from eval.plan.calibrate import check_calibrated
from eval.plan.experiment import Experiment, Work
from eval.plan.flags.table import DEFAULT_ESTIMATORS, QUICK_RUNS, Options, Selection
from eval.plan.results import NOTHING, Asked, asked_results, truth_alone
from eval.replay.estimators import FOR_SEVERAL, FOR_WALLS, NO_HINDSIGHT_OF_SEVERAL, NO_HINDSIGHT_OF_WALLS
from eval.replay.settings import HINDSIGHT, OF_SCANS
from eval.studies.scenario import Scenario, load_scenario
from eval.studies.shipped import scenarios

DEFAULT_RUNS = 50
VISUAL = ("dead-reckoning", "ekf", "ekf-iterated", "isam2", "batch")  # in a known map, from images
QUICK_FRAMES = 1000  # of each log, in a quick report


@dataclass(frozen=True)
class Plan:
    """Everything to do."""

    experiments: tuple[Experiment, ...]
    studies: tuple[tuple[Scenario, int], ...]  # scenarios to simulate, with their numbers of runs
    skipped: tuple[str, ...] = ()  # messages about work that cannot be done
    given: Asked = NOTHING  # results of other programs and their truth


def make_plan(options: Options, say: Callable[[str], None]) -> Plan:
    """Open the logs and plan the run; UsageError for an invalid combination."""
    s = options.selection
    experiment.load_all(s.estimator, s.association)
    experiment.introduce_all((*s.estimator, *s.association), options.results.result)
    for folder in s.data:
        if not Path(folder).is_dir():
            raise UsageError(f"--data {folder}: no such folder")
    if s.scenario:
        return _scenarios(options)
    relations = options.opening.relations
    if relations is not None and len(s.log) != 1:
        raise UsageError(f"--relations {relations}: belongs to one log; name one log")
    given = asked_results(options.results, s.log, s.data)
    alone = given.file is not None and not s.log
    if alone:
        experiments = [Experiment(truth_alone(given), "slam", (), options.setup)]
    elif s.lab is not None:
        asked_for = s.lab, s.estimator, options.setup, reading_of(options), say
        experiments = [e for plan in of_all("plans") for e in plan(*asked_for)]
    else:
        experiments = _teams(options, say) if s.cooperative else [] if s.log else _default(options, say)
    reading = reading_of(options)
    asked = [open_log(name, reading, say) for name in s.log if not s.cooperative]
    if asked and (given.results or given.file is not None):
        log, given = given.settled(asked[0])
        asked = [log]
    asked = [as_scored(log, reading) for log in (*asked, *(log for folder in s.data for log in _found(folder, say)))]
    if not s.task and (line := experiment.default_task_line(asked)):
        say(line)
    for log in asked:
        check_calibrated(log, options.setup.calibrate, s.association)
        experiment.check_possible_on(log, s.task, ())
        setup, tasks = options.setup.settled(log.labels_are_sensed), s.task or (experiment.default_task(log),)
        experiments += [Experiment(_cut(log, options), task, _work(log, s), setup) for task in tasks]
    _check_names(list(dict.fromkeys((id(e.log), e.log.name) for e in experiments)))
    experiment.check_maintained(options.setup, [e.task for e in experiments])
    experiment.check_possible(experiments)
    runs = options.study.runs
    if runs is None:
        runs = 0 if s.log or s.lab or alone else QUICK_RUNS if options.output.quick else DEFAULT_RUNS
    return Plan(tuple(experiments), ((load_scenario("arena"), runs),) if runs else (), given=given)


def _teams(options: Options, say: Callable[[str], None]) -> list[Experiment]:
    """Every robot of the teams that are named; UsageError if none is."""
    s = options.selection
    if not s.log:
        raise UsageError("--cooperative: of which robots? name a UTIAS MRCLAM dataset, or arena:SEED:robots=5")
    made = [e for name in s.log for f in of_all("teams") for e in f(name, s, options.setup, reading_of(options), say)]
    return [replace(e, log=_cut(e.log, options)) for e in made]


def _found(folder: str, say: Callable[[str], None]) -> list[Log]:
    """The logs of a folder; UsageError if there are none."""
    found = [load() for load in find_logs(Path(folder), say)]
    if not found:
        raise UsageError(f"--data {folder}: no dataset found; `slamref run FOLDER` runs one open log")
    return found


def _check_names(things: Sequence[tuple[int, str]], kind: str = "logs") -> None:
    """Raise UsageError for two of a kind (identity and name) whose folders would have the same name."""
    names = [name for _, name in things]
    for name in names:
        same = [n for n in names if folder_name(n) == folder_name(name)]
        if len(same) > 1:
            both, place = " and ".join(map(repr, dict.fromkeys(same))), "log.toml" if kind == "logs" else "file"
            what = f"two {kind} are named {both} (in file names : and + become _)"
            raise UsageError(f"{what}; rename one (the name stands in its {place})")


def _scenarios(options: Options) -> Plan:
    asked, estimators = options.selection, options.selection.estimator
    if options.study.runs == 0:
        raise UsageError("--runs 0: a scenario needs at least one run")
    studies: list[tuple[Scenario, int]] = []
    skipped = []
    names = scenarios() if "all" in asked.scenario else list(asked.scenario)
    for name in names:
        scenario = load_scenario(name)
        if estimators != ALL:
            scenario = scenario.only(estimators)
        skipped += experiment.check_scenario(scenario)
        runs = options.study.runs or (QUICK_RUNS if options.output.quick else scenario.runs)
        studies += [(part, runs) for part in scenario.parts()]
    _check_names([(i, s.name) for i, (s, _) in enumerate(studies)], "scenarios")
    experiment.introduce_all([text for s, _ in studies for text in (*(m.name for m in s.members), *s.association)])
    return Plan((), tuple(studies), tuple(skipped))


def _work(log: Log, asked: Selection) -> tuple[Work, ...]:
    """Every estimator with every given association method."""
    scans, points = log.recorded.scans is not None, len(log.recorded.observations.frame) > 0
    given = log.recorded
    walls, several = not given.sensor.sees_points, len(given.sensors) > 1 or not given.sensor.locates
    alone = SCAN if scans and not points else FOR_WALLS if walls else FOR_SEVERAL if several else HINDSIGHT
    associations = asked.association or (("known",) if log.has_labels else (alone,))
    if SCAN in associations and not scans:
        raise UsageError(f"--association {SCAN}: log {log.name!r} has no laser scans")
    experiment.check_possible_on(log, (), associations)
    if HINDSIGHT in associations and walls:
        raise UsageError(f"--association {HINDSIGHT}: log {log.name!r} has walls; {NO_HINDSIGHT_OF_WALLS}")
    if HINDSIGHT in associations and several:
        raise UsageError(f"--association {HINDSIGHT}: log {log.name!r}: {NO_HINDSIGHT_OF_SEVERAL}")
    scanned = tuple(e for e in asked.estimator if e in OF_SCANS)
    other = [e for e in asked.estimator if e not in OF_SCANS]
    # those that cannot use scans may have the landmarks
    if SCAN in associations and other and (len(associations) == 1 or not scanned):
        raise UsageError(f"--estimator {other[0]}: not for laser log {log.name!r}; name some of {', '.join(OF_SCANS)}")
    if asked.estimator == ALL:
        scanned = (*ALL, *ROBUST)
    return tuple(Work(a, scanned if a == SCAN else asked.estimator) for a in associations)


def _cut(log: Log, options: Options) -> Log:
    return shortened(log, QUICK_FRAMES) if options.output.quick else log


ALL = DEFAULT_ESTIMATORS
ROBUST = ("batch-cauchy", "gnc")  # further estimators of a laser log, where one wrong loop closure bends the whole map
DECIDING = ("ekf", "isam2", "batch")
KNOWN = (Work("known", ALL),)
WAYS = (*METHODS, HINDSIGHT)
HELPED = {"jcbb": DECIDING, HINDSIGHT: ("ekf", "batch")}
LAB = (*KNOWN, *(Work(m, HELPED.get(m, ("ekf",))) for m in WAYS))
"""Corridors: every method with the filter, some with smoothers, too."""
PARK = (*KNOWN, Work(HINDSIGHT, HELPED[HINDSIGHT]), Work("jcbb", ("ekf",)))
EVERYTHING = (*KNOWN, *(Work(m, DECIDING) for m in WAYS))
SHORT_GALLERY = 60  # frames of visual:0 in the default report
CORRIDORS = ("corridor:0", "corridor:0:people", "corridor:0:no-odometry", "corridor:0:people+no-odometry")
PRIMED = "corridor:0:no-odometry+forward"
PRIMED_WORK = (Work("known", ("ekf", "ekf-iterated", "isam2")), Work(HINDSIGHT, ("ekf-iterated",)))
"""The corridor with a motion prior instead of odometry."""


def reading_of(options: Options) -> Reading:
    """How logs are read."""
    o = options.opening
    relations = None if o.relations is None else Path(o.relations)
    cache = options.output.kept / ".detections"
    camera = (o.camera_translation, o.camera_reading, o.corner_noise, o.trust_pickle, cache)
    return Reading(*camera, relations, o.no_odometry, tuple(stretch(text) for text in o.exclude_truth), o.keep_truth)


def _default(options: Options, say: Callable[[str], None]) -> list[Experiment]:
    """The default suite; given estimators or association methods replace its own."""
    s, quick, full = options.selection, options.output.quick, options.study.full
    asked = bool(s.association) or s.estimator != ALL
    park: tuple[Work, ...] = KNOWN if quick else PARK
    corridors: tuple[str, ...] = CORRIDORS
    lab: tuple[Work, ...] = LAB
    arena: tuple[Work, ...] = KNOWN
    if quick:
        corridors, lab = ("corridor:0:people",), (*KNOWN, Work("nn", ("ekf",)), Work("jcbb", ("ekf",)))
    if full:
        park, lab, arena = EVERYTHING, EVERYTHING, EVERYTHING
    rows = [("victoria-park", "slam", park), ("arena:0", "localization", arena), ("arena:0", "slam", arena)]
    rows += [(name, "slam", lab) for name in corridors]
    if not quick:
        rows.append((PRIMED, "slam", PRIMED_WORK))
        rows.append((f"visual:0:frames={SHORT_GALLERY}", "localization", (Work("known", VISUAL),)))
    rows = [row for row in rows if not s.task or row[1] in s.task]
    logs = {name: _cut(open_scored(name, reading_of(options), say), options) for name, _, _ in rows}
    experiments = []
    for name, task, work in rows:
        log = logs[name]
        setup = options.setup.settled(log.labels_are_sensed)
        experiments.append(Experiment(log, task, _work(log, s) if asked else work, setup))
        if not asked and ":people" in name and not quick and not options.setup.manages_map:
            experiments.append(maintained(experiments[-1], lab if full else (Work("jcbb", ("ekf",)),)))
    return experiments


def maintained(plain: Experiment, work: tuple[Work, ...]) -> Experiment:
    """The variant with map maintenance."""
    name = plain.log.name
    deciding = tuple(w for w in work if w.association != "known")
    log, setup = replace(plain.log, name=f"{name}:maintain"), replace(plain.setup, maintain=True)
    return Experiment(log, plain.task, deciding, setup, name, "the same log with map maintenance (`--maintain`)")
