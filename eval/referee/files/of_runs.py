"""The files of one run, and of one log: `runs/<log>/`."""

from __future__ import annotations

from data.inputs import ERRORS
from eval.referee.files.described import Column, File, count, text

LOG_FOLDER = "runs/<log>"
RUN_FOLDER = f"{LOG_FOLDER}/<task>-<estimator>-<association>"
NUMBER = "its number in the order of creation (SLAM), or its id in the map (localization)"
DECIDED = "landmark number; -1: initialized a new landmark; -2: discarded"


def covariance(names: str, what: str) -> tuple[Column, ...]:
    """The upper triangle of a covariance; `names` as in `xyt`."""
    return tuple(
        Column(f"c_{a}{b}", f"covariance of {what}, entry {LETTERS[a]}, {LETTERS[b]}", UNITS[(a == "t") + (b == "t")])
        for i, a in enumerate(names)
        for b in names[i:]
    )


UNITS = ("m²", "m rad", "rad²")
"""Of an entry of a covariance, by how many headings it is about."""
LETTERS = {"x": "x", "y": "y", "t": "theta"}
PATH = (
    Column("t", "time of the frame; of a log without stamps its number", "s"),
    Column("x", "of the robot in the world frame", "m"),
    Column("y", "of the robot in the world frame", "m"),
    Column("theta", "heading, counter-clockwise from the world's x axis", "rad"),
    *covariance("xyt", "the pose's error, additive, in the world frame"),
)
ESTIMATED = tuple(
    column
    for name, unit in ERRORS.items()
    for column in (
        Column(name, "this systematic error, as estimated along (`--calibrate`)", "" if unit == "1" else unit),
        Column(f"sigma_{name}", "its standard deviation", "" if unit == "1" else unit),
    )
)
"""Each of those that are estimated; they stand behind all others."""
OPTIONAL = tuple(c.name for c in ESTIMATED)
ONLINE = File(
    f"{RUN_FOLDER}/online.csv",
    "What was known at each instant, one row for each frame; not of batch smoothers.",
    (
        *PATH,
        Column("log_likelihood", "of the innovations used in the frame; blank where none are formed"),
        count("state_size", "length of the estimator's state vector after the frame"),
        *ESTIMATED,
    ),
    OPTIONAL,
)
FINAL = File(
    f"{RUN_FOLDER}/final.csv",
    "The path given all data, one row for each frame; not of filters.",
    (*PATH, *ESTIMATED),
    OPTIONAL,
)
LANDMARKS = File(
    f"{RUN_FOLDER}/landmarks.csv",
    "The last map; in SLAM only. Of walls x and y are rho [m] and alpha [rad].",
    (
        count("landmark", "landmark number: the order of creation, never given twice"),
        Column("x", "in the world frame", "m"),
        Column("y", "in the world frame", "m"),
        *covariance("xy", "the position's error in the world frame"),
        count("true_id", "true id of the observation that initialized it; -1: that observation was clutter"),
        count("first_frame", "frame in which it was initialized"),
        count("times_seen", "observations paired with it, the first included"),
        count(
            "ambiguous",
            "number of the nearest landmark that it cannot be told from: no frame saw both, and their difference is"
            " within the 99 % gate of their covariances and a reading's; its own number: by its readings it may be two;"
            " blank: neither",
        ),
    ),
)
DECISIONS = File(
    f"{RUN_FOLDER}/decisions.csv",
    "One row for each observation of the log: what it was paired with; not of dead reckoning and laser logs. A landmark"
    f" is meant by {NUMBER}.",
    (
        count("frame", "frame of the observation"),
        count("observation", "its place within the frame, from 0"),
        count("decision", f"made online: {DECIDED}"),
        count("truth", "the right landmark at that moment; -1: not in the map; blank: the true id is unknown"),
        text("outcome", "`tp`, `tn`, `fp` or `fn` of the decision; blank where the truth is unknown"),
        count(
            "final_decision",
            f"after all revisions: {DECIDED}; a landmark whose -1 was revised begins with its first observation",
        ),
        text("final_outcome", "outcome of the final decision against the landmarks that are left"),
    ),
)
LOOPS = File(
    f"{LOG_FOLDER}/loops.csv",
    "Every loop closure that was looked at.",
    (
        count("key1", "earlier key pose (row of the chain of key poses)"),
        count("key2", "later key pose"),
        Column("dx", "position of key2 in the body frame of key1", "m"),
        Column("dy", "position of key2 in the body frame of key1", "m"),
        Column("dtheta", "heading of key2 in the body frame of key1", "rad"),
        *covariance("xyt", "that relative pose"),
        Column("score", "share of the scan that the match explains, 0 to 1"),
        count("accepted", "1: it joined the graph"),
        count("final", "1: it kept its weight to the end"),
    ),
    when="laser logs, with scans that were matched",
)
LASER = "laser logs; from isam2's final phase, else from the first estimator"
LAB_TEXT = File(
    f"{RUN_FOLDER}/lab.txt",
    "Each step as the lab's program prints it: right answer, hypothesis, which are correct; steps and landmarks count "
    "from 1, 0 is none.",
    when="with `--lab-text`",
)
TUM = "`t x y z qx qy qz qw` in each line, without a header; frames without a pose are left out"
OF_RUNS = (
    ONLINE,
    FINAL,
    File(f"{RUN_FOLDER}/online.tum", f"The same path for other tools: {TUM}."),
    File(f"{RUN_FOLDER}/final.tum", f"The same path for other tools: {TUM}."),
    LANDMARKS,
    DECISIONS,
    LAB_TEXT,
)
OF_LOGS = (
    File(f"{LOG_FOLDER}/truth.tum", f"The true path, at the frames of the log: {TUM}.", when="logs with true poses"),
    LOOPS,
    File(
        f"{LOG_FOLDER}/graph.g2o", "Key poses, the motion between them and the loop closures kept, for g2o.", when=LASER
    ),
    File(f"{LOG_FOLDER}/map.png", "The occupancy grid with the path.", when=LASER),
    File(f"{LOG_FOLDER}/map.pgm", "The occupancy grid for map servers.", when=LASER),
    File(f"{LOG_FOLDER}/map.yaml", "Where `map.pgm` lies and how it is meant.", when=LASER),
)
OTHERS = (
    File("report.html", "The report, in one file."),
    File("report.md", "The same in Markdown."),
    File(
        "players/<log>.html",
        "Every run on a log, frame by frame, in a browser: one file, which loads nothing.",
        when="not with `--no-plots`",
    ),
    File("tables/<name>.csv", "A table of the report, every digit, with the heads that people read."),
    File("tables/<name>.md", "The same in Markdown, rounded."),
    File("tables/<name>.tex", "The same in LaTeX, for a column or a page of a paper (`--table-width`, `--columns`)."),
    File("tables/notes.tex", "What the LaTeX tables mean: their fine print, one paragraph for each."),
    File("figures/<name>.pdf", "A figure, for a paper.", when="not with `--quick` or `--no-plots`"),
    File("figures/<name>.png", "The same as an image.", when="not with `--no-plots`"),
    File(
        "figures/<name>.svg", "The small map of a log in the first table of the report.", when="not with `--no-plots`"
    ),
    File("figures/<name>.webm", "A film of a run (VP8, plays in browsers).", when="with `--animate`"),
    File("figures/<name>.pgf", "A figure that LaTeX sets with the document's own fonts.", when="with `--pgf`"),
    File(
        "figures/lab-<name>.png",
        "A figure of a lab's answers; `lab-update-time` shows measured times, so that it, its table and `report.html` "
        "differ from run to run.",
        when="with `--lab`",
    ),
    File("write-up.tex", "Answers, tables and figures, one page per log, for pdflatex.", when="with `--write-up`"),
    File("provenance.json", "Command, versions, seed, and the SHA-256 of every input."),
    File("run.log", "What the run said."),
)
