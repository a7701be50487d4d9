"""Findings of checks, each a sentence."""

from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from typing import NamedTuple, ParamSpec

from eval.replay.external.adapter import ForeignError

EXACT, APPROXIMATE = 0.05, 1.0
"""Standard deviations. Below the first two estimates are equal: ours differ by up to 0.01, as they linearize elsewhere.
Approximate estimators (a few hundred samples, other linearizations) are below the second; a wrong sign or a forgotten
wrap is far above."""


class Finding(NamedTuple):
    """A check by name, whether it passed, a sentence, and the facts (`eval.checks.exactness`) where it has any."""

    check: str
    passed: bool
    sentence: str
    facts: object = None

    @property
    def line(self) -> str:
        """Terminal line."""
        return f"{'ok  ' if self.passed else 'FAIL'}  {self.check}: {self.sentence}"


class CheckError(AssertionError):
    """Some checks failed; the message has a sentence for each."""

    def __init__(self, name: str, findings: Sequence[Finding]) -> None:
        failed = [f for f in findings if not f.passed]
        first = f"{name} fails {len(failed)} of {len(findings)} checks:"
        super().__init__("\n".join([first, *(f.line for f in failed)]))
        self.findings = tuple(findings)


class FailedError(Exception):
    """A check failed, for the reason in its message; it passes if what is tested declares this."""

    def __init__(self, why: str, *, declared: bool = False) -> None:
        super().__init__(f"{why}, as it declares" if declared else why)
        self.declared = declared


P = ParamSpec("P")


def check(name: str) -> Callable[[Callable[P, Iterator[Finding | str]]], Callable[P, Iterator[Finding]]]:
    """Make findings of a check: a text that it yields passes, a `FailedError` and a crash of foreign code end it."""

    def decorated(function: Callable[P, Iterator[Finding | str]]) -> Callable[P, Iterator[Finding]]:
        @wraps(function)
        def findings(*arguments: P.args, **named: P.kwargs) -> Iterator[Finding]:
            try:
                for found in function(*arguments, **named):
                    yield Finding(name, True, found) if isinstance(found, str) else found
            except FailedError as stop:
                yield Finding(name, stop.declared, str(stop))
            except ForeignError as stop:
                yield Finding(name, False, str(stop))

        return findings

    return decorated


def graded(check: str, off: float, what: str) -> Finding:
    """Grade the error of an estimate, in standard deviations of the right one."""
    if not off > EXACT:
        return Finding(check, True, f"{what} within {_sigmas(off)}")
    if off <= APPROXIMATE:
        only = f"not exact: {what} only within {_sigmas(off)}"
        return Finding(check, True, f"{only}; right for samples and approximations, an error in a Kalman filter")
    return Finding(check, False, f"{_sigmas(off)} off where {what} was expected within {_sigmas(APPROXIMATE)} at most")


def _sigmas(off: float) -> str:
    return "0.001 sigma" if off < 1e-3 else f"{off:.2g} sigma"
