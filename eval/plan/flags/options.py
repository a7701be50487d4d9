"""Flags and config files of `slamref run` as one checked `Options`."""

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

from data.errors import UsageError, did_you_mean
from eval.figures.figure_style import FigureStyle
from eval.plan.flags.table import PROG, Drawing, Options, Output, inches, parser
from eval.replay.external.spec import names_of
from eval.replay.flag import Flag, filled, read_values, rows
from eval.replay.settings import Setup, check_gates

TABLE = rows(Options)
NOT_WITH_SCENARIO = ("log", "data", "task", "association", "twins", "result", "truth")
NOT_WITH_LAB = (*NOT_WITH_SCENARIO, "scenario", "full", "runs", "calibrate", "cooperative")
NOT_WITH_TEAM = ("data", "scenario", "result", "truth", "calibrate", "twins")


def read_options(argv: Sequence[str] | None = None, prog: str = PROG, positional: str = "log") -> Options:
    """Options from command line and config files, UsageError if invalid; positional words are values of a flag."""
    given = vars(parser(prog, positional).read(argv))
    words = given.pop("words")
    if words and TABLE[positional].repeatable:
        given[positional] = [*words, *given.get(positional, [])]
    elif words:
        if len(words) > 1 or positional in given:
            raise UsageError(f"{' '.join(words)}: one {positional} is needed")
        given[positional] = words[0]
    return options_of(given)


def options_of(given: Mapping[str, object]) -> Options:
    """Options from values by name; UsageError for invalid ones."""
    configs = TABLE["config"].read("--config", given.get("config", []))
    merged: dict[str, object] = {}
    for name in configs:
        merged.update(_read_config(name))
    merged.update((key, value) for key, value in given.items() if key != "config")
    if merged.get("lab") and "new_gate" not in merged:
        merged["new_gate"] = merged.get("gate", TABLE["gate"].default)  # the lab has one gate

    def label(row: Flag) -> str:  # only a file gives a value to a switch
        return f"--{row.name.replace('_', '-')}" + ("" if row.metavar else " =")

    options: Options = filled(Options, {"jobs": os.cpu_count() or 1} | read_values(Options, merged, label))
    _check(options)
    return options


def _read_config(name: str) -> dict[str, object]:
    from data.toml_table import load_toml

    def fault(what: str) -> UsageError:
        return UsageError(f"--config {name}: {what}")

    keys = {k.replace("-", "_"): v for k, v in load_toml(Path(name), fault).items()}
    known = TABLE.keys() - {"config"}
    strange = sorted(set(keys) - known)
    if strange:
        hint = did_you_mean(strange[0], known)
        raise UsageError(f"--config {name}: unknown key {strange[0]!r}{hint}; known: {', '.join(sorted(known))}")
    return keys


