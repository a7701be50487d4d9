"""What stands beside a result: landmarks and decisions with our columns; what is not there is not known."""

from __future__ import annotations

import pytest

from data.errors import DataError
from data.formats.results.tables import companions
from data.result import DISCARD, NEW


def landmarks(folder, text):
    (folder / "landmarks.csv").write_text(text)
    return companions(folder).landmarks


def test_landmarks_have_what_their_columns_say(tmp_path):
    found = landmarks(
        tmp_path, "landmark,x,y,c_xx,c_xy,c_yy,first_frame,times_seen\n7,1.5,-2,0.04,0.01,0.09,12,3\n2,0,4,1,0,2,0,1\n"
    )
    assert found.number.tolist() == [7, 2]
    assert found.xy.tolist() == [[1.5, -2.0], [0.0, 4.0]]
    assert found.covariance.tolist() == [[[0.04, 0.01], [0.01, 0.09]], [[1.0, 0.0], [0.0, 2.0]]]
    assert found.first_frame.tolist() == [12, 0]
    assert found.times_seen.tolist() == [3, 1]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("3,1,2,1,0,1,0,0\n4,1,2,1,2,1,0,0\n", ":3: covariance of x, y, heading has the eigenvalue -1; "),
        ("3,1,2,1,0,1,0,0\n3,1,2,1,0,1,0,0\n", ":3: column landmark: 3 is repeated"),
        ("-1,1,2,1,0,1,0,0\n", ":2: column landmark: -1 is not a whole number from 0 up"),
        ("3,1,2,1,0,1,0,0.5\n", ":2: column times_seen: 0.5 is not a whole number from -1 up"),
    ],
    ids=["covariance", "twice", "negative", "times seen"],
)
def test_a_landmark_that_makes_no_sense_is_named_with_its_line(tmp_path, rows, said):
    with pytest.raises(DataError) as error:
        landmarks(tmp_path, f"landmark,x,y,c_xx,c_xy,c_yy,first_frame,times_seen\n{rows}")
    assert str(error.value).startswith(f"{tmp_path / 'landmarks.csv'}{said}")


def test_a_final_decision_is_the_first_one_where_there_is_no_other(tmp_path):
    file = tmp_path / "decisions.csv"
    file.write_text("decision,observation,frame\n4,0,2\n-1,1,2\n-2,0,3\n")
    found = companions(tmp_path)
    assert found.decisions.tolist() == [[2, 0, 4, 4], [2, 1, NEW, NEW], [3, 0, DISCARD, DISCARD]]
    assert (found.file, found.landmarks) == (file, None)
    file.write_text("frame,observation,decision,final_decision\n2,0,4,-2\n2,1,-1,5\n")
    assert companions(tmp_path).decisions.tolist() == [[2, 0, 4, DISCARD], [2, 1, NEW, 5]]
    file.write_text("frame,observation,decision\n2,0,-3\n")
    with pytest.raises(DataError, match=r":2: column decision: -3 is not a whole number from -2 up"):
        companions(tmp_path)
