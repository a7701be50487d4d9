"""A log against its twins: p value of every statistic, and the cause of rejections."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import scipy

from association.decide import known_decisions
from data.inputs import CLUTTER, Inputs, LabelledObservations
from data.log import Log
from data.motion.systematic import corrected_inputs
from data.notice import Code, Notice, notice
from data.questions.asked import conventions
from data.questions.readings import Kind
from data.questions.witnesses import BY_TRUTH
from data.result import Run
from data.se2 import Array, BoolArray
from ekf.whole_run import run_filter
from eval.referee import attribution, battery, effects, explanations, residuals, truth_free
from eval.referee.attribution import Finding
from eval.referee.consistency import NEES_LIMIT
from eval.referee.explanations import Evidence
from eval.referee.plausibility import with_plausibility
from eval.referee.residuals import COMPONENTS, Used
from eval.referee.result_files import TRUST
from eval.referee.sources import has_sources, of_sources
from eval.referee.truth_free import Key, Statistic
from eval.replay.batch import batch
from eval.replay.settings import Setup
from eval.studies.twins import PLAIN, STAND_IN, Sample, inputs_of, source_of, twin
from graph.qr.score_test import evidence

SHARES = ("semidefinite", "inside_x", "inside_y", "inside_theta")
"""How statistics end that are shares of frames: next to discrete, and left out of the family."""
FEWEST, SURE_OF_IT = 19, 39  # Least numbers of twins for a family-wise level of 5 %, and for one of half that


@dataclass(frozen=True)
class Row:
    """A line of trust.csv, without log, task and association."""

    estimator: str
    statistic: str
    measured: Statistic
    expected: float
    twins: int
    p: float
    p_family: float


@dataclass(frozen=True)
class Blame:
    """Diagnosis of a log."""

    cause: str  # `NOISE`, `ASSOCIATIONS`, `ESTIMATOR`, `NOTHING`, `CONTRADICTED`, `UNTELLABLE` or `UNLISTED`
    findings: tuple[Finding, ...]  # what removes most, then others in the order of correction, and other causes
    objected: tuple[Key, ...]  # statistics rejected family-wise; `tested`: their number in all
    tested: int
    p: float  # the smallest family-wise p value
    contradictions: tuple[Notice, ...] = ()  # of the log with itself; where there are some, they are the cause


@dataclass(frozen=True, eq=False)
class Trust:
    """One log with one association method: its statistics, those of its twins, and the diagnosis."""

    log: str
    task: str
    association: str
    real: Sample
    twins: tuple[Sample, ...]
    rows: tuple[Row, ...]  # of trust.csv
    blame: Blame | None = None  # None without enough twins
    notices: tuple[Notice, ...] = ()  # why something is missing
    indicated: Finding | None = None  # what explains most of the residuals, without replicates


def judged(log: Log, task: str, association: str, real: Sample, twins: Sequence[Sample], smoother: Run | None) -> Trust:
    """P values of all statistics, and the cause; `smoother` as in `sample_of`."""
    keys = list(real.measured)
    values, drawn, z, theory, compared = _beside(real, twins)
    family = np.full(len(keys), np.nan)
    correlation = _correlation(keys, inputs_of(log, task, association), smoother) if theory.any() else np.eye(len(keys))
    among = correlation[np.ix_(compared, compared)]
    family[compared] = battery.shared_p(values[compared], drawn[:, compared], z[compared], theory[compared], among)
    rows = []
    for i, (estimator, name) in enumerate(keys):
        m, own = real.measured[estimator, name], drawn[:, i]
        known = own[np.isfinite(own)]
        expected = m.expected if math.isfinite(m.expected) or not len(known) else float(np.median(known))
        p_family = float(family[i]) if len(known) else math.nan
        rows.append(Row(estimator, name, m, expected, len(known), battery.rank_p(m.value, own), p_family))
    notices = _failures(log, real, twins)
    if smoother is not None and smoother.estimator == STAND_IN:
        notices += (notice(Code.STOOD_IN, stand_in=STAND_IN).about(estimator=PLAIN),)
    made = Trust(log.name, task, association, real, tuple(twins), tuple(rows), notices=notices)
    if smoother is None or smoother.flaw is not None:
        return made
    inputs = inputs_of(log, task, association)
    made = replace(made, indicated=_indicated(inputs, smoother, real.measured))
    return made if len(twins) < FEWEST else replace(made, blame=_blame(log, made, inputs, smoother))


def _beside(real: Sample, twins: Sequence[Sample]) -> tuple[Array, Array, Array, BoolArray, BoolArray]:
    """Statistics (S,), those of twins (N, S), distances (S,) in standard errors, which have these, which are tested."""
    keys = list(real.measured)
    values = np.array([m.value for m in real.measured.values()])
    drawn = np.array([[_value(s, k) for k in keys] for s in twins]).reshape(len(twins), len(keys))
    z = np.array([m.off for m in real.measured.values()])
    theory = np.array([name.startswith(("slope_", truth_free.LARGEST)) for _, name in keys], bool) & np.isfinite(z)
    return values, drawn, z, theory, np.array([not name.endswith(SHARES) for _, name in keys], bool)


EXCEEDED = 5  # Twins beyond the log's largest statistic that end a test (Besag, Clifford 1991); 3 of 99: no rejection
BEYOND = 10.0  # spreads of the twins beyond which no more of them will be
LOW, HIGH = 0.01, battery.LEVEL  # family-wise p value of slopes that rejects, or not, whatever share they have


def settled(real: Sample, twins: Sequence[Sample], slopes: float = 1.0) -> bool:
    """Whether more twins would not change a rejection (sequential Monte Carlo test); `slopes`: see `slopes_p`."""
    values, drawn, _, theory, compared = _beside(real, twins)
    largest, exceeded = list[float](), list[int]()
    for which in (compared & ~theory, compared):  # few twins are compared in slopes, too
        own, others = battery.evened(*battery.standardized(values[which], drawn[:, which]))
        largest.append(float(own.max(initial=0.0)))
        exceeded.append(int((others.max(axis=1, initial=0.0) >= largest[-1]).sum()))
    if slopes < LOW or largest[0] > BEYOND:
        return len(twins) >= SURE_OF_IT
    return slopes > HIGH and min(exceeded) >= EXCEEDED


def slopes_p(log: Log, task: str, association: str, real: Sample, smoother: Run | None) -> float:
    """Smallest family-wise p value of the statistics that have a standard error, which needs no twins; 1: no such."""
    _, _, z, theory, _ = _beside(real, ())
    if not theory.any():
        return 1.0
    correlation = _correlation(list(real.measured), inputs_of(log, task, association), smoother)
    return float(battery.gaussian_p(z[theory], correlation[np.ix_(theory, theory)]).min())


def _correlation(keys: Sequence[Key], inputs: Inputs, smoother: Run | None) -> Array:
    """Correlation (S, S) of statistics: of the slopes from their joint information, else none."""
    result = np.eye(len(keys))
    if smoother is None or smoother.flaw is not None or smoother.final is None:
        return result
    found = effects.scored(inputs, _path(smoother), residuals.used_by(smoother, inputs), smoother.errors_final)
    place = {name: i for i, name in enumerate(found.names)}
    rows = [i for i, (_, name) in enumerate(keys) if name.removeprefix("slope_") in place and name.startswith("slope_")]
    own = [place[keys[i][1].removeprefix("slope_")] for i in rows]
    information = found.score.information[np.ix_(own, own)]
    scale = np.sqrt(np.diag(information))
    known = scale > 0.0
    at = np.array(rows, np.int64)[known]
    result[np.ix_(at, at)] = information[np.ix_(known, known)] / np.outer(scale[known], scale[known])
    return result


def _value(sample: Sample, key: Key) -> float:
    """A statistic of a twin, NaN if it has none; a robust stand-in is compared with the twins' own smoother."""
    if key not in sample.measured and key[0] == STAND_IN:
        key = (PLAIN, key[1])
    return sample.measured[key].value if key in sample.measured else math.nan


