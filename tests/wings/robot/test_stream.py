"""Where packets begin: shifted streams are recognized, what is whole is used, what is not possible never is."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from tests.wings.robot.line import wander
from wings.robot.packets import Answer, encode_answer, framed, overflowed
from wings.robot.simulated import drive, room
from wings.robot.traffic import Framed, Unframed, reachable

PERIOD = 0.25


@cache
def answers(seed, seconds):
    rng = np.random.default_rng(seed)
    return [p.answer for p in drive(room(seed), lambda packet: wander(packet, rng), seconds, rng).packets]


def heard(stream, pieces):
    """By piece: the packets that came out with it."""
    return [stream.feed(PERIOD * (i + 1), piece) for i, piece in enumerate(pieces)]


def used(by_piece):
    return [p.answer for packets in by_piece for p in packets]


def test_a_whole_stream_is_used_whole_however_it_is_cut_into_pieces():
    said = answers(0, 30.0)
    assert used(heard(Unframed(), map(encode_answer, said))) == said
    stream, out = Unframed(), []
    for i, answer in enumerate(said):
        for j, byte in enumerate(encode_answer(answer)):
            out += stream.feed(PERIOD * i + 0.001 * j, bytes([byte]))
    assert [p.answer for p in out] == said
    assert not +stream.faults
    assert [p.joined for p in out] == [False] + [True] * (len(said) - 1)


def test_with_pauses_a_packet_comes_out_with_its_last_byte():
    by_piece = heard(Unframed(), map(encode_answer, answers(0, 10.0)))
    assert [len(packets) for packets in by_piece] == [1] * 40


def test_what_comes_without_a_pause_after_an_answer_that_is_not_used_is_lost_with_it():
    said = answers(0, 8.0)
    pieces = [encode_answer(a) for a in said]
    pieces[7:9] = [b"\x07" + pieces[7] + pieces[8]]
    pieces[11] = b"\xff" * 22
    stream = Unframed()
    assert used(heard(stream, pieces)) == said[:7] + said[9:12] + said[13:]
    assert +stream.faults == Counter(garbage=2)


def test_answers_that_were_held_up_and_come_at_once_are_used():
    said = answers(0, 5.0)
    pieces = [encode_answer(a) for a in said]
    assert used(heard(Unframed(), [*pieces[:5], b"".join(pieces[5:12]), *pieces[12:]])) == said


@pytest.mark.parametrize("kind", [Unframed, Framed])
@pytest.mark.parametrize("field", range(0, 8, 3))
def test_an_answer_with_one_value_out_of_range_is_not_used(field, kind):
    said = answers(0, 5.0)
    wrap = framed if kind is Framed else bytes
    distances = list(said[7].distances)
    for value in (4001, -1):
        distances[field] = value
        spoiled = [*said[:7], said[7]._replace(distances=tuple(distances)), *said[8:]]
        assert used(heard(kind(), (wrap(encode_answer(a)) for a in spoiled))) == said[:7] + said[8:]


@pytest.mark.parametrize("change", [{"x": 400}, {"y": -400}, {"heading": 2000}])
@pytest.mark.parametrize("kind", [Unframed, Framed])
def test_a_jump_beyond_what_the_robot_can_move_is_not_used(kind, change):
    said = answers(0, 5.0)
    wrap = framed if kind is Framed else bytes
    (name, by), far = next(iter(change.items())), 10 if kind is Framed else 1
    jumped = said[7]._replace(**{name: overflowed(getattr(said[7], name) + far * by)})
    stream = kind()
    assert used(heard(stream, (wrap(encode_answer(a)) for a in [*said[:7], jumped, *said[8:]]))) == said[:7] + said[8:]
    assert +stream.faults == Counter(garbage=1)


@pytest.mark.parametrize("kind", [Unframed, Framed])
def test_odometry_that_began_anew_is_believed_at_the_third_answer_and_said_to_be_not_joined(kind):
    said = answers(0, 30.0)
    wrap = framed if kind is Framed else bytes
    anew = answers(0, 5.0)
    assert not reachable(said[-1], anew[0], 2.0)
    by_piece = heard(kind(), [wrap(encode_answer(a)) for a in said + anew])
    assert used(by_piece) == said + anew
    assert [len(by_piece[len(said) + i]) for i in range(4)] == [0, 0, 3, 1]
    joined = [p.joined for packets in by_piece for p in packets]
    assert [i for i, j in enumerate(joined) if not j] == [0, len(said)]


def test_shifted_answers_of_a_robot_at_rest_are_not_used_though_they_go_with_each_other():
    said = [Answer((500,) * 8, 700, 2000, 300)] * 12
    pieces = [encode_answer(a) for a in said]
    by_piece = heard(Unframed(), [*pieces[:5], pieces[5][2:] + b"".join(pieces[6:10]), *pieces[10:]])
    assert used(by_piece) == said[:7]


def recognized(seed, count, seconds):
    """Shifts by lost bytes at random; shares recognized within three packets, and with a wrong packet used."""
    rng, said = np.random.default_rng(seed), answers(seed, seconds)
    right, wrong = 0, 0
    for _ in range(count):
        first, lost = int(rng.integers(len(said) - 12)), int(rng.integers(1, 22))
        part = said[first : first + 12]
        pieces = [encode_answer(a) for a in part]
        at = int(rng.integers(0, 23 - lost))
        pieces[4] = pieces[4][:at] + pieces[4][at + lost :]
        by_piece = heard(Unframed(), pieces)
        false = [i for i, packets in enumerate(by_piece) for p in packets if p.answer not in part]
        taken = used(by_piece)
        right += all(a in taken for a in part[7:11]) and max(false, default=0) <= 7
        wrong += bool(false)
    return right / count, wrong / count


def test_a_shifted_stream_is_recognized_within_three_packets():
    right, wrong = recognized(0, 100, 30.0)
    assert right >= 0.99
    assert wrong <= 0.01


def spoiled(rng, data, drop, flip):
    out = bytearray()
    for byte in data:
        if rng.random() >= drop:
            out.append(byte ^ (1 << int(rng.integers(8)) if rng.random() < flip else 0))
    return bytes(out)
