"""Bytes of the protocol: known by hand, back and forth, and a checksum known from its definition."""

from __future__ import annotations

import numpy as np

from wings.robot.packets import (
    MARKER,
    Answer,
    Command,
    checksum,
    decode_answer,
    decode_command,
    encode_answer,
    encode_command,
    framed,
    next_frame,
)

SIZES = {MARKER: 22}


def crc_by_bits(data):
    """x^16 + x^12 + x^5 + 1, begun with ones, the highest bit first."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            out = (register >> 15) ^ (byte >> bit & 1)
            register = (register << 1 & 0xFFFF) ^ (0x1021 * out)
    return register


def test_a_command_is_four_bytes_with_the_low_one_first():
    assert encode_command(Command(300, -1000)) == bytes([0x2C, 0x01, 0x18, 0xFC])
    assert decode_command(bytes([0x2C, 0x01, 0x18, 0xFC])) == Command(300, -1000)


def test_an_answer_is_eight_distances_and_a_pose_in_22_bytes():
    answer = Answer((1, 2, 3, 4, 5, 6, 7, 4000), -1, 256, 3141)
    data = encode_answer(answer)
    assert data == bytes([1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7, 0, 0xA0, 0x0F, 0xFF, 0xFF, 0, 1, 0x45, 0x0C])
    assert decode_answer(data) == answer


def test_the_checksum_is_that_of_its_definition_and_of_the_published_check_value():
    assert checksum(b"123456789") == (0x29B1).to_bytes(2, "little")
    data = np.random.default_rng(0).bytes(22)
    assert checksum(data) == crc_by_bits(data).to_bytes(2, "little")


def test_a_frame_is_found_behind_bytes_that_are_none_and_behind_a_false_marker():
    content = bytes(range(22))
    pending = bytearray(b"\x00\x01" + MARKER + b"\x07" + framed(content) + b"rest")
    used, _, found = next_frame(pending, SIZES)
    assert (used, found) == (2 + 2 + 1 + 26, content)
    assert next_frame(pending[used:], SIZES) == (4, b"", None)


def test_a_frame_that_is_not_whole_is_waited_for_half_a_marker_included():
    whole = framed(bytes(22))
    for part in range(1, 26):
        assert next_frame(bytearray(b"x" + whole[:part]), SIZES) == (1, b"", None)


def test_any_two_bits_and_any_16_neighbouring_ones_that_turn_over_are_noticed():
    content = np.random.default_rng(1).bytes(22)
    whole = int.from_bytes(content + checksum(content)[::-1], "big")  # as the polynomial reads them
    patterns = [1 << a | 1 << b for a in range(192) for b in range(a + 1)]
    patterns += [int(p) << at for p in np.random.default_rng(2).integers(1, 1 << 16, 20) for at in range(176)]
    for pattern in patterns:
        spoiled = (whole ^ pattern).to_bytes(24, "big")
        assert checksum(spoiled[:22])[::-1] != spoiled[22:]