def _failures(log: Log, real: Sample, twins: Sequence[Sample]) -> tuple[Notice, ...]:
    found = []
    if not truth_free.regular(log.recorded.prior.covariance[None])[0]:
        found.append(notice(Code.EXACT_PRIOR))
    found += [notice(Code.NOT_MEASURED, why=why).about(estimator=name) for name, why in real.failures.items()]
    for name in dict.fromkeys(name for s in twins for name in s.failures):
        failed = sum(name in s.failures for s in twins)
        found.append(notice(Code.NOT_MEASURED_ON_TWINS, failed=failed, twins=len(twins)).about(estimator=name))
    return tuple(found)


MOSTLY = 0.5  # share of the largest gain that the finding of a plain run must have to be the head with replicates, too
FIRST = 0.1  # share of a noise's gain from which a systematic error is the head
LOOKED_AT, OFF = 3.0, 0.05
"""Standard errors of a slope, and share of a spread or NIS, beyond which a plain run looks for an explanation."""


def _indicated(inputs: Inputs, smoother: Run, measured: Mapping[Key, Statistic]) -> Finding | None:
    """What gains most by the residuals alone; None where nothing stands out."""
    apart = [m.value / m.expected for (_, n), m in measured.items() if n == "nis"]
    apart += [m.value for (_, n), m in measured.items() if n.startswith("residual_") and n.endswith("_spread")]
    slopes = [abs(m.off) for (_, n), m in measured.items() if n.startswith("slope_") and math.isfinite(m.off)]
    if max(slopes, default=0.0) < LOOKED_AT and not any(v > 1.0 + OFF or v < 1.0 - OFF for v in apart):
        return None
    inputs = _less(inputs, smoother)
    e = explanations.evidence_of(inputs, _path(smoother), residuals.used_by(smoother, inputs))
    without = noiseless(inputs)
    found = [
        (x.net, x.finding) for x in explanations.explanations(e, []) if x.net > explanations.ALIKE
        and x.finding.name not in without and not (x.finding.said == "sigma odometry" and without)
    ]  # fmt: skip
    if not found:
        return None
    best = max(_leading(found), key=lambda x: x[0])[1]
    outliers, elsewhere, more = residuals.misfits(inputs, e.path, e.used, e.residuals)
    if best.kind == "tails" and 2 * elsewhere >= max(outliers, FEWEST_OUTLIERS) and more > MOSTLY * best.gain:
        return Finding(attribution.ASSOCIATIONS, "pairings", "readings", elsewhere, gain=best.gain)
    if best.kind != "sigma" or has_sources(inputs):
        return best
    return _fitted(e, smoother, _likelihood(inputs, e.used, smoother), best, inputs)[0]


