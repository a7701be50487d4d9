# What type checkers see of `slamref`, which is one module: the wheel holds this as slamref-stubs/__init__.pyi.

from association.decide import decide as decide
from association.expectation import Expectation as Expectation
from data.log import Log as Log
from data.logs import open_log as open_log
from data.notice import Notice as Notice
from data.result import DISCARD as DISCARD, NEW as NEW
from data.words import sentence as sentence
from eval.checks.checking import (
    association_findings as association_findings,
    check_association as check_association,
    check_estimator as check_estimator,
    estimator_findings as estimator_findings,
)
from eval.compare import compare as compare
from eval.judgement.judgement import Judgement as Judgement, judge as judge
from eval.referee.diagnostics import notices as notices
from eval.referee.score import Trial as Trial, score as score
from eval.replay.estimators import make_estimator as make_estimator
from eval.replay.external.adapter import Samples as Samples
from eval.replay.settings import Setup as Setup
from eval.report.calls import (
    Diagnosis as Diagnosis,
    Study as Study,
    score_files as score_files,
    study as study,
    twins as twins,
)
from wings.audit.examined import audit as audit

__version__: str

def main(argv: list[str] | None = None) -> int: ...
