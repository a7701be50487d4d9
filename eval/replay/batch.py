"""Batch smoothers over the decisions of a front end, started at its path."""

import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from association.expectation import gate_threshold
from association.triangulate import Sights, met
from data.inputs import Inputs, IntArray
from data.notice import Code, notice, stopped
from data.result import DISCARD, Failure, Run, Trajectory, map_estimate, map_with
from data.se2 import Array, BoolArray
from eval.replay.settings import ESTIMATOR_TABLE
from graph.batch import PROBABILITY, chordal_path, gnc, smooth
from graph.factors import UnderConstrained
from graph.optimum import STEP, NotConvergedError, Smoothed
from graph.problem import Start

ASTRAY = 10.0  # sigmas that a filter claims for a landmark from which it began elsewhere than the smoother has it
LOWER = 1e-6  # relative difference of cost by which a lower minimum is another one


def batch(name: str, inputs: Inputs, front: Run, *others: Callable[[], Run], enough: float = STEP) -> Run:
    """A batch smoother over the final decisions of `front`, started at its path.

    If this finds no minimum, or a suspiciously high one, it also starts from the paths of `others` in turn, runs with
    the same landmark numbers or without a map. The lowest minimum counts. `gnc` discards rejected pairings, and
    landmarks without any observation left, and tests fixes and closures anew; the others leave out those that the front
    end's gate rejected, as they do with observations. Without observations there is no such front end, and all are
    used. Where there are closures a chordal path is a further start, and without observations the first one.
    `enough`: see `graph.optimum.optimize`.
    """
    begin, loss = time.perf_counter(), ESTIMATOR_TABLE[name].options["loss"]

    def failed(failure: Failure, seconds: float) -> Run:
        nothing = Trajectory(np.full((len(inputs), 3), np.nan), np.full((len(inputs), 3, 3), np.nan))
        return Run(
            name, front.association, front.task, None, nothing, None, front.decisions, front.final_decisions,
            front.created, None, None, None, seconds, failure, (), front.removed,
        )  # fmt: skip

    if front.online is None or (front.failure is not None and not np.isfinite(front.online.pose).all()):
        at = front.failure.frame if front.failure else 0
        return failed(Failure("incomplete", 0, notice(Code.FRONT_END_STOPPED, front=front.estimator, at=at)), 0.0)
    initialized = front.initialized  # retracted landmarks are left out; those that a filter merely forgot are smoothed
    start = start_at(inputs, front, initialized)
    final = front.final_decisions
    decides = front.estimator != "dead-reckoning"  # which is the front of logs without observations
    notes = [notice(Code.DECIDED_BY, front=front.estimator)] if decides else []
    own: list[Callable[[], Start]] = [lambda: start]
    if inputs.closures is not None:
        chordal = partial(_chordal, inputs, initialized)
        own = [*own, chordal] if (final >= 0).any() else [chordal, *own]
    try:
        if loss == "truncated":
            result, accepted = _least_truncated(inputs, final, initialized, own)
            number = np.where(initialized >= 0, initialized, final)
            if decides:
                notes.append(notice(Code.OBSERVATIONS_REJECTED, observations=int((~accepted & (number >= 0)).sum())))
            empty = ~np.isin(number, number[accepted])  # landmarks without any observation left
            left_out = (number >= 0) & np.where(initialized >= 0, empty, ~accepted)
            final, initialized = np.where(left_out, DISCARD, final), np.where(left_out, -1, initialized)
        else:
            further = [partial(_start_of, run, inputs, initialized) for run in others]
            # outside the front end's gate; fixes and closures that it could not use are none of these
            parts = ((inputs.fixes, front.fixes), (inputs.closures, front.closures))
            outside = np.concatenate([
                np.zeros(len(given or ()), bool) if done is None else np.isfinite(done.nis) & ~done.used
                for given, done in parts
            ])  # fmt: skip
            met = [partial(_chordal, inputs, initialized, final)] * (inputs.map is None and inputs.several_or_partial)
            result = _lowest(inputs, final, initialized, [*own, *further, *met], loss, outside, enough)
    except UnderConstrained as stop:
        return failed(Failure("diverged", 0, stopped(str(stop))), time.perf_counter() - begin)
    seconds = time.perf_counter() - begin
    gated = front.gated_final
    if result.gated is not None:  # residuals pass nearly the same test as innovations did: the narrower counts
        gated = min(result.gated, gated or front.gated)
    state = None
    if result.map is not None:
        found = result.map if inputs.map is None else map_with(inputs.map, result.map)
        state = map_estimate(found, inputs.observations.frame, final, initialized)
        if inputs.map is None and inputs.several_or_partial and front.map is not None:
            if unused := int((np.where(initialized >= 0, initialized, final) < 0).sum()):
                notes.append(notice(Code.OBSERVATIONS_UNUSED, observations=unused, of=len(final)))
            _, mine, theirs = np.intersect1d(state.number, front.map.number, return_indices=True)
            apart = front.map.xy[theirs] - state.xy[mine]
            weight = np.linalg.pinv(np.nan_to_num(front.map.covariance[theirs]))
            if (astray := np.einsum("ki,kij,kj->k", apart, weight, apart) > ASTRAY**2).any():
                far = float(np.hypot(*apart[astray].T).max())
                notes.append(notice(Code.BEGAN_ASTRAY, front=front.estimator, landmarks=int(astray.sum()), far=far))
    return Run(
        name, front.association, front.task, None, result.trajectory, state, front.decisions, final,
        front.created, None, result.total_nis, None, seconds, None, tuple(notes), front.removed, gated=front.gated,
        iterations=result.iterations, last_step_sigma=result.last_step, errors_final=result.systematic,
        begun=None if front.begun is None else initialized, gated_final=gated,
        left=front.left, fixes_final=result.fixes, closures_final=result.closures,
    )  # fmt: skip


