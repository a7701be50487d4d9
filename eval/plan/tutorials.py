"""Treatment of a recording by classic UTIAS tutorials, as a further row; their programs' faults are reproduced here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from association.decide import Decided
from association.expectation import Expectation
from association.methods import ALPHA, RATIO
from data.errors import UsageError
from data.formats.mrclam.calibration import Calibration
from data.formats.mrclam.load import Grid, Treatment, load_mrclam
from data.inputs import FrameObservations, Increment, IntArray, Prior
from data.log import Log
from data.motion.velocity import VelocityModel, VelocityNoise, carried
from data.notice import Code, notice
from data.result import DISCARD, NEW, Run
from data.se2 import Array, BoolArray, wrap_angle
from ekf.filter import FilterOptions
from ekf.localizer import EkfLocalizer
from eval.plan.flags.variant import Variant
from eval.referee.plausibility import with_plausibility
from eval.referee.score import Trial
from eval.replay.frontend import FrontEnd
from eval.replay.run import driven
from eval.replay.settings import Setup

FARTHEST = 10.0  # initial squared distance of the running minimum


class GainFromBefore(EkfLocalizer):
    """EKF localization whose gain has the covariance from before the prediction, K = P- H' S^-1.

    S is correctly formed from the predicted covariance; (I - K H) P is not made symmetric.
    """

    def predict(self, increment: Increment) -> None:
        """Move by an increment, and keep the covariance from before."""
        self._version += 1
        self._before = self._P[:3, :3].copy()
        wx, wy, F, B = carried(self._mean[2], increment.mean)
        self._P[:3, :3] = F @ self._P[:3, :3] @ F.T + B @ increment.covariance @ B.T
        self._mean[:2] += wx, wy
        self._mean[2] = wrap_angle(float(self._mean[2] + increment.mean[2]))

    def _correct(
        self,
        observations: FrameObservations,
        rows: IntArray,
        at: IntArray,
        known: Array,
        threshold: float,
        pose: Array | None = None,
    ) -> tuple[BoolArray, Array, Array]:
        self._version += 1
        stats, white = np.zeros(3), np.full((len(rows), 2), np.nan)
        for i, row in enumerate(rows.tolist()):
            z_hat, Hx, _ = (a[0] for a in self.sensor.linearize(self._mean[:3], known[i : i + 1]))
            nu = self.sensor.residual(observations.z[row], z_hat)
            S = Hx @ self._P[:3, :3] @ Hx.T + observations.R[row]
            K = self._before @ Hx.T @ np.linalg.inv(S)
            white[i] = np.linalg.solve(np.linalg.cholesky(0.5 * (S + S.T)), nu)
            nis = float(white[i] @ white[i])
            stats += nis, -0.5 * (nis + np.linalg.slogdet(2.0 * np.pi * S)[1]), 2.0
            self._mean[:3] += K @ nu
            self._mean[2] = wrap_angle(float(self._mean[2]))
            self._P[:3, :3] = (np.eye(3) - K @ Hx) @ self._P[:3, :3]
        return np.ones(len(rows), np.bool_), stats, white


class RunningMinimum(FrontEnd):
    """Ratio test against the previous running minimum instead of the second best candidate; map order matters."""

    def decide(self, expectation: Expectation, method: str | None = None) -> Decided:
        """Decisions with the running minimum, or with another method for comparison."""
        return super().decide(expectation, method) if method is not None else Decided(running(expectation), True)


def running(expectation: Expectation) -> IntArray:
    """Decisions (m,) over the landmarks in order of creation, then "new" at `ALPHA`."""
    e = expectation.by_age()
    d2 = np.column_stack([e.individual_distances(), np.full(len(e.z), ALPHA)])
    number = np.append(e.number, NEW)
    decisions = np.full(len(d2), DISCARD, np.int64)
    for i, row in enumerate(d2.tolist()):
        best, second, winner = FARTHEST, FARTHEST, DISCARD
        for squared, candidate in zip(row, number.tolist(), strict=True):
            if squared < best:
                best, second, winner = squared, best, candidate
        if second > RATIO * best:
            decisions[i] = winner
    return decisions


DIGESTS = ("sha256", "landmarks_sha256")
ABOUT = "the same recording with a classic tutorial's numbers"


def is_tutorial(trial: Trial) -> bool:
    """Whether a trial is a tutorial's variant of a recording."""
    return trial.about == ABOUT


