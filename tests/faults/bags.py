"""Faults of ROS bags: records, chunks and their compression, connections, definitions, and what messages hold."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import lz4.frame
from backports import zstd

from tests.faults.mutations import BOMB, BYTES, DEPTH, JUNK, Fault, Rng, flipped, pick, tabled

WORDS = (0, 1, 2, 4, 255, 65535, 10**9, 2**31 - 1, 2**31, 2**32 - 1)
LONG_WORDS = (*WORDS, 2**32, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, -1.0, 1e-320, 1e30, 1e300, 1e308)
MAGIC1, MAGIC2 = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
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
    try:
        inner = records_of(UNPACK[method](chunk.data))
    except (KeyError, EOFError, OSError, RuntimeError, ValueError):  # a fault before has made it no chunk any more
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
    records = records_of(content[len(MAGIC1) :])
    if not content.startswith(MAGIC1) or len(records) < 2:
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
        at = struct.pack("<Q", len(MAGIC1) + index + longer)
        head = [(n, at if n == b"index_pos" else v) for n, v in records[0].fields]
        pieces[0] = Record(head, records[0].data).bytes()
    return MAGIC1 + b"".join(pieces)


def parts_of(content: bytes) -> list[tuple[int, bytes]]:
    """Records of an MCAP file, or of a chunk of one: kind and content, as far as they can be told apart."""
    parts, at = [], 0
    while at + 9 <= len(content):
        kind, size = struct.unpack_from("<BQ", content, at)
        parts.append((kind, content[at + 9 : at + 9 + size]))
        at += 9 + size
    return parts


def joined(parts: list[tuple[int, bytes]]) -> bytes:
    return b"".join(struct.pack("<BQ", kind, len(content)) + content for kind, content in parts)


def part_changed(part: tuple[int, bytes], rng: Rng) -> tuple[int, bytes]:
    kind, content = part
    if kind == 3 and rng.random() < 0.7:  # a schema: number, name, encoding, text
        at = 2
        for _ in range(2):
            at += 4 + struct.unpack_from("<I", content + bytes(8), at)[0]
        text = defined(content[at + 4 :], rng)
        return kind, content[:at] + struct.pack("<I", len(text)) + text
    choice = int(rng.integers(5))
    if choice == 0:
        return int(rng.integers(16)), content
    return kind, worded(content, rng, pick(rng, [1, 2])) if choice <= 3 else flipped(content, rng)


def chunk_changed(content: bytes, rng: Rng) -> bytes:
    """A chunk of MCAP: times, size, checksum, name of the compression, size, what is packed."""
    if len(content) < 40:
        return flipped(content, rng)
    (length,) = struct.unpack_from("<I", content, 28)
    method, packed = content[32 : 32 + length], content[40 + length :]
    try:
        inner = parts_of(UNPACK[method](packed))
    except (KeyError, EOFError, RuntimeError, ValueError, zstd.ZstdError):  # a fault before has made it no chunk
        return worded(content, rng)
    raw = joined(inner)
    if rng.random() < 0.05:
        method = pick(rng, [b"lz4", b"zstd"])
        packed, size = bomb(method), pick(rng, [BOMB, len(raw)])
    else:
        i = int(rng.integers(len(inner))) if inner else 0
        inner[i : i + 1] = pick(rng, [[], inner[i : i + 1] * 2, *[[part_changed(p, rng) for p in inner[i : i + 1]]] * 4])
        raw = joined(inner)
        packed, size = PACK[method](raw), pick(rng, [len(raw)] * 9 + [len(raw) + 1])
    head = content[:16] + struct.pack("<QI", size, 0) + struct.pack("<I", len(method)) + method
    return head + struct.pack("<Q", len(packed)) + packed


def mcap(content: bytes, rng: Rng) -> bytes:
    """An MCAP file: one record is not what it was; where that shifts others, the file has no summary."""
    parts = parts_of(content[len(MAGIC2) : -len(MAGIC2)])
    if not content.startswith(MAGIC2) or len(parts) < 2:
        return flipped(content, rng)
    length = len(joined(parts))
    chunks = [k for k, (kind, _) in enumerate(parts) if kind == 6]
    choice = int(rng.integers(6))
    k = pick(rng, chunks) if chunks and choice <= 2 else int(rng.integers(len(parts)))
    if choice <= 2 and chunks:
        parts[k] = (6, chunk_changed(parts[k][1], rng))
    elif choice <= 4:
        parts[k] = part_changed(parts[k], rng)
    else:
        whole = [joined([p]) for p in parts]
        whole[k] = whole[k][:1] + struct.pack("<Q", pick(rng, LONG_WORDS)) + whole[k][9:]
        return MAGIC2 + b"".join(whole) + MAGIC2
    if len(joined(parts)) != length:
        parts = [p if p[0] != 2 else (2, bytes(20)) for p in parts]
    return MAGIC2 + joined(parts) + MAGIC2


def database(content: bytes, rng: Rng) -> bytes:
    """A bag in SQLite: a value of a table is another, or another kind; or pages are not what they were."""
    if rng.random() < 0.3:
        page = 4096 * int(rng.integers(len(content) // 4096 + 1))
        return content[:page] + worded(content[page : page + 120], rng) + content[page + 120 :]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag.db3"
        path.write_bytes(content)
        try:
            with sqlite3.connect(path) as base:
                _altered(base, rng)
        except (sqlite3.Error, UnicodeDecodeError, OverflowError):  # a fault before has made it no database any more
            return flipped(content, rng)
        finally:
            base.close()
        return path.read_bytes()


def _altered(base: sqlite3.Connection, rng: Rng) -> None:
    columns = [
        (table, column[1])
        for (table,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'").fetchall()
        for column in base.execute(f"PRAGMA table_info({table})").fetchall()
    ]
    table, column = pick(rng, columns + [("messages", "data")] * len(columns))
    if rng.random() < 0.05:
        base.execute(pick(rng, [f"DROP TABLE {table}", f"DELETE FROM {table}", "DROP INDEX timestamp_idx"]))
        return
    row, value = pick(rng, base.execute(f"SELECT rowid, {column} FROM {table} ORDER BY rowid").fetchall() or [(0, 0)])
    new: object = pick(rng, [*LONG_WORDS[:-2], -1, 1.5, float("inf"), "", "x", b"", b"\xff\xfe", "9" * 5000, "[" * 9999])
    if isinstance(value, bytes) and rng.random() < 0.9:
        new = pick(rng, [worded(value, rng), flipped(value, rng), value[: int(rng.integers(len(value) + 1))]])
    elif column == "encoded_message_definition" and rng.random() < 0.9:
        new = defined(value.encode(), rng).decode("latin-1")
    if column in ("id", "schema_version"):
        new = pick(rng, [0, 1, 2, 3, 4, 9, -1, 2**62])
    base.execute("PRAGMA ignore_check_constraints = 1")
    base.execute(f"UPDATE OR REPLACE {table} SET {column} = ? WHERE rowid = ?", (new, row))


def yaml(content: bytes, rng: Rng) -> bytes:
    """Metadata: a value of another kind, or nested without end."""
    lines = content.split(b"\n")
    i = pick(rng, [k for k, line in enumerate(lines) if b":" in line] or [0])
    key, _, value = lines[i].partition(b":")
    odd = [b"", b" x", b" []", b" {}", b" [1]", b" -1", b" 1e400", b" .nan", b" ~", b" *a", b" &a [*a]", b" !!binary x"]
    odd += [b" !!python/object:os.system x", b" 2026-11-23", b" " + b"[" * DEPTH, b" " + b"{a: " * DEPTH, b" |", b" '"]
    odd += [b" zstd", b" message", b" file", b" mcap", b" sqlite3", b" [../x]", b" " + b"9" * 5000]
    lines[i : i + 1] = pick(rng, [[key + b":" + pick(rng, odd)]] * 4 + [[], [lines[i]] * 2, [b"  " + lines[i]]])
    return b"\n".join(lines)


def packed(content: bytes, rng: Rng) -> bytes:
    """A file of zstd: a fault of what is in it, or a bomb."""
    try:
        raw = zstd.decompress(content)
    except zstd.ZstdError:
        return flipped(content, rng)
    return bomb(b"zstd") if rng.random() < 0.05 else zstd.compress(database(raw, rng))


BAGS: dict[str, list[Fault]] = {
    "bag": [bag, bag, bag, bag, *BYTES],
    "mcap": [mcap, mcap, mcap, mcap, *BYTES],
    "db3": [database, database, database, database, *BYTES],
    "yaml": [yaml, yaml, tabled, *BYTES],
    "zstd": [packed, packed, packed, *BYTES],
}
