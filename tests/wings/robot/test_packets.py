"""Bytes of the protocol, scans included: known by hand, back and forth, and no packet that was not sent."""

import binascii
import math
import re
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from wings.robot import packets
from wings.robot.traffic import Framed

SIZES = {packets.MARKER: 22}


def crc_by_bits(data):
    """x^16 + x^12 + x^5 + 1, begun with ones, the highest bit first."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            register = (register << 1 & 0xFFFF) ^ (0x1021 * ((register >> 15) ^ (byte >> bit & 1)))
    return register


def test_a_command_is_four_bytes_with_the_low_one_first_and_an_answer_eight_distances_and_a_pose_in_22():
    assert packets.encode_command(packets.Command(300, -1000)) == bytes([0x2C, 0x01, 0x18, 0xFC])
    assert packets.decode_command(bytes([0x2C, 0x01, 0x18, 0xFC])) == packets.Command(300, -1000)
    answer = packets.Answer((1, 2, 3, 4, 5, 6, 7, 4000), -1, 256, 3141)
    data = packets.encode_answer(answer)
    assert data == bytes([1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7, 0, 0xA0, 0x0F, 0xFF, 0xFF, 0, 1, 0x45, 0x0C])
    assert packets.decode_answer(data) == answer


def test_the_checksum_is_that_of_its_definition_and_of_the_published_check_value():
    assert packets.checksum(b"123456789") == (0x29B1).to_bytes(2, "little")
    data = np.random.default_rng(0).bytes(22)
    assert packets.checksum(data) == crc_by_bits(data).to_bytes(2, "little")


def test_a_frame_is_found_behind_bytes_that_are_none_or_a_false_marker_and_waited_for_until_it_is_whole():
    content = bytes(range(22))
    pending = bytearray(b"\x00\x01" + packets.MARKER + b"\x07" + packets.framed(content) + b"rest")
    used, _, found = packets.next_frame(pending, SIZES)
    assert (used, found) == (2 + 2 + 1 + 26, content)
    assert packets.next_frame(pending[used:], SIZES) == (4, b"", None)
    whole = packets.framed(bytes(22))
    for part in range(1, 26):  # half a marker included
        assert packets.next_frame(bytearray(b"x" + whole[:part]), SIZES) == (1, b"", None)


def scan_of(rng, beams=None, odometry=(0, 0, 0), stamp=None):
    n = beams or int(rng.integers(1, 3 * packets.BEAMS))
    of = packets.Beams(n, -3_141_593, 17_453_293 * 360 // max(n, 360), 8000)
    time = int(rng.integers(1 << 32)) if stamp is None else stamp
    return packets.Scan(time, odometry, of, tuple(rng.integers(0, 8000, n).tolist()))


def with_answer(scan):
    return packets.encode_scan(scan) + packets.framed(
        packets.encode_answer(packets.Answer((1000,) * 8, *scan.odometry))
    )


def test_a_packet_is_152_bytes_as_documented():
    data = packets.encode_scan(packets.Scan(1, (-2, 3, 4), packets.Beams(2, -5, 20_000_000, 7000), (258, 0)))
    check = struct.pack("<I", binascii.crc32(b"\x02\x01\x00\x00"))
    head = b"\x01\0\0\0" + b"\xfe\xff\x03\0\x04\0" + b"\x02\0" + b"\0\0" + b"\xfb\xff\xff\xff" + b"\x00\x2d\x31\x01"
    content = head + b"\x58\x1b" + check + b"\x02\x01" + bytes(118)
    assert data == b"\xa5\x5c" + content + struct.pack("<H", binascii.crc_hqx(content, 0xFFFF))
    assert len(data) == 152


@given(st.integers(0, 10**6), st.integers(1, packets.MOST_BEAMS), st.integers(1, 400))
def test_a_scan_comes_back_as_it_was_sent_however_it_is_cut_into_pieces(seed, beams, piece):
    rng = np.random.default_rng(seed)
    sent = scan_of(rng, beams, tuple(rng.integers(-(1 << 15), 1 << 15, 3).tolist()))
    stream, data = Framed(scans=True), with_answer(sent)
    came = [p for at in range(0, len(data), piece) for p in stream.feed(0.0, data[at : at + piece])]
    assert [p.scan for p in came] == [sent]
    assert not +stream.faults


@pytest.mark.parametrize("numbers", [
    (0, 0, 20_000_000, 8000), (packets.MOST_BEAMS + 1, 0, 100_000, 8000), (4, 0, 0, 8000),
    (4, 6_300_000, 20_000_000, 8000), (400, 0, 20_000_000, 8000), (4, 0, 20_000_000, 0),
])  # fmt: skip
def test_beams_that_no_scanner_has_are_refused(numbers):
    beams = packets.Beams(*numbers)
    assert not beams.possible
    padded = packets.Scan(0, (0, 0, 0), beams, (5,) * min(beams.number, packets.BEAMS))
    frames = packets.encode_scan(padded) or packets.encode_scan(padded._replace(beams=beams._replace(number=1)))
    assert packets.ScanParts(Counter()).add(frames[2:-2][:148]) is None or beams.number == 0


def changed(data, rng):
    """Bytes lost, turned over, put in, doubled, or exchanged, or all at random."""
    data = bytearray(data)
    kind = int(rng.integers(6))
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(data)))
        if kind == 0:
            del data[at : at + int(rng.integers(1, 200))]
        elif kind == 1:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 40)))
        elif kind == 3:
            data[at:at] = data[at : at + 152]
        elif kind == 4:
            data[at : at + 2] = rng.bytes(2)
        else:
            data = bytearray(rng.bytes(len(data)))
        data = data or bytearray(b"\xa5")
    return bytes(data)


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_from_spoiled_bytes_come_only_scans_that_were_sent_and_nothing_fails(count):
    rng, used = np.random.default_rng(0), 0
    for _ in range(count):
        scans = [scan_of(rng, 100, (int(k), 0, 0), stamp=int(k)) for k in range(3)]
        data = changed(b"".join(map(with_answer, scans)), rng)
        stream = Framed(scans=True)
        cut = int(rng.integers(len(data)))
        for packet in [p for part in (data[:cut], data[cut:]) for p in stream.feed(0.25, part)]:
            if packet.scan is not None:
                assert packet.scan in scans
                assert packet.scan.odometry == packet.answer[1:]
                used += 1
    assert used > count, "of three each, many get through"


def test_a_scan_without_its_answer_or_with_a_piece_missing_is_counted_and_not_used():
    rng = np.random.default_rng(1)
    first, other = (scan_of(rng, 130, (k, 0, 0)) for k in (0, 5))
    stream = Framed(scans=True)
    (packet,) = stream.feed(0.0, packets.encode_scan(first)[: 2 * 152] + with_answer(first)[3 * 152 :])
    assert packet.scan is None
    assert stream.faults["torn"] == 1
    (packet,) = stream.feed(
        0.25, packets.encode_scan(other) + packets.framed(packets.encode_answer(packets.Answer((1000,) * 8, 0, 0, 0)))
    )
    assert packet.scan is None
    assert stream.faults["torn"] == 2
    (packet,) = stream.feed(0.5, with_answer(scan_of(rng, 90)))
    assert packet.scan is None, "other beams than the scan before"
    assert stream.faults["torn"] == 3


def test_the_drawing_of_the_frame_has_the_dimensions_of_the_protocol():
    drawing = (Path(__file__).parents[3] / "docs" / "robot" / "frame.svg").read_text()
    assert f'id="rim" r="{1000 * packets.RADIUS:g}"' in drawing
    turned = [-math.radians(float(a)) for a in re.findall(r'"#sonar" transform="rotate\((-?\d+)\)"', drawing)]
    np.testing.assert_allclose(np.exp(1j * np.array(turned)), np.exp(1j * packets.SONARS[:, 2]), atol=1e-12)
    wheels = re.search(r'id="wheels".*?</g>', drawing, re.DOTALL)[0]
    found = re.findall(r'x="(-?[\d.]+)" y="(-?[\d.]+)" width="([\d.]+)" height="([\d.]+)"', wheels)
    for (x, y, width, height), side in zip(np.array(found, float), (-1.0, 1.0), strict=True):
        assert (x + 0.5 * width, y + 0.5 * height) == (side * 500 * packets.WHEEL_BASE, 0.0)
        assert height == 2000 * packets.WHEEL_RADIUS
    for text in (1000 * packets.WHEEL_BASE, 2000 * packets.RADIUS, 2000 * packets.WHEEL_RADIUS):
        assert f">{text:g}</text>" in drawing