def noiseless(inputs: Inputs) -> tuple[str, ...]:
    """Components of the odometry with the least variance that is possible: linearization alone leaves more."""
    variance = np.einsum("nii->ni", inputs.increments.covariance[1:])
    least = np.isclose(np.median(variance, axis=0), inputs.covariance_floor) if len(variance) else np.zeros(3, bool)
    return tuple(name for name, own in zip(COMPONENTS, least.tolist(), strict=False) if own)


def _blame(log: Log, made: Trust, inputs: Inputs, smoother: Run) -> Blame:
    tested = [r for r in made.rows if math.isfinite(r.p_family)]
    objected = tuple((r.estimator, r.statistic) for r in tested if r.p_family <= battery.LEVEL)
    p = min((r.p_family for r in tested), default=math.nan)
    findings: list[Finding] = []
    removed = True
    contradictions = contradicted(log) if objected else ()
    if contradictions:
        return Blame(attribution.CONTRADICTED, (), objected, len(tested), p, contradictions)
    if objected:
        findings, removed = _explained(log, made, inputs, smoother)
    mispaired: list[Finding] = []
    if made.association != "known":
        names = dict.fromkeys(name for s in made.twins for name in s.counts)
        mispaired = attribution.decision_errors({n: [s.counts[n] for s in made.twins if n in s.counts] for n in names})
    findings = _head_first(findings, made.indicated) + mispaired + _estimators(made.twins)
    cause = attribution.NOTHING
    # the smoother is lost on most twins, though their noise is as stated: the solution itself is broken
    nees = [s.nees[PLAIN, "final"] for s in made.twins if (PLAIN, "final") in s.nees]
    if objected and nees and float(np.median(nees)) > NEES_LIMIT:
        cause = attribution.UNTELLABLE
    elif mispaired and not objected:
        pass  # a method's errors on this geometry with everything as stated: no finding about the log
    elif not removed:
        cause = attribution.UNLISTED
    elif findings:
        cause = findings[0].cause
    elif objected:
        # no named cause: rejections of the smoother's residuals are due to the log, others to the estimator
        cause = attribution.NOISE if any(e == smoother.estimator for e, _ in objected) else attribution.ESTIMATOR
    return Blame(cause, tuple(findings), objected, len(tested), p)


