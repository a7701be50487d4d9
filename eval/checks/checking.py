"""All checks of an estimator or an association method: as a list of findings, or as one error."""

from collections.abc import Callable
from typing import Any

from threadpoolctl import threadpool_limits

from association.decide import PLAIN
from association.jcbb import jcbb, jcbb_first
from association.names import METHODS
from data.errors import UsageError
from eval.checks import associations, estimators
from eval.checks.exactness import exactness
from eval.checks.finding import CheckError, Finding
from eval.replay.external.adapter import ForeignError, Method, load, tasks_of, text_of
from eval.replay.external.spec import is_foreign, name_of, one_settled
from eval.replay.settings import STEPPING, TASKS

ESTIMATOR = (
    *(estimators.purity, estimators.covariances, estimators.runs, exactness, estimators.without_noise),
    *(estimators.seams, estimators.empty_frames, estimators.determinism, estimators.removal),
    *(estimators.fixes, estimators.closures),
)
OWN = {**PLAIN, "jcbb": jcbb, "jcbb-first": jcbb_first}


def estimator_findings(estimator: str | Callable[..., Any]) -> list[Finding]:
    """Run every check of an estimator, for each of its tasks.

    Args:
        estimator: class (docs/extending.md), text `FILE.py:NAME`, or built-in name.

    Returns:
        Findings (check, passed, sentence, facts).

    Raises:
        UsageError: it cannot be loaded, or works on whole logs only.

    Example:
        >>> [f.line for f in slamref.estimator_findings("ekf")]
    """
    text = _text(estimator, "estimator")
    if not is_foreign(text) and text not in STEPPING:
        raise UsageError(f"{text}: does not work step by step; {', '.join(STEPPING)} do")
    try:
        tasks = tasks_of(load(text)) if is_foreign(text) else TASKS
    except UsageError as fault:
        return [Finding("interface", False, str(fault))]
    found = [Finding("interface", True, f"{name_of(text)} does {' and '.join(tasks)}")]
    with threadpool_limits(1):
        for task in tasks:
            found += [f._replace(check=f"{task}, {f.check}") for check in ESTIMATOR for f in check(text, task)]
    return found


def association_findings(association: str | Callable[..., Any]) -> list[Finding]:
    """Run every check of an association method.

    Args:
        association: function (docs/extending.md), text `FILE.py:NAME`, or built-in name.

    Returns:
        Findings (check, passed, sentence, facts).

    Raises:
        UsageError: it cannot be loaded, or decides over several frames.

    Example:
        >>> [f.line for f in slamref.association_findings("jcbb")]
    """
    text = _text(association, "association")
    if is_foreign(text):
        try:
            method = Method(load(text))
        except ForeignError as stop:
            return [Finding("interface", False, str(stop))]
        return list(associations.run(method, load(text).thing))
    if text not in METHODS:
        raise UsageError(f"{text}: decides by more than one frame; {', '.join(METHODS)} can be checked")
    return list(associations.run(OWN[text], OWN[text]))


def check_estimator(estimator: str | Callable[..., Any]) -> None:
    """Assert that an estimator passes every check, for a test of your own.

    Raises:
        CheckError: an AssertionError with a sentence for each failed check.

    Example:
        >>> def test_mine():
        ...     slamref.check_estimator(MyFilter)
    """
    _judge(estimator, estimator_findings(estimator))


def check_association(association: str | Callable[..., Any]) -> None:
    """Assert that an association method passes every check, for a test of your own.

    Raises:
        CheckError: an AssertionError with a sentence for each failed check.

    Example:
        >>> def test_mine():
        ...     slamref.check_association(my_method)
    """
    _judge(association, association_findings(association))


def _judge(what: str | Callable[..., Any], findings: list[Finding]) -> None:
    if not all(f.passed for f in findings):
        raise CheckError(what if isinstance(what, str) else getattr(what, "__name__", "it"), findings)


def _text(what: str | Callable[..., Any], kind: str) -> str:
    """A settled text for an object, a text, or a name of an installed package."""
    if isinstance(what, str) and not is_foreign(what):
        return one_settled("check", what, kind)
    return text_of(what, kind)
