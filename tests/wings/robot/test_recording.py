"""The log of a line: what was appended is read again wherever it is cut off; damage is said."""

import tomllib

import pytest

from data.errors import DataError, UsageError
from tests.wings.robot.line import linked
from wings.robot import traffic
from wings.robot.packets import command_of
from wings.robot.simulated import Faults

RECORDS = [
    traffic.Record(traffic.OPENED, 0.0), traffic.Record(traffic.SENT, 0.000001, b"\x01\x02\x03\x04"),
    traffic.Record(traffic.RECEIVED, 0.026734, bytes(range(22))), traffic.Record(traffic.RECEIVED, 7200.123456, b""),
    traffic.Record(traffic.GONE, 7200.2),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    with traffic.Recording(tmp_path / "log") as recording:
        for record in RECORDS:
            recording.append(record)
    return tmp_path / "log"


def test_a_log_is_read_as_it_was_appended(folder):
    assert traffic.read_recording(folder)[:3] == (RECORDS, False, 0)


def test_a_record_is_on_disk_when_append_returns(tmp_path):
    with traffic.Recording(tmp_path / "log", framed=True) as recording:
        for n, record in enumerate(RECORDS):
            assert traffic.read_recording(tmp_path / "log")[:3] == (RECORDS[:n], True, 0)
            recording.append(record)


def test_cut_off_at_any_byte_it_holds_all_records_before(folder):
    whole = (folder / "packets.bin").read_bytes()
    seen = set()
    for size in range(0, len(whole), 5):
        (folder / "packets.bin").write_bytes(whole[:size])
        records, _, cut, *_ = traffic.read_recording(folder)
        assert records == RECORDS[: len(records)]
        assert cut == max(size - (len(traffic.MAGIC) + sum(15 + len(r.data) for r in records)), 0) < 15 + 22
        seen.add(len(records))
    assert seen == set(range(len(RECORDS)))  # a record is longer than a step


def test_damage_before_the_end_is_said_with_its_place_and_at_the_end_is_cut_off(folder):
    path = folder / "packets.bin"
    whole = path.read_bytes()
    third = len(traffic.MAGIC) + 15 + 19
    path.write_bytes(whole[: third + 20] + b"\xff" + whole[third + 21 :])
    with pytest.raises(
        DataError, match=r"packets.bin: the record at byte 42 is damaged; 2 records before it are intact"
    ):
        traffic.read_recording(folder)
    path.write_bytes(whole[:-1] + b"\x00" if whole[-1] else whole[:-1] + b"\x01")
    assert traffic.read_recording(folder)[:3] == (RECORDS[:-1], False, 15)


def test_the_header_says_what_it_is_from_the_start(tmp_path):
    with traffic.Recording(tmp_path / "drive", framed=True):
        header = tomllib.loads((tmp_path / "drive" / "log.toml").read_text())
    assert header == {"format": 1, "name": "drive", "source": {"kind": "robot link", "framed": True}}


def test_a_folder_that_holds_a_log_is_not_written_over(folder):
    with pytest.raises(UsageError, match="holds a log already"):
        traffic.Recording(folder)
    assert traffic.read_recording(folder).records == RECORDS


@pytest.mark.parametrize(("name", "content", "message"), [
    ("log.toml", None, "no such file"), ("log.toml", b"format = 1\nname = 'x'\n", "not the recording of a link"),
    ("log.toml", b"[source]\nkind = 'robot link'\n", "framed are needed"), ("packets.bin", None, "cannot be read"),
    ("packets.bin", b"something else", "begins with"),
])  # fmt: skip
def test_what_is_no_recording_is_said_in_one_line(folder, name, content, message):
    (folder / name).unlink()
    if content is not None:
        (folder / name).write_bytes(content)
    with pytest.raises(DataError, match=message) as error:
        traffic.read_recording(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("framed", [False, True])
def test_a_log_replays_to_the_same_packets_and_faults_as_when_it_was_made_also_cut_off(tmp_path, framed):
    with traffic.Recording(tmp_path / "log", framed=framed) as recording:
        link, _, clock = linked(Faults(0.01, 0.003, 2.0), 1, framed=framed, recording=recording)
        live = []
        while clock.now() < 20.0:
            live += link.step(command_of(0.3, 0.6))
    records, as_said, *_ = traffic.read_recording(tmp_path / "log")
    packets, faults = traffic.decoded(records, framed=as_said)
    assert list(map(repr, packets)) == list(map(repr, live))
    assert faults == link.exchange.faults
    assert sum(faults.values()) > 5
    exchange, half = traffic.Exchange(framed=framed), len(records) // 2
    first = [p for r in records[:half] for p in exchange.consume(r)]
    assert list(map(repr, first)) == list(map(repr, live[: len(first)]))


def test_a_recording_that_came_to_nothing_leaves_nothing_of_its_own(tmp_path):
    traffic.Recording(tmp_path / "alone").discard()
    assert not (tmp_path / "alone").exists()
    (tmp_path / "beside").mkdir()
    (tmp_path / "beside" / "notes.txt").write_text("mine")
    traffic.Recording(tmp_path / "beside").discard()
    assert [f.name for f in (tmp_path / "beside").iterdir()] == ["notes.txt"]