def contradicted(log: Log) -> tuple[Notice, ...]:
    """How the log contradicts itself; an order of turn and way that observations tell competes with explanations."""
    return tuple(n for n in conventions(log) if n.named.get("kinds") != (Kind.ORDER,) or n.named["witness"] == BY_TRUTH)


def _head_first(findings: Sequence[Finding], indicated: Finding | None) -> list[Finding]:
    """The finding that removes most, or that of a plain run where it removes about as much; then all others."""
    most = max((f.gain for f in findings), default=0.0)
    chosen = [f for _, f in _leading([(f.gain, f) for f in findings])]
    alike = [f for f in chosen if indicated is not None and f.said == indicated.said and f.gain >= MOSTLY * most]
    head = max(alike or chosen, key=lambda f: f.gain, default=None)
    return [f for f in (head,) if f is not None] + [f for f in findings if f is not head]


def _leading(found: Sequence[tuple[float, Finding]]) -> list[tuple[float, Finding]]:
    """Findings with gains that may lead: systematic errors near the largest (they make noise look larger), else all."""
    most, top = max(found, key=lambda x: x[0], default=(0.0, None))
    smaller = top is not None and top.kind == "sigma" and top.size < 1.0
    if top is not None and top.kind == explanations.CORRELATION:
        most *= (1.0 + top.size) / max(1.0 - top.size, 0.02)  # gains of systematic errors are so many times too large
    return [x for x in found if x[1].kind == "systematic" and x[0] >= FIRST * most and not smaller] or [*found]


def _estimators(twins: Sequence[Sample]) -> list[Finding]:
    """Estimators that are inconsistent on the twins, in NEES, or else in NIS."""
    nees = {k: [s.nees[k] for s in twins if k in s.nees] for k in dict.fromkeys(k for s in twins for k in s.nees)}
    found = attribution.estimator_errors(nees)
    nis: dict[str, list[float]] = {}
    for m, estimator in ((s.measured[k], k[0]) for s in twins for k in s.measured if k[1] == "nis"):
        nis.setdefault(estimator, []).append(m.value / m.expected)
    convicted = {f.name for f in found}
    return found + [f for f in attribution.innovation_errors(nis) if f.name not in convicted]


Tried = tuple[float, Finding, Inputs]  # Logarithm of the odds of an explanation, and the inputs corrected by it
ROUNDS = 4  # explanations, one after the other
WIDE, STEP = 0.7, 0.05  # of the logarithm of a sigma: half the range it is looked for in, and that of its curvature
TRIED = 3  # explanations of a kind whose likelihood is computed
HOPELESS = 10.0  # the likelihood is not computed where the log odds are less than the best ones over this
FEWEST_OUTLIERS = 2  # one outlier is no evidence for another model
ELSEWHERE = 0.1  # share of a smoother's outliers that fit another landmark, below which a robust one is not asked
GROSS = 50.0  # half of ten sigma squared; outliers with a larger mean excess are no tail of noise: it is asked, too
REFINED = 2  # explanations of a log with sources that are estimated anew
ENOUGH = 3e-3  # sigma, over all directions: a shorter step of a smoother changes no statistic visibly
FAR = 10.0  # standard errors of a systematic error beyond which it is linearized anew
STANDS_OUT = 6.0  # standard deviations, above which a statistic of a corrected log still stands out
REMOVED = 0.5  # share of the strongest objection that an explanation has to take away


