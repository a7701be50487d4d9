"""Faults of ROS 1 bags: records, chunks and their compression, connections, definitions, and what messages hold."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable
from typing import NamedTuple

import lz4.frame
from backports import zstd

from tests.faults.mutations import BOMB, DEPTH, JUNK, Rng, flipped, pick, tabled

WORDS = (0, 1, 2, 4, 255, 65535, 10**9, 2**31 - 1, 2**31, 2**32 - 1)
LONG_WORDS = (*WORDS, 2**32, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, -1.0, 1e-320, 1e30, 1e300, 1e308)
MAGIC = b"#ROSBAG V2.0\n"
DEFINITIONS = (
    *(b"float64 ranges", b"string[] ranges", b"float32[2] ranges", b"float32[<=1] ranges", b"string range_max"),
    *(b"sensor_msgs/LaserScan again", b"std_msgs/Header[] header", b"float64 stamp", b"bool[] pose", b"string header"),
    *(b"uint8 A=1", b"x", b"int32", b"=" * 80, b"MSG: std_msgs/Header", b"float32[4294967295] ranges", b"time stamp"),
    *(b"[" * DEPTH, b"a/" * DEPTH + b" x", b"# " + b"x" * 200_000, b"string<=9999999999 s", b"wstring s"),
)
PACK: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": lambda x: x,
    b"": lambda x: x,
    b"bz2": bz2.compress,
    b"lz4": lz4.frame.compress,
    b"zstd": zstd.compress,
}
UNPACK: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": lambda x: x,
    b"": lambda x: x,
    b"bz2": bz2.decompress,
    b"lz4": lz4.frame.decompress,
    b"zstd": zstd.decompress,
}
_BOMBS: dict[bytes, bytes] = {}


def bomb(method: bytes) -> bytes:
    """`BOMB` zeros packed."""
    if method not in _BOMBS:
        _BOMBS[method] = PACK[method](bytes(BOMB))
    return _BOMBS[method]


def is_bomb(content: bytes) -> bool:
    """Whether a fault before has packed zeros into it: to take them apart again would cost seconds."""
    return content in _BOMBS.values()


def worded(content: bytes, rng: Rng, step: int = 1) -> bytes:
    """One number in it is another: a length, a count, a stamp, a coordinate."""
    if len(content) < 8:
        return flipped(content, rng)
    at = step * int(rng.integers((len(content) - 8) // step + 1))
    form, values = pick(rng, [("<I", WORDS), ("<Q", LONG_WORDS), ("<d", FLOATS), ("<f", FLOATS[:8])])
    new = struct.pack(form, pick(rng, values))
    return content[:at] + new + content[at + len(new) :]


def defined(text: bytes, rng: Rng) -> bytes:
    """A definition of a message is another one."""
    lines = text.split(b"\n")
    i = int(rng.integers(len(lines)))
    kind = int(rng.integers(4))
    if kind == 0:
        lines[i] = pick(rng, DEFINITIONS)
    elif kind == 1:
        lines[i:i] = [pick(rng, DEFINITIONS)]
    elif kind == 2:
        del lines[i]
    else:
        return tabled(text, rng)
    return b"\n".join(lines)


class Record(NamedTuple):
    """Of a ROS 1 bag: fields of its header by name, and its data."""

    fields: list[tuple[bytes, bytes]]
    data: bytes

    def field(self, name: bytes) -> bytes:
        return dict(self.fields).get(name, b"")

    def bytes(self) -> bytes:
        header = b"".join(struct.pack("<I", len(n) + 1 + len(v)) + n + b"=" + v for n, v in self.fields)
        return struct.pack("<I", len(header)) + header + struct.pack("<I", len(self.data)) + self.data


def fields_of(header: bytes) -> list[tuple[bytes, bytes]]:
    fields, at = [], 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields.append((name, value))
        at += 4 + size
    return fields


def records_of(content: bytes) -> list[Record]:
    """As far as they can be told apart."""
    records, at = [], 0
    while at + 8 <= len(content):
        (header,) = struct.unpack_from("<I", content, at)
        if at + 8 + header > len(content):
            break
        (size,) = struct.unpack_from("<I", content, at + 4 + header)
        data = content[at + 8 + header : at + 8 + header + size]
        records.append(Record(fields_of(content[at + 4 : at + 4 + header]), data))
        at += 8 + header + size
    return records


def lied(record: Record, rng: Rng) -> bytes:
    """A record whose lengths are not true."""
    whole = record.bytes()
    header = struct.unpack_from("<I", whole)[0]
    at = pick(rng, [0, 4, 4 + header]) if len(whole) > 8 + header else 0
    return whole[:at] + struct.pack("<I", pick(rng, WORDS)) + whole[at + 4 :]


def changed(record: Record, rng: Rng) -> Record:
    """A field of the header, or the data, is another."""
    fields, data = list(record.fields), record.data
    kind = int(rng.integers(6))
    if kind <= 2 and fields:
        k = int(rng.integers(len(fields)))
        name, value = fields[k]
        if name == b"compression":
            value = pick(rng, [b"none", b"bz2", b"lz4", b"zstd", b"", b"\xff"])
        elif name in (b"topic", b"type"):
            value = pick(rng, [b"", b"/", b"/scan", b"/odom", b"nav_msgs/Odometry", b"sensor_msgs/LaserScan", *JUNK])
        else:
            value = pick(rng, [worded(value, rng), value[:-1], value + b"\x00", b"", b"\xff" * len(value), *JUNK[:6]])
        fields[k] = (name, value)
    elif kind == 3 and fields:
        del fields[int(rng.integers(len(fields)))]
    elif kind == 4 and record.field(b"op") == b"\x07":
        inner = [(n, defined(v, rng) if n == b"message_definition" else v) for n, v in fields_of(data)]
        data = Record(inner, b"").bytes()[4:-4]
    else:
        data = worded(data, rng)
    return Record(fields, data)


def repacked(chunk: Record, rng: Rng) -> Record:
    """A chunk in which something else stands, or a bomb."""
    method = chunk.field(b"compression")
    if rng.random() < 0.05:
        method = pick(rng, [b"bz2", b"lz4"])
        size = pick(rng, [struct.pack("<I", BOMB), chunk.field(b"size")])
        return Record([(b"compression", method), (b"op", b"\x05"), (b"size", size)], bomb(method))
    if is_bomb(chunk.data):
        return changed(chunk, rng)
    try:
        inner = records_of(UNPACK[method](chunk.data))
    except (KeyError, EOFError, OSError, RuntimeError, ValueError, zstd.ZstdError):  # a fault before made it no chunk
        return changed(chunk, rng)
    pieces = [r.bytes() for r in inner] or [b""]
    i, j = (int(k) for k in rng.integers(len(pieces), size=2))
    kind = int(rng.integers(6))
    if kind <= 2 and inner:
        pieces[i] = changed(inner[i], rng).bytes()
    elif kind == 3 and inner:
        pieces[i] = lied(inner[i], rng)
    elif kind == 4:
        pieces[i], pieces[j] = pieces[j], pieces[i]
    else:
        del pieces[i]
    content = b"".join(pieces)
    said = {b"size": struct.pack("<I", len(content))} if rng.random() < 0.9 else {}
    return Record([(n, said.get(n, v)) for n, v in chunk.fields], PACK[method](content))


def bag(content: bytes, rng: Rng) -> bytes:
    """A ROS 1 bag: one record is not what it was, and the index stands where it is looked for."""
    records = records_of(content[len(MAGIC) :])
    if not content.startswith(MAGIC) or len(records) < 2:
        return flipped(content, rng)
    pieces = [r.bytes() for r in records]
    chunks = [k for k, r in enumerate(records) if r.field(b"op") == b"\x05"]
    kind = int(rng.integers(8))
    k = pick(rng, chunks) if chunks and kind <= 3 else int(rng.integers(len(records)))
    index = sum(map(len, pieces)) - sum(len(p) for p, r in zip(pieces, records) if r.field(b"op") in (b"\x07", b"\x06"))
    before = len(b"".join(pieces[: k + 1]))
    if kind <= 3:
        pieces[k] = (repacked(records[k], rng) if chunks else changed(records[k], rng)).bytes()
    elif kind <= 5:
        pieces[k] = changed(records[k], rng).bytes()
    elif kind == 6:
        pieces[k] = lied(records[k], rng)
    else:
        pieces[k : k + 1] = pick(rng, [[], [pieces[k]] * 2])
    longer = sum(map(len, pieces)) - sum(len(r.bytes()) for r in records)
    if k and before <= index and longer:
        at = struct.pack("<Q", len(MAGIC) + index + longer)
        head = [(n, at if n == b"index_pos" else v) for n, v in records[0].fields]
        pieces[0] = Record(head, records[0].data).bytes()
    return MAGIC + b"".join(pieces)