def _check(options: Options) -> None:
    """Check combinations; each value was checked when it was read."""
    s, setup, out = options.selection, options.setup, options.output
    check_gates(setup.gate, setup.new_gate)
    if setup.deactivate_after is not None:
        if setup.forget_after is not None and setup.deactivate_after >= setup.forget_after:
            least = f"must be less than --forget-after {setup.forget_after:g}, or nothing is ever parked"
            raise UsageError(f"--deactivate-after {setup.deactivate_after:g}: {least}")
        if "ekf-invariant" in s.estimator:
            raise UsageError("--deactivate-after: not for ekf-invariant, which moves all landmarks together")
        if "ekf-fej" in s.estimator:
            raise UsageError("--deactivate-after: not for ekf-fej, whose parked landmarks would lose first estimates")
    if out.quick and options.study.full:
        raise UsageError("--quick and --full exclude each other")
    if options.study.full and (s.log or s.scenario):
        raise UsageError("--full: for the default suite; name no log and no --scenario")
    if s.lab is not None and (stated := _stated(options, NOT_WITH_LAB)):
        raise UsageError(f"{stated} and --lab exclude each other: a lab states what is run")
    if s.cooperative and (stated := _stated(options, NOT_WITH_TEAM)):
        raise UsageError(f"{stated} and --cooperative exclude each other")
    if s.scenario:
        if stated := _stated(options, NOT_WITH_SCENARIO):
            raise UsageError(f"{stated} and --scenario exclude each other: a scenario states its own")
        for row in rows(Setup).values():
            if row.of(setup) != row.default:
                raise UsageError(f"{row.option} and --scenario exclude each other: [setup] in its file")
    there = (*names_of(s.estimator), *(word.partition("=")[0] for word in options.results.result))
    if out.show and not s.lab and (gone := next((name for name in out.show if name not in there), "")):
        raise UsageError(f"--show {gone}: not among the estimators; there are {', '.join(there)}")
    if out.write_up and "tex" not in out.formats:
        raise UsageError(f"--write-up: needs LaTeX tables; add tex to --formats {','.join(out.formats)}")
    if options.execution.quiet and options.execution.verbose:
        raise UsageError("-q and -v exclude each other")
    if out.animate and out.no_plots:
        raise UsageError("--animate and --no-plots exclude each other")
    if out.speed is not None and not out.animate:
        raise UsageError(f"--speed {out.speed:g}: the speed of films; type --animate, too")


def _stated(options: Options, names: Sequence[str]) -> str:
    """The first given flag of these; empty: none."""
    return next((TABLE[name].option for name in names if TABLE[name].of(options)), "")


TIMES = ("times", "times new roman", "times roman")
LIKE_TIMES = ("Times New Roman", "Times", "Nimbus Roman", "TeX Gyre Termes", "Liberation Serif", "STIXGeneral")
"""Substitutes in order of preference; matplotlib contains the last one."""
USUAL = "DejaVu Sans"
NEEDED = ("latex", "dvipng")
SYSTEMS = ("pdflatex", "xelatex", "lualatex")


def require_latex(drawing: Drawing) -> None:
    """Raise UsageError if LaTeX is needed and missing."""
    if drawing.usetex:
        for program in NEEDED:
            if shutil.which(program) is None:
                raise UsageError(f"--usetex: needs LaTeX; program {program!r} is not on this machine")
    if drawing.pgf and _system() is None:
        raise UsageError(f"--pgf: needs LaTeX; none of {', '.join(SYSTEMS)} is on this machine")


def figure_style_of(drawing: Drawing, output: Output) -> tuple[FigureStyle, str]:
    """The figure style, and a message about a missing font (empty: none is missing). A flag of `Drawing`, `--figures`
    or `--show` adds PDF files and each figure's data; `--write-up` and `--formats pdf` add PDF files only.
    """
    fonts, mathematics, message = _fonts(drawing.font)
    width = None if drawing.figure_width is None else inches(drawing.figure_width)
    pgf = _system() if drawing.pgf else None
    paper = drawing != Drawing() or bool(output.figures or output.show)
    pdf = output.write_up or "pdf" in output.formats or paper
    titles = not drawing.no_titles
    return FigureStyle(width, fonts, mathematics, drawing.font_size, drawing.usetex, pgf, pdf, titles, paper), message


def _system() -> str | None:
    return next((s for s in SYSTEMS if shutil.which(s) is not None), None)


def _fonts(name: str | None) -> tuple[tuple[str, ...], str | None, str]:
    if name is None:
        return (), None, ""
    from matplotlib import font_manager  # slow to load

    known = {f.name.lower(): f.name for f in font_manager.fontManager.ttflist}
    times = name.lower() in TIMES
    wanted = known.get(name.lower())
    if wanted is not None:
        return (wanted, USUAL), "stix" if times else None, ""
    like = next((f for f in LIKE_TIMES if f.lower() in known), USUAL) if times else USUAL
    message = f"--font {name}: not on this machine; figures use {like} instead"
    return tuple(dict.fromkeys((like, USUAL))), "stix" if times else None, message