def _explained(log: Log, made: Trust, inputs: Inputs, smoother: Run) -> tuple[list[Finding], bool]:
    """Explanations one after the other, each with earlier ones corrected, and whether they remove the objections."""
    inputs = _less(inputs, smoother)
    smoother = with_all_sources(replace(smoother, errors_final=None), inputs)
    usual, spread = _usual_and_spread([_statistics(s.measured) for s in made.twins])
    before = _furthest(_statistics(made.real.measured), usual, spread)
    findings: list[Finding] = []
    for _ in range(2 * ROUNDS):  # systematic errors must leave room for noises
        evidence = explanations.evidence_of(inputs, _path(smoother), residuals.used_by(smoother, inputs))
        best = _best(evidence, smoother, _taken(findings))
        if best is None:
            break
        found, inputs = best
        findings += [f for f in found if not any((f.said, f.frames) == (g.said, g.frames) for g in findings)]
        if found[-1].kind == explanations.CORRELATION:
            return findings, True  # correlated errors are not whitened, so nothing is comparable any more
        refitted = _refitted(inputs, smoother)
        if refitted is None:
            break
        smoother = refitted
    left = _in_errors(truth_free.of_smoother(smoother, inputs))
    after = _furthest(left, usual, spread)
    most = max(REMOVED * before, STANDS_OUT)
    if after >= most and any(f.kind != "systematic" for f in findings):
        # another noise changes every statistic, so the corrected log has replicates of its own
        source = source_of(replace(log, recorded=replace(inputs, map=log.recorded.map)), smoother, (), Setup())
        drawn = (inputs_of(twin(source, seed), made.task, made.association) for seed in range(FEWEST))
        runs = ((again, own) for own in drawn if (again := _refitted(own, smoother)) is not None)
        usual, spread = _usual_and_spread([_in_errors(truth_free.of_smoother(*each)) for each in runs])
        after = _furthest(left, usual, spread)
    return findings, after < most


def _less(inputs: Inputs, smoother: Run) -> Inputs:
    """The inputs without the systematic errors that the smoother estimated along."""
    return replace(corrected_inputs(inputs, smoother.errors_final), systematic=None)


def _taken(findings: Sequence[Finding]) -> list[str]:
    """Systematic errors that are estimated already."""
    return [name for f in findings if f.kind == "systematic" for name in f.sizes]


def with_all_sources(smoother: Run, inputs: Inputs) -> Run:
    """The smoother with the fixes and closures, too, that a gate left out: they may be outliers of their source."""
    found = (each for each in (smoother.fixes_final, smoother.closures_final) if each is not None)
    return smoother if all(each.used.all() for each in found) else _refitted(inputs, smoother) or smoother


def _best(e: Evidence, smoother: Run, taken: Sequence[str]) -> tuple[list[Finding], Inputs] | None:
    """The explanation of the best odds (of each kind a few are tried), and the inputs corrected by it; None: none."""
    found = explanations.explanations(e, taken)
    linear = has_sources(e.inputs)
    stated = _linear(e.inputs, e.used, e.path) if linear else _likelihood(e.inputs, e.used, smoother)
    count = Counter[str]()
    tried: list[Tried] = []
    for x in [*found, explanations.mirrored(e)]:
        count[x.finding.kind] += 1
        promising = x.finding.said in (explanations.SCALE, "mirrored z2") or x.net > max(found[0].net / HOPELESS, 0.0)
        if (count[x.finding.kind] > TRIED and x.finding.said != explanations.SCALE) or not promising:
            continue
        finding, inputs = x.finding, explanations.corrected(e, x.finding)
        if not linear:
            inputs, finding = _exactly(inputs, smoother, finding)
        if finding.kind in explanations.MODELLED:
            now = _linear(inputs, e.used, e.path) if linear else _likelihood(inputs, e.used, smoother)
            finding = replace(finding, gain=now - stated)
        tried.append((x.net - x.finding.gain + finding.gain, finding, inputs))
    if linear:
        tried = _refined(tried, e, smoother, stated)
    # a correlation, or tails, stand beyond a scale whose likelihood is now known
    rough = {x.finding.said: x.net for x in found}
    more = next((net - rough[f.said] for net, f, _ in tried if f.said == explanations.SCALE and f.said in rough), 0.0)
    tried = [(net if f.kind in explanations.MODELLED else net + more, f, inputs) for net, f, inputs in tried]
    mispaired = _mispaired(e, smoother, stated)
    # outliers that fit another landmark are no tails
    tried = [t for t in tried if t[0] > 0.0 and not (mispaired and t[1].kind == "tails")]
    tried += [t for t in (*mispaired, *_false(e, smoother, stated)) if t[0] > 0.0]
    best = max(tried, key=lambda t: t[0], default=None)
    if best is None:
        return None
    finding, inputs = _fitted(e, smoother, stated, best[1], best[2])
    # systematic errors are looked for first: they make noise look larger, or last, and odometry jump
    hidden = (
        _systematic(e, smoother, taken, inputs) if finding.kind in (*explanations.NOISES, "jump", "burst") else None
    )
    return hidden or ([finding], inputs)


