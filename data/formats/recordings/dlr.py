"""The circle log of DLR (Kurlbaum and Frese, A Benchmark Data Set for Data Association, SFB/TR 8 report 017-02/2009).

    STEP image dX dY dPhi cXX cXY cYY cXPhi cYPhi cPhiPhi      pose after the step in that before; covariance, yy third
    LANDMARK_C pX pY quality cXX cXY cYY ID                    a circle seen after the latest step; ID -1: none

Metres, radians, blanks between fields; lines with # are comments. The file's axes (-y ahead) are kept.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.csv_table import bytes_of, lines_of, number_rows
from data.digest import source_file
from data.errors import DataError
from data.formats.recordings.laser import FLOOR
from data.inputs import Increments, Inputs, Observations, Prior
from data.log import Log
from data.motion.velocity import floor_covariances
from data.origin import MAX_RANGE, Origin
from data.sensors import RelativePoint
from data.truth import UNKNOWN_ID, Truth

STEP = ("dX", "dY", "dPhi", "cXX", "cXY", "cYY", "cXPhi", "cYPhi", "cPhiPhi")
SEEN = ("pX", "pY", "quality", "cXX", "cXY", "cYY", "ID")


def load_dlr(path: Path, name: str) -> Log:
    """The log of a file, its identities as true ids; frames have no stamps. DataError with line and value."""
    kinds: dict[bytes, list[tuple[int, list[bytes]]]] = {b"STEP": [], b"LANDMARK_C": []}
    frame, wanted = list[int](), {b"STEP": 2 + len(STEP), b"LANDMARK_C": 1 + len(SEEN)}
    for number, line in enumerate(lines_of(bytes_of(path)), start=1):
        fields = line.split(b"#")[0].split()
        if not fields:
            continue
        if len(fields) != wanted.get(fields[0]):
            what = f"{line[:40].decode('utf-8', 'replace')!r}; STEP with 10 fields or LANDMARK_C with 7 is needed"
            raise DataError.at(path, what, line=number)
        frame += [len(kinds[b"STEP"])] * (fields[0] == b"LANDMARK_C")
        kinds[fields[0]].append((number, fields[2:] if fields[0] == b"STEP" else fields[1:]))
    step, seen = (
        number_rows(path, [n for n, _ in rows], [f for _, f in rows], names)
        for rows, names in zip(kinds.values(), (STEP, SEEN), strict=True)
    )
    if not len(step) or not np.isfinite(step).all() or not np.isfinite(seen).all():
        raise DataError.at(path, "steps with finite numbers are needed")
    mean, P = np.zeros((len(step) + 1, 3)), np.zeros((len(step) + 1, 3, 3))
    mean[1:] = step[:, :3]
    P[1:] = step[:, [3, 4, 6, 4, 5, 7, 6, 7, 8]].reshape(-1, 3, 3)
    covariance, floored = floor_covariances(P, FLOOR)
    z, ids = seen[:, :2], seen[:, 6].astype(np.int64)
    reach = 1.001 * float(np.hypot(*z.T).max(initial=0.0)) or np.inf
    recorded = Inputs(
        prior=Prior(np.zeros(3), np.zeros((3, 3))),
        time=np.arange(len(mean), dtype=float),
        increments=Increments(mean, covariance),
        observations=Observations(np.array(frame, np.int64), z, seen[:, [3, 4, 4, 5]].reshape(-1, 2, 2)),
        sensor=RelativePoint(max_range=reach),
        time_is_index=True,
        covariance_floor=FLOOR,
        floored=floored,
    )
    truth = Truth(landmark_of=np.where(ids >= 0, ids, UNKNOWN_ID))
    source, notes = {"kind": "dlr", **source_file(path)}, ("The file's axes are kept: -y is ahead.",)
    return Log(name, recorded, truth, source=source, notes=notes, origins={MAX_RANGE: Origin.INFERRED})