def variant_log(log: Log, variant: Variant, places: Sequence[Path] = ()) -> Log:
    """The recording behind a log, converted with the settings of a variant.

    It is looked for by its name in the working directory and `places`. Raises UsageError if the log is not from MRCLAM,
    or its recording is not found or has another digest.
    """
    s = log.source
    if s.get("kind") != "mrclam":
        raise UsageError(
            f"{variant.name}: log {log.name!r} does not come from a UTIAS MRCLAM recording; "
            "type `slamref convert mrclam` to make one"
        )
    source = _found(s, "file", variant, log, places)
    landmarks = _found(s, "landmarks", variant, log, places) if "landmarks" in s else None
    calibration = replace(
        Calibration().with_sigma(*variant.sigma),
        motion=VelocityModel(VelocityNoise(variant.noise, alphas=variant.alphas), variant.model),
    )
    treatment = Treatment(
        start=_later(_seconds(s.get("start")), variant.start),
        stop=_seconds(s.get("stop")),
        landmarks=landmarks,
        exclude_truth=[*_pairs(s.get("exclude_truth")), *((w.start, w.end) for w in log.truth.left_out)],
        grid=Grid(variant.grid, variant.own_odometry, variant.gapless, variant.skip_led_by),
        calibration=calibration,
    )
    changed = load_mrclam(source, int(str(s["robot"])), treatment)
    if not all(_alike(changed.source[key], s[key]) for key in DIGESTS if key in s):
        raise UsageError(
            f"{variant.name}: {source} is not the recording that log {log.name!r} was made from (its digest is another)"
        )
    shape = np.ones((3, 3)) if variant.filled_prior else np.eye(3)
    prior = Prior(changed.recorded.prior.mean, variant.prior_variance * shape)
    return replace(
        changed,
        name=f"{log.name}:{variant.name}",
        recorded=replace(changed.recorded, prior=prior),
        source={**changed.source, **_original(s, changed, variant)},
        notes=(*changed.notes, *variant.notes),
    )


def _alike(one: object, other: object) -> bool:
    """Whether two digests agree, or those of all files that both name."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return all(one[name] == other[name] for name in one.keys() & other.keys())
    return one == other


def _found(source: Mapping[str, object], key: str, variant: Variant, log: Log, places: Sequence[Path]) -> Path:
    """A file that a log states by its name (formerly by its path)."""
    stated = Path(str(source.get(key) or source.get("path", "")))
    for place in (Path(), *places):
        if (place / stated).exists():
            return place / stated
    raise UsageError(
        f"{variant.name}: {stated.name}, which log {log.name!r} was made from, is neither here nor beside the log;"
        " start in its folder, or convert again there"
    )


def tutorial_run(log: Log, variant: Variant) -> Run:
    """The run of the EKF with a variant's update and association method."""
    known = variant.association == "known"
    inputs = log.inputs(labels=known)
    if variant.task == "slam":
        inputs = inputs.without_map()
    options = FilterOptions(
        each=variant.each, new_variance=variant.new_variance, new_variance_per_square=variant.new_variance_per_square
    )
    with threadpool_limits(1):  # as in `eval.replay.run.compare`
        setup = Setup(gate=variant.gate, new_gate=variant.new_gate, gate_known=None)
        kind = RunningMinimum if variant.running_minimum else FrontEnd
        front = kind("ekf", variant.association, inputs, setup, options)
        if variant.gain_before_prediction:
            assert inputs.map is not None
            front.estimator = GainFromBefore(inputs.prior, inputs.sensor, inputs.map, options)
        run = driven("ekf", front, inputs, variant.task, each=variant.each)
    notes = (notice(Code.NOTE, text=text) for text in variant.notes)
    return replace(with_plausibility(run, inputs), notes=(*run.notes, *notes))


def _original(source: Mapping[str, object], changed: Log, variant: Variant) -> dict[str, object]:
    """Results of the original program, if the log is the whole of its recording, with the landmark file it read."""
    whole = source.get("start") is None and source.get("stop") is None
    here = f"{source.get('dataset')}, robot {source.get('robot')}"
    if variant.original is None or not whole or here != variant.original_log:
        return {}
    digests = changed.source["sha256"]
    assert isinstance(digests, dict)  # of the files read
    if variant.original_landmarks not in digests.values():
        return {}
    return {"original": list(variant.original)}


def original_of(trial: Trial) -> tuple[float, float] | None:
    """Sum of squared position errors [m^2] and position RMSE [m] of the original program, if known."""
    given = trial.log.source.get("original")
    return (float(given[0]), float(given[1])) if isinstance(given, list) else None


def _later(asked: float | None, variant: float | None) -> float | None:
    """The later of two start times, either of which may be None."""
    return max((s for s in (asked, variant) if s is not None), default=None)


def _seconds(value: object) -> float | None:
    return None if value is None else float(str(value))


def _pairs(value: object) -> list[tuple[float, float]]:
    if not isinstance(value, (list, tuple)):
        return []
    return [(float(v[0]), float(v[1])) for v in value]