def _systematic(e: Evidence, smoother: Run, taken: Sequence[str], noisy: Inputs) -> tuple[list[Finding], Inputs] | None:
    """Systematic errors at the `noisy` inputs, as too large stated noise hides them, and the stated inputs without."""
    findings, inputs = list[Finding](), e.inputs
    while len(findings) < ROUNDS:
        refitted = _refitted(noisy, smoother)
        if refitted is None:
            break
        smoother = refitted
        own = explanations.evidence_of(noisy, _path(smoother), residuals.used_by(smoother, noisy))
        new = [x for x in explanations.explanations(own, [*taken, *_taken(findings)]) if x.finding.kind == "systematic"]
        nets = [x.net + x.finding.gain * (1.0 / explanations.excess(own, x.finding.name) - 1.0) for x in new]
        best = int(np.argmax(nets)) if nets else -1
        if best < 0 or not nets[best] > explanations.ALIKE:
            break
        less, finding = _exactly(explanations.corrected(own, new[best].finding), smoother, new[best].finding)
        gain = _likelihood(less, own.used, smoother) - _likelihood(noisy, own.used, smoother)
        least = explanations.ALIKE + new[best].finding.gain - new[best].net
        if not gain / explanations.excess(own, finding.name) > least:
            break
        findings.append(replace(finding, gain=gain))
        noisy, inputs = less, effects.without(inputs, own.path, own.used, finding.sizes)
    return (findings, inputs) if findings else None


def _fitted(e: Evidence, smoother: Run, stated: float, finding: Finding, inputs: Inputs) -> tuple[Finding, Inputs]:
    """A sigma of the largest likelihood, with its standard error: smoothed residuals understate how wrong it is."""
    if finding.kind != "sigma":
        return finding, inputs

    def lost(log_factor: float) -> float:
        return -_likelihood(explanations.corrected(e, replace(finding, size=math.exp(log_factor))), e.used, smoother)

    middle = math.log(finding.size)
    for _ in range(ROUNDS):  # where noise is much too large residuals hardly tell how much: the best size is far away
        bounds = middle - WIDE, middle + WIDE
        found = scipy.optimize.minimize_scalar(lost, bounds=bounds, method="bounded", options={"xatol": 0.01})
        if not math.isfinite(found.fun):
            return finding, inputs
        if abs(found.x - middle) < WIDE - STEP:
            break
        middle = float(found.x)
    curvature = (sum([lost(found.x + step) for step in (-STEP, STEP)]) - 2.0 * found.fun) / STEP**2
    size = math.exp(found.x)
    error = size / math.sqrt(curvature) if curvature > 0.0 else math.nan
    fitted = replace(finding, size=size, error=error, gain=-found.fun - stated)
    return fitted, explanations.corrected(e, fitted)


