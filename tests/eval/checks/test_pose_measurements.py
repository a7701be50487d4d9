"""Checks of `fix` and `close_loops`: a student's filter passes, mistakes are found, and lacking them is said."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data.pose_measurements import expected_fix
from data.se2 import wrap_angle
from ekf.localizer import EkfLocalizer
from ekf.slam import EkfSlam
from eval.checks import estimators
from eval.replay.external.adapter import text_of
from tests.eval.checks.plain import Plain


class Fixing(Plain):
    """A student's EKF with fixes, without a gate for them unless `gated`."""

    gated = True

    def fix(self, fixes, sources, gate):
        used, stated = [], []
        for i, kind in enumerate(fixes.kind):
            z_hat, J = expected_fix(self.x[:3], kind, sources[fixes.source[i]])
            rows = np.flatnonzero(np.diag(fixes.covariance[i]))
            nu = fixes.z[i][rows] - z_hat
            if rows[-1] == 2:
                nu[-1] = wrap_angle(nu[-1])
            H = np.hstack([J, np.zeros((len(rows), len(self.x) - 3))])
            S = H @ self.P @ H.T + fixes.covariance[i][np.ix_(rows, rows)]
            nis = nu @ np.linalg.solve(S, nu)
            used.append(gate is None or not self.gated or nis < 9.0)
            stated.append(nis)
            if used[-1]:
                K = self.P @ H.T @ np.linalg.inv(S)
                self.x, self.P = self.x + K @ nu, self.P - K @ S @ K.T
        return self.said(np.array(used), np.array(stated))

    def said(self, used, nis):
        return {"used": used, "nis": nis}


def lines(check, estimator, task):
    return list(check(text_of(estimator, "estimator"), task))


class FixesAlone(Fixing):
    def update(self, o, decisions):
        return super().update(o, np.full(len(decisions), -2))


@pytest.mark.parametrize(("task", "kind"), [("localization", Fixing), ("localization", FixesAlone), ("slam", Fixing)])
def test_a_students_filter_passes_and_what_was_found_is_said(task, kind):
    found = lines(estimators.fixes, kind, task)
    assert [f.line for f in found if not f.passed] == []
    assert [f.check for f in found] == ["fixes", "fixes, covariance", "fixes, NIS", "fixes, gate"]
    assert "the path with 7 fixes within 0.001 sigma" in found[0].sentence


@pytest.mark.parametrize(("check", "words"), [
    (estimators.fixes, "it has no `fix`"), (estimators.closures, "it has no `close_loops`"),
])  # fmt: skip
def test_that_it_has_neither_is_said_and_no_failure(check, words):
    (found,) = lines(check, Plain, "slam")
    assert found.passed
    assert words in found.sentence


def of_sources(**changes):
    """A filter that reads the sources of fixes in another way."""

    class Wrong(EkfLocalizer):
        def fix(self, fixes, sources, gate):
            read = tuple(replace(s, **{k: change(s) for k, change in changes.items()}) for s in sources)
            return super().fix(fixes, read, gate)

    return Wrong


class Deaf(EkfSlam):
    def fix(self, fixes, sources, gate):
        return None

    def close_loops(self, closures, gate):
        return None


class Scaled(EkfSlam):
    def fix(self, fixes, sources, gate):
        return super().fix(replace(fixes, covariance=2.0 * fixes.covariance), sources, gate)


class Swapped(EkfSlam):
    def close_loops(self, closures, gate):
        return super().close_loops(replace(closures, frame1=closures.frame2, frame2=closures.frame1), gate)


class Open(EkfLocalizer):
    """All gates are open."""

    def fix(self, fixes, sources, gate):
        return super().fix(fixes, sources, None)

    def close_loops(self, closures, gate):
        return super().close_loops(closures, None)


class Afterwards(Fixing):
    def said(self, used, nis):
        return {"used": used, "nis": 0.5 * nis}


class Broken(EkfSlam):
    def close_loops(self, closures, gate):
        raise KeyError("frame1")


WRONG = [
    (of_sources(lever=lambda s: (0.0, 0.0)), "fixes", "off where the path with 7 fixes was expected"),
    (Scaled, "fixes", "variances with 7 fixes within"),
    (Deaf, "closures", "off where the path with 6 closures was expected"),
    (Swapped, "closures", "off where the path with 6 closures was expected"),
    (Open, "fixes", "one that is 20 m off was used"),
    (Open, "closures", "one that is 20 m off was used"),
    (Afterwards, "fixes", r"fix \d: NIS .* is that of its innovation before it is used"),
    (Broken, "closures", r"Broken.close_loops raised KeyError"),
]


@pytest.mark.parametrize(("estimator", "check", "words"), WRONG, ids=lambda x: getattr(x, "__name__", None))
def test_what_is_wrong_is_found(estimator, check, words):
    task = "slam" if issubclass(estimator, EkfSlam) else "localization"
    failed = [f for f in lines(getattr(estimators, check), estimator, task) if not f.passed]
    assert any(re.search(words, f.sentence) for f in failed), [f.line for f in failed]