def _least_truncated(
    inputs: Inputs, final: IntArray, initialized: IntArray, starts: Sequence[Callable[[], Start]]
) -> tuple[Smoothed, BoolArray]:
    """`gnc` from each start; the lowest truncated cost counts."""
    found = list[tuple[float, Smoothed, BoolArray]]()
    for each in starts:
        result, accepted = gnc(inputs, final, initialized, each())
        out = int((~accepted & (np.where(initialized >= 0, initialized, final) >= 0)).sum())
        cost = result.cost + out * gate_threshold(PROBABILITY)
        for of in (result.fixes, result.closures):
            if of is not None:
                cost += sum(gate_threshold(PROBABILITY, d) for d in of.dof[~of.used].tolist())
        found.append((cost, result, accepted))
    _, result, accepted = min(found, key=lambda each: each[0])
    return result, accepted


def _lowest(
    inputs: Inputs, final: IntArray, initialized: IntArray, starts: Sequence[Callable[[], Start | None]], loss: str,
    rejected: BoolArray, enough: float,
) -> Smoothed:  # fmt: skip
    """The minimum from the first start, or the lowest of those from others while it is suspicious."""
    result, stop, tried = None, None, 0
    both = loss != "gaussian" and inputs.closures is not None
    for each in starts:
        if result is not None and not result.suspect and not (both and tried < 2):
            break
        start = each()
        if start is None:
            continue
        tried += 1
        try:
            found = smooth(inputs, final, initialized, start, loss=loss, rejected=rejected, enough=enough)
        except NotConvergedError as fault:
            stop = fault
        else:
            if result is None or found.cost < result.cost * (1.0 - LOWER):
                result = found
    if result is None:
        assert stop is not None
        raise stop
    return result


def _start_of(other: Callable[[], Run], inputs: Inputs, initialized: IntArray) -> Start | None:
    """The path of another run as a start; None where it has none, or other landmarks."""
    run = other()
    if run.failure is not None or run.online is None:
        return None
    if inputs.several_or_partial and inputs.map is None and not np.array_equal(run.initialized, initialized):
        return None
    return start_at(inputs, run, initialized)


def _chordal(inputs: Inputs, initialized: IntArray, final: IntArray | None = None) -> Start:
    """The chordal path, with landmarks where they were observed first, or where all their measurements meet."""
    pose = chordal_path(inputs)
    return Start(pose, _places(inputs, pose, initialized, final))


def start_at(inputs: Inputs, front: Run, initialized: IntArray) -> Start:
    """The path and map of a front end; a landmark that it dropped is where it was initialized. `initialized` (M,):
    number of the landmark that an observation initialized, -1 for none.
    """
    assert front.online is not None
    places = _places(inputs, front.online.pose, initialized)
    if front.map is not None and inputs.map is not None:
        places[inputs.map.rows(front.map.number)] = front.map.xy
    elif front.map is not None:
        held = front.map.number < len(places)
        places[front.map.number[held]] = front.map.xy[held]
    # the front end's last errors; knots of the drift that it has forgotten are the last one's
    known = front.errors_final or front.errors_online
    errors = None if known is None else np.broadcast_to(known.mean[-1], known.mean.shape)
    return Start(front.online.pose, places, errors)


def _places(inputs: Inputs, pose: Array, initialized: IntArray, final: IntArray | None = None) -> Array:
    """Landmarks (L, 2) where they were initialized, or by `final` decisions, from poses (N, 3); of an uncertain map."""
    if inputs.map is not None:
        return inputs.map.xy.copy() if inputs.map.sigma is not None else np.zeros((0, 2))
    places, o = np.full((int(initialized.max(initial=-1)) + 1, 2), np.nan), inputs.observations
    for i in np.flatnonzero(initialized >= 0):
        sensor = inputs.sensor_at(int(i))
        if sensor.locates:
            places[initialized[i]] = sensor.inverse(pose[o.frame[i]], o.z[i : i + 1])[0][0]
        elif final is not None and np.isnan(places[initialized[i], 0]):
            rows = np.flatnonzero((final == initialized[i]) | (initialized == initialized[i]))
            k, at = np.where(inputs.measured()[rows, 0], 0, 1), pose[o.frame[rows]]
            z = o.z[rows, k] + k * (at[:, 2] - sensor.rotation)
            places[initialized[i]] = met(Sights(at[:, :2], z, k == 1, 1.0 / np.sqrt(o.R[rows, k, k])))
    return places
