"""Faults of ROS 2 bags: MCAP records, values of a database, metadata, what is packed; of every bag by its name."""

from __future__ import annotations

import sqlite3
import struct
import tempfile
from pathlib import Path

from backports import zstd

from tests.faults.bags import LONG_WORDS, PACK, UNPACK, bag, bomb, defined, is_bomb, worded
from tests.faults.mutations import BOMB, BYTES, DEPTH, Fault, Rng, flipped, pick, tabled

MAGIC = b"\x89MCAP0\r\n"


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
    if is_bomb(packed):
        return worded(content, rng)
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
        inner[i : i + 1] = pick(
            rng, [[], inner[i : i + 1] * 2, *[[part_changed(p, rng) for p in inner[i : i + 1]]] * 4]
        )
        raw = joined(inner)
        packed, size = PACK[method](raw), pick(rng, [len(raw)] * 9 + [len(raw) + 1])
    head = content[:16] + struct.pack("<QI", size, 0) + struct.pack("<I", len(method)) + method
    return head + struct.pack("<Q", len(packed)) + packed


def mcap(content: bytes, rng: Rng) -> bytes:
    """An MCAP file: one record is not what it was; where that shifts others, the file has no summary."""
    parts = parts_of(content[len(MAGIC) : -len(MAGIC)])
    if not content.startswith(MAGIC) or len(parts) < 2:
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
        return MAGIC + b"".join(whole) + MAGIC
    if len(joined(parts)) != length:
        parts = [p if p[0] != 2 else (2, bytes(20)) for p in parts]
    return MAGIC + joined(parts) + MAGIC


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
    table, column = pick(rng, columns + [("messages", "data")] * max(len(columns), 1))
    if rng.random() < 0.05:
        base.execute(pick(rng, [f"DROP TABLE {table}", f"DELETE FROM {table}", "DROP INDEX timestamp_idx"]))
        return
    row, value = pick(rng, base.execute(f"SELECT rowid, {column} FROM {table} ORDER BY rowid").fetchall() or [(0, 0)])
    new: object = pick(
        rng, [*LONG_WORDS[:-2], -1, 1.5, float("inf"), "", "x", b"", b"\xff\xfe", "9" * 5000, "[" * 9999]
    )
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
    key = lines[i].partition(b":")[0]
    odd = [b"", b" x", b" []", b" {}", b" [1]", b" -1", b" 1e400", b" .nan", b" ~", b" *a", b" &a [*a]", b" !!binary x"]
    odd += [b" !!python/object:os.system x", b" 2026-11-23", b" " + b"[" * DEPTH, b" " + b"{a: " * DEPTH, b" |", b" '"]
    odd += [b" zstd", b" message", b" file", b" mcap", b" sqlite3", b" [../x]", b" " + b"9" * 5000]
    lines[i : i + 1] = pick(rng, [[key + b":" + pick(rng, odd)]] * 4 + [[], [lines[i]] * 2, [b"  " + lines[i]]])
    return b"\n".join(lines)


def packed(content: bytes, rng: Rng) -> bytes:
    """A file of zstd: a fault of what is in it, or a bomb."""
    if is_bomb(content):
        return flipped(content, rng)
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
