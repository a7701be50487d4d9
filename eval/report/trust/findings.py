"""What was found wrong with a log, a sentence each, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from eval.page.numbers import number
from eval.referee.attribution import Finding
from eval.replay.names import FILTERS
from eval.report.trust.phrases import Terms, noise_words, phrase

TWINS = "on the twins, where all is as stated"
SIGMA = "sigma_"
"""Prefix of a factor of a stated sigma among what a calibration did."""
FITTED = {
    "odometry_x_distance": "odometry", "odometry_theta_turn": "odometry", "z1_constant": "bias", "z2_constant": "bias",
}  # fmt: skip
"""Groups of `eval.tune` that have a parameter for a systematic error."""
LATE = ("speed", "turn_rate")
ORDER = ("motion", "sensor", "bias", "odometry")


def sentence(found: Finding, terms: Terms) -> str:
    """A finding with its size, without a full stop; empty where its size is not known."""
    if not math.isfinite(found.size):
        return ""
    if found.kind == "systematic":
        text = phrase(found.name, terms).sentence(found.size, found.error)
        if found.other:
            others = " or ".join(phrase(name, terms).noun for name in found.other)
            text += f" (or, which this log cannot tell apart, {others})"
        return text
    if found.kind == "sigma":
        return noise_words(found.name, found.size, terms)
    many = _count(found.size, "reading")
    one = round(found.size) == 1
    if found.kind == "tails":
        return f"{many} {'fits' if one else 'fit'} no landmark where the path puts them: outliers of the sensor"
    if found.kind == "pairings":
        return f"{many} {'fits' if one else 'fit'} another landmark than the one paired with: wrong pairings"
    if found.kind == "linearization":
        claims = "less" if found.size > 1.0 else "more"
        return (
            f"{TWINS}, {found.name}'s NEES is {number(found.size)} times what its"
            f" covariance claims: it claims {claims} error than it makes"
        )
    if found.kind == "innovations":
        return f"{TWINS}, {found.name}'s NIS is {number(found.size)} times what is expected"
    if found.kind == "decisions":
        return f"{TWINS}, {100.0 * found.size:.2g} % of the decisions of {found.name} are wrong pairings"
    return ""


def _count(value: float, what: str) -> str:
    return f"{value:.0f} {what}{'' if round(value) == 1 else 's'}"


def sentences(findings: Sequence[Finding], terms: Terms) -> list[str]:
    """A sentence for each finding, in their order; an estimator's phases share the one that is furthest off."""
    shown: list[Finding] = []
    for f in findings:
        same = [i for i, s in enumerate(shown) if (s.kind, s.name) == (f.kind, f.name)]
        if not same:
            shown.append(f)
        elif abs(math.log(f.size)) > abs(math.log(shown[same[0]].size)):
            shown[same[0]] = f
    return [text for text in (sentence(f, terms) for f in shown) if text]


def done_words(done: Mapping[str, float], terms: Terms) -> list[str]:
    """What a calibration changed: systematic errors taken out, and factors of stated sigmas."""
    taken = [
        phrase(name, terms).sentence(size, math.nan)
        for name, size in done.items()
        if not name.startswith(SIGMA) and math.isfinite(size) and size != 0.0
    ]
    noises = [
        noise_words(name.removeprefix(SIGMA), size, terms)
        for name, size in done.items()
        if name.startswith(SIGMA) and math.isfinite(size) and size > 0.0
    ]
    return [*taken, *noises]


def groups_of(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Groups of `eval.tune --fit` that have parameters for what was found."""
    wanted = set()
    for f in findings:
        if f.kind == "sigma":
            wanted.add("motion" if f.name.startswith("odometry") else "sensor")
        elif f.kind == "systematic" and f.name in FITTED:
            wanted.add(FITTED[f.name])
    return tuple(name for name in ORDER if name in wanted)


def advice(findings: Sequence[Finding], terms: Terms, *, labels: bool) -> list[str]:
    """What to do about findings, a sentence each; `labels`: whether known association can be granted."""
    said = []
    groups = groups_of(findings)
    if groups and labels:
        said.append(f"Fit what is wrong: `python -m eval.tune LOG OUT --fit {','.join(groups)}`.")
    elif groups:
        said.append(
            f"Correct the noise and the scales that the log states; `python -m eval.tune LOG OUT --fit"
            f" {','.join(groups)}` would fit them if the log had labels."
        )
    systematic = [f for f in findings if f.kind == "systematic" and f.name not in FITTED]
    late = [f for f in systematic if f.name.split("_", 1)[1] in LATE]
    if late:
        said.append("Shift the readings' stamps; a log with odometry.csv can have it fitted (`--fit latency`).")
    by_hand = [phrase(f.name, terms).noun for f in systematic if f not in late]
    if by_hand:
        said.append(f"Correct in the log itself, as no parameter stands for it: {', '.join(by_hand)}.")
    kinds = {f.kind for f in findings}
    if "pairings" in kinds:
        gated = "Leave readings that fit badly out with `--gate-known 0.9999` or a narrower gate, or let"
        said.append(f"{gated if labels else 'Let'} later frames revise the pairings: `--association jcbb-hindsight`.")
    if "tails" in kinds:
        gate = " or a gate (`--gate-known 0.9999`)" if labels else ""
        said.append(f"Use a smoother that bears outliers, `batch-huber` or `gnc`,{gate}.".replace(",.", "."))
    if "decisions" in kinds:
        said.append("Take another way of deciding: `--association jcbb-hindsight`, or labels where the log has them.")
    off = [f.name for f in findings if f.kind in ("linearization", "innovations")]
    if any(name in FILTERS for name in off):
        said.append("Take `ekf-iterated`, which relinearizes each update, or for the path after the fact the smoother.")
    elif off:
        said.append(f"Do not take the covariances of {', '.join(dict.fromkeys(off))} at their word on this geometry.")
    return said
