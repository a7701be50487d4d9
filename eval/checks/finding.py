"""What a check found, in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

EXACT, APPROXIMATE = 0.05, 1.0
"""Standard deviations. Below the first two estimates are called the same: ours differ by up to 0.01, as they linearize
elsewhere. Beyond the second nobody is right: an approximate estimator (a few hundred samples, other linearizations) is
within it, a wrong sign or a forgotten wrap is far outside."""


class Finding(NamedTuple):
    """A check by name, whether it passed, and a sentence with numbers."""

    check: str
    passed: bool
    sentence: str

    @property
    def line(self) -> str:
        """For a list on a terminal."""
        return f"{'ok  ' if self.passed else 'FAIL'}  {self.check}: {self.sentence}"


class CheckError(AssertionError):
    """Some checks failed; the message has a sentence each."""

    def __init__(self, name: str, findings: Sequence[Finding]) -> None:
        failed = [f for f in findings if not f.passed]
        super().__init__(
            "\n".join([f"{name} fails {len(failed)} of {len(findings)} checks:", *(f.line for f in failed)])
        )
        self.findings = tuple(findings)


Check = Callable[..., Iterator[Finding]]


def graded(check: str, off: float, what: str) -> Finding:
    """How far an estimate is from what it should be, in standard deviations of the right one."""
    if not off > EXACT:
        return Finding(check, True, f"{what} within {_sigmas(off)}")
    if off <= APPROXIMATE:
        return Finding(
            check,
            True,
            f"not exact: {what} only within {_sigmas(off)}; right for samples and approximations, an "
            "error in a Kalman filter",
        )
    return Finding(check, False, f"{_sigmas(off)} off where {what} was expected within {_sigmas(APPROXIMATE)} at most")


def _sigmas(off: float) -> str:
    return "0.001 sigma" if off < 1e-3 else f"{off:.2g} sigma"