def _exactly(inputs: Inputs, smoother: Run, finding: Finding) -> tuple[Inputs, Finding]:
    """A systematic error too large for one linearization is estimated once more at the solution without it."""
    shared = any(len(column) > 1 for column in explanations.VECTORS.get(finding.name, ()))  # that of odometry is linear
    if finding.kind != "systematic" or shared or not abs(finding.size) > FAR * finding.error:
        return inputs, finding
    refitted = _refitted(inputs, smoother)
    if refitted is None:
        return inputs, finding
    used, path = residuals.used_by(refitted, inputs), _path(refitted)
    scored, names = effects.scored(inputs, path, used), list(finding.sizes)
    if not set(names) <= set(scored.names):
        return inputs, finding
    more, errors = scored.together(np.array([scored.names.index(name) for name in names], np.int64))
    less = effects.without(inputs, path, used, dict(zip(names, more.tolist(), strict=True)))
    sizes = np.array(list(finding.sizes.values())) + more
    if not finding.parts:
        return less, replace(finding, size=float(sizes[0]), error=float(errors[0]))
    size = float(np.hypot(*sizes)) if finding.name.rpartition("/")[2] in explanations.LENGTHS_OF else float(sizes[0])
    parts = tuple(
        replace(p, size=float(s), error=float(q)) for p, s, q in zip(finding.parts, sizes, errors, strict=True)
    )
    return less, replace(finding, size=size, error=float(errors[0]), parts=parts)


def _refined(tried: Sequence[Tried], e: Evidence, smoother: Run, stated: float) -> list[Tried]:
    """The same with the best ones estimated anew: with many sources this is too slow for all."""
    order = sorted(tried, key=lambda t: -t[0])
    refined = []
    for net, rough, linear in [t for t in order if t[1].kind in explanations.MODELLED][:REFINED]:
        inputs, finding = _exactly(linear, smoother, rough)
        gain = _likelihood(inputs, e.used, smoother) - stated
        refined.append((net - rough.gain + gain, replace(finding, gain=gain), inputs))
    return refined + [t for t in order if t[1].kind not in explanations.MODELLED]


def _linear(inputs: Inputs, used: Used, path: Array) -> float:
    """Log-likelihood of inputs with fixes or closures, at a smoothed solution."""
    of_poses = effects.poses_of(inputs, used)
    assert of_poses is not None
    return evidence(inputs, used.number, path, used.landmarks, of_poses)


def _false(e: Evidence, smoother: Run, stated: float) -> list[Tried]:
    """Outliers among the fixes or closures of each source, left out; they are those of a robust smoother."""
    inputs, outliers = e.inputs, dict[str, BoolArray]()
    for _ in range(ROUNDS if has_sources(inputs) else 0):
        robust = _refitted(inputs, smoother, STAND_IN)
        if robust is None:
            return []
        found = explanations.outlying(of_sources(inputs, _path(robust), residuals.used_by(robust, inputs)), inputs)
        for key, rows in found.items():
            outliers[key] = outliers.get(key, np.zeros(len(rows), bool)) | rows
            inputs = explanations.left_out(inputs, key, rows)
        if not found:
            break
    tried = []
    for key, rows in outliers.items():
        inputs = explanations.left_out(e.inputs, key, rows)
        x = explanations.of_outliers(e, key, int(rows.sum()), _likelihood(inputs, e.used, smoother) - stated)
        tried.append((x.net, x.finding, inputs))
    return tried


