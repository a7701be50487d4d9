"""`slamref check`: check an estimator or an association method, one line per check."""

import sys
from collections.abc import Sequence

from data.command import Command
from data.errors import UsageError, unknown
from data.terminal import ended
from eval.plan.flags import texts_of
from eval.replay.external.spec import FORM, OURS, entry_points, is_foreign, one_settled, settled
from eval.replay.settings import ASSOCIATIONS, ESTIMATORS

FINE, FAILED = 0, 1
KINDS = ("estimator", "association")
PROG = "python -m eval.check"


def parser(prog: str = PROG) -> Command:
    """The flags."""
    p = Command(prog, PROG, *texts_of("check"))
    p.add_argument("what", metavar="WHAT", nargs="+", help=f"{FORM}, or a built-in name")
    p.add_argument("--as", dest="kind", choices=KINDS, help="its kind (default: a class with `update` is an estimator)")
    return p


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The command `prog`; returns its exit status."""
    options = parser(prog).read(argv)
    return ended(lambda: max(_check(*asked) for asked in [_settled(text, options.kind) for text in options.what]))


def _settled(text: str, kind: str | None) -> tuple[str, str]:
    """The text as it can be loaded, and its kind; UsageError for an unknown name."""
    from eval.replay.external.adapter import load

    if kind is None and not is_foreign(text):
        kind = next((k for k in KINDS if text in OURS[k] or text in entry_points(k)), None)
        if kind is None:
            raise UsageError(f"{text}: {unknown(text, (*ESTIMATORS, *ASSOCIATIONS))}; or your own as {FORM}")
    if kind is None:
        thing = load(settled("check", text, "estimator")).thing
        kind = "estimator" if callable(getattr(thing, "update", None)) else "association"
    found = one_settled("check", text, kind)
    if is_foreign(found):
        load(found)
    return found, kind


def _check(text: str, kind: str) -> int:
    from eval.checks.checking import association_findings, estimator_findings
    from eval.replay.external.spec import shown

    findings = estimator_findings(text) if kind == "estimator" else association_findings(text)
    print(f"{shown(text)} ({kind if kind == 'estimator' else 'association method'})")
    for f in findings:
        print(f"  {f.line}")
    failed = sum(not f.passed for f in findings)
    passed = f"{len(findings) - failed} of" if failed else "all"
    print(f"{passed} {len(findings)} checks passed")
    return FAILED if failed else FINE


if __name__ == "__main__":
    sys.exit(main())
