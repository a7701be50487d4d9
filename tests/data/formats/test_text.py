"""A table is the same path and the same log, however it is written."""

import numpy as np
import pytest

from data.formats.results.reading import read_path
from data.formats.text import read_table

NAMES, ROWS = "t,x,y,theta", [f"{k}.5,{0.5 * k},-0.25,0.125" for k in range(5)]
PLAIN = "\n".join([NAMES, *ROWS])


@pytest.mark.parametrize("text", [
    PLAIN, PLAIN.replace(",", " | "), PLAIN.replace(",", "\t"), PLAIN.replace(",", "\t\t"), PLAIN.replace(",", "   "),
    PLAIN.replace(",", ";").replace(".", ","), PLAIN.replace(",", '","').replace("\n", '"\n"').join('""'),
    f"# {PLAIN}", f"# by a robot\n% {PLAIN}".replace(",", " "), f"#{PLAIN}".replace("\n", ",\n") + ",",
    "\n".join([NAMES, *(f"{row}," for row in ROWS)]), "\n".join(f"{row}," for row in [NAMES, *ROWS]),
    "\n".join([NAMES.replace(",", "\t"), *(row.replace(",", "\t", 1).replace(",", " ") for row in ROWS)]),
    f"{PLAIN}\n5.5,4",
])  # fmt: skip
def test_a_path_and_a_log_are_read_alike(text, tmp_path):
    (tmp_path / "a.csv").write_text(text + "\n")
    path, table = read_path(str(tmp_path / "a.csv")), read_table(tmp_path / "a.csv")
    found = np.column_stack([table.numbers(k, np.ones(5, bool)) for k in range(4)])
    assert found.tolist() == [[float(field) for field in row.split(",")] for row in ROWS]
    assert np.column_stack([path.time, path.pose]) == pytest.approx(found)
    assert ("line 7, the last one, is cut off and left out: '5.5,4'" in table.cut) == text.endswith(",4")
    assert table.names == tuple(NAMES.split(","))