def _mispaired(e: Evidence, smoother: Run, stated: float) -> list[Tried]:
    """Outliers most of which fit another landmark, left out one after the other; those of a robust smoother."""
    outliers, elsewhere, more = residuals.misfits(e.inputs, e.path, e.used, e.residuals)
    asked = elsewhere >= ELSEWHERE * outliers or more >= GROSS * outliers  # a bent map fits no landmark
    inputs, wrong, all_of_them = e.inputs, 0, 0
    for _ in range(ROUNDS if outliers >= FEWEST_OUTLIERS and asked else 0):
        robust = _refitted(inputs, smoother, STAND_IN)
        if robust is None:
            return []
        used, path = residuals.used_by(robust, inputs), _path(robust)
        found = residuals.smoothed_residuals(inputs, path, used)
        outlying, elsewhere, _ = residuals.misfits(inputs, path, used, found)
        if not outlying:
            break
        o, far = inputs.observations, found.squared > residuals.OUTLYING
        R = np.where(far[:, None, None], explanations.UNINFORMATIVE * o.R, o.R)
        inputs = replace(inputs, observations=replace(o, R=R))
        wrong, all_of_them = wrong + elsewhere, all_of_them + outlying
    if all_of_them < FEWEST_OUTLIERS or 2 * wrong < all_of_them:
        return []
    # a landmark that begins with such an observation would be linearized anywhere, so they are not paired at all; each
    # has the density of a measurement that says nothing
    unused = inputs.observations.R[:, 0, 0] > e.inputs.observations.R[:, 0, 0]
    density = -math.log(2.0 * math.pi) - 0.5 * np.linalg.slogdet(inputs.observations.R[unused])[1]
    rest = replace(e.used, number=np.where(unused, -1, e.used.number))
    gain = _likelihood(inputs, rest, smoother) + float(density.sum()) - stated
    if has_sources(inputs):  # these have a density of their own there, as they stay
        gain -= float(density.sum())
    return [(gain, Finding(attribution.ASSOCIATIONS, "pairings", "readings", wrong, gain=gain), inputs)]


def _likelihood(inputs: Inputs, used: Used, smoother: Run) -> float:
    """Log-likelihood of a filter's innovations, beside fixes or closures of all data; minus infinity if it fails."""
    if has_sources(inputs):
        again = _refitted(inputs, smoother)
        return -math.inf if again is None else _linear(inputs, residuals.used_by(again, inputs), _path(again))
    o = inputs.observations
    label = np.where(used.number >= 0, used.identity[np.maximum(used.number, 0)], CLUTTER)
    labelled = replace(inputs, observations=LabelledObservations(o.frame, o.z, o.R, label))
    run = run_filter(labelled, known_decisions(labelled)[0])
    return float(run.log_likelihood.sum()) if run.failure is None else -math.inf


def _refitted(inputs: Inputs, smoother: Run, estimator: str = PLAIN) -> Run | None:
    """A smoother under the same decisions; None where it fails or is implausible."""
    again = batch(estimator, inputs, replace(smoother, online=smoother.final), enough=ENOUGH)
    again = with_plausibility(again, inputs)
    return again if again.flaw is None else None


def _statistics(measured: Mapping[Key, Statistic]) -> dict[str, float]:
    return _in_errors({name: m for (estimator, name), m in measured.items() if estimator == PLAIN})


def _in_errors(measured: Mapping[str, Statistic]) -> dict[str, float]:
    return {n: m.value / m.se if n.startswith("slope_") and m.se > 0.0 else m.value for n, m in measured.items()}


def _furthest(own: Mapping[str, float], usual: Mapping[str, float], sd: Mapping[str, float]) -> float:
    """Largest distance of a statistic from the usual one, in the replicates' standard deviations."""
    return max((abs(own[n] - usual[n]) / sd[n] for n in own if n in usual and sd.get(n, 0.0) > 0.0), default=0.0)


def _usual_and_spread(found: Sequence[Mapping[str, float]]) -> tuple[dict[str, float], dict[str, float]]:
    values = {name: [f[name] for f in found if name in f] for name in dict.fromkeys(n for f in found for n in f)}
    return {n: float(np.median(v)) for n, v in values.items()}, {n: float(np.std(v)) for n, v in values.items()}


def _path(smoother: Run) -> Array:
    assert smoother.final is not None
    return smoother.final.pose


def trust_table(all_trust: Sequence[Trust]) -> pd.DataFrame:
    """The table trust.csv."""
    rows = []
    for t in all_trust:
        for r in t.rows:
            m = r.measured
            who = {"log": t.log, "task": t.task, "estimator": r.estimator, "association": t.association}
            statistic = {
                "statistic": r.statistic, "value": m.value, "se": m.se, "frame": m.frame if m.frame >= 0 else None,
            }  # fmt: skip
            rows.append(who | statistic | {"expected": r.expected, "twins": r.twins, "p": r.p, "p_family": r.p_family})
    return TRUST.table(rows)
