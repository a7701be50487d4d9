"""The association methods of ours: names in the order of tables, and how each is called and drawn. Imports nothing."""

from typing import NamedTuple


class MethodRow(NamedTuple):
    """How an association method is called and drawn."""

    label: str  # in tables
    colour: str
    line: str | tuple[float, ...]  # as of `eval.figures.style`, or its dashes; where an estimator was run with several
    by_frame: bool = True
    """Whether it decides from one frame's expectation: by a function in `association.methods`, or JCBB's search."""


METHOD_TABLE = {
    "known": MethodRow("known", "#009E73", "solid", by_frame=False),
    "nn": MethodRow("NN", "#D55E00", "dotted"),
    "ml": MethodRow("ML", "#E69F00", (6.0, 1.2, 2.2, 1.2)),
    "ml-ratio": MethodRow("ML ratio", "#7B3F00", (1.0, 1.2, 1.0, 3.0)),
    "singles": MethodRow("SINGLES", "#CC79A7", (2.2, 1.2)),
    "jcbb": MethodRow("JCBB", "#0072B2", "dashdot"),
    "jcbb-first": MethodRow("first JCBB", "#56B4E9", "dashdotdot"),
    "gnn": MethodRow("GNN", "#999933", (1.0, 3.0)),
    "jcbb-hindsight": MethodRow("JCBB, hindsight", "#332288", "long", by_frame=False),
    "mht": MethodRow("MHT", "#9933EE", (9.0, 1.5, 1.0, 1.5, 1.0, 1.5), by_frame=False),
    "scan": MethodRow("scan matching", "#117733", "solid", by_frame=False),
}  # joint tests are blue
SCAN = "scan"  # pairs the scans of a laser log, not observations
METHODS = tuple(name for name, method in METHOD_TABLE.items() if method.by_frame)
