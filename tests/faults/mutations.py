"""Faults for files: structure-aware where the structure is known (tables, TOML, zip, npy, MAT), bytes everywhere."""

import io
import lzma
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

Files = dict[str, bytes]
BROKEN = (ValueError, EOFError, KeyError, OSError, RuntimeError, zlib.error, zipfile.BadZipFile, lzma.LZMAError)
Rng = np.random.Generator
Fault = Callable[[bytes, Rng], bytes]

JUNK = [
    *(b"", b" ", b"nan", b"NaN", b"inf", b"-inf", b"-nan", b"1e309", b"1e-400", b"-0.0", b"-1", b"0", b"1", b"1e30"),
    *(b"9" * 400, b"1" * 5000, b"-" * 30, b"0x10", b"1_000", b"1,5", b"1;5", b'"1"', b"'", b'"', b"#", b"%", b"=1+1"),
    *(b"true", b"[]", b"{}", b"[1, 2]", b"2026-11-23", b"x", b"\x00", b"\xff\xfe", b"\xd9\xa3", b"\xc3\xa9", b"\r"),
    *(b"1000000000", b"-1000000000", b"9223372036854775808", b"4294967296", b"2147483647", b"1e9", b"1e15", b"1e16"),
    *(b"0.5", b"1e-320", b"\xef\xbb\xbf", b"\\", b"../../x", b"%s%n", b"\x1b[31m", b"A" * 100_000),
]
HUGE = (10**9, 2**31 - 1, 2**32, 2**62, -1, 0)
DEPTH = 50_000


def pick(rng: Rng, items):
    return items[int(rng.integers(len(items)))]


def flipped(content: bytes, rng: Rng) -> bytes:
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(data) + 1))
        kind = int(rng.integers(4))
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1 and at < len(data):
            data[at] = int(rng.integers(256))
        elif kind == 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 9)))
        else:
            del data[at : at + int(rng.integers(1, 9))]
    return bytes(data)


def truncated(content: bytes, rng: Rng) -> bytes:
    return content[: int(rng.integers(len(content) + 1))]


def extended(content: bytes, rng: Rng) -> bytes:
    return content + pick(rng, [pick(rng, JUNK), b"\n" * 1000, content, rng.bytes(50), b"\x00" * 1000])


def emptied(content: bytes, rng: Rng) -> bytes:
    return pick(rng, [b"", b"\n", b" ", b"\x00", b"\xef\xbb\xbf", b"\r\n\r\n"])


BYTES: list[Fault] = [flipped, flipped, truncated, extended, emptied]


def separator_of(line: bytes) -> bytes | None:
    """What stands between the fields of a line: a comma, or any space (None)."""
    return b"," if b"," in line else None


def tabled(content: bytes, rng: Rng) -> bytes:
    """A table of text: a field, a line or a column is not what it was."""
    lines = content.split(b"\n")
    i, j = (int(k) for k in rng.integers(len(lines), size=2))
    kind = int(rng.integers(10))
    separator = separator_of(lines[i])
    glue = separator or b" "
    fields = lines[i].split(separator)
    if kind <= 3 and fields:
        fields[int(rng.integers(len(fields)))] = pick(rng, JUNK)
        lines[i] = glue.join(fields)
    elif kind == 4 and fields:
        k = int(rng.integers(len(fields)))
        fields[k:k] = [pick(rng, [pick(rng, JUNK), fields[k]])]
        lines[i] = glue.join(fields)
    elif kind == 5 and fields:
        del fields[int(rng.integers(len(fields)))]
        lines[i] = glue.join(fields)
    elif kind == 6:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 7:
        lines[i:i] = [pick(rng, [lines[j], b"", b"# " + lines[j], pick(rng, JUNK)])]
    elif kind == 8:
        del lines[i]
    else:
        separator = separator_of(lines[0])
        k = int(rng.integers(max(len(lines[0].split(separator)), 1)))
        glue = separator or b" "
        lines = [glue.join(f for c, f in enumerate(line.split(separator)) if c != k) for line in lines]
    ending = b"\r\n" if rng.random() < 0.05 else b"\n"
    return ending.join(lines)


def swollen(content: bytes, rng: Rng) -> bytes:
    lines = content.split(b"\n")
    i = int(rng.integers(len(lines)))
    lines[i] += pick(rng, [b"9" * 200_000, b"," * 200_000, b" 1" * 100_000, b"\x00" * 200_000])
    return b"\n".join(lines)


TABLE: list[Fault] = [tabled, tabled, tabled, tabled, flipped, truncated, extended, emptied, swollen]


def deep(content: bytes, rng: Rng) -> bytes:
    open_, close = pick(rng, [(b"[", b"]"), (b"{a=", b"}"), (b"[{a=", b"}]")])
    n = int(rng.integers(50, DEPTH))
    nested = pick(rng, [b"deep = " + open_ * n + close * n, b"deep" + b".a" * n + b" = 1", b"[" + b"a." * n + b"a]"])
    return nested + b"\n" + content


def keyed(content: bytes, rng: Rng) -> bytes:
    """TOML: a value of another kind, a key twice, missing, or unknown."""
    lines = content.split(b"\n")
    i = pick(rng, [i for i, line in enumerate(lines) if b"=" in line] or [0])
    key, _, _ = lines[i].partition(b"=")
    values = [
        b"1", b"-1", b"1e400", b"nan", b"-inf", b'""', b'"x"', b"true", b"[]", b"[1]", b"{}", b"{a = 1}", b"[[1]]",
    ]  # fmt: skip
    values += [
        b"1979-05-27", b"0x7fffffffffffffff", b"1" * 5000, b"'''", b'"\\u0000"', b"[nan, nan, nan]", b"99999999999",
    ]  # fmt: skip
    kind = int(rng.integers(6))
    if kind <= 2:
        lines[i] = key + b"= " + pick(rng, values)
    elif kind == 3:
        lines[i:i] = [pick(rng, [lines[i], b"unknown = 1", b"[unknown]", b"[[sensor]]", b"[prior]"])]
    elif kind == 4:
        del lines[i]
    else:
        lines[i] = pick(rng, [b"", key, key + b"=", b"= 1", lines[i] + b" 2"])
    return b"\n".join(lines)


TOML: list[Fault] = [keyed, keyed, keyed, deep, tabled, flipped, truncated, extended, emptied]


def npy_header(shape: object, descr: object, *, fortran: object = False, version: tuple[int, int] = (1, 0)) -> bytes:
    """The head of an npy file with a header of one's own making."""
    text = repr({"descr": descr, "fortran_order": fortran, "shape": shape}).encode()
    pad = b" " * (-(len(text) + 11) % 64) + b"\n"
    size = struct.pack("<H" if version[0] == 1 else "<I", len(text) + len(pad))
    return b"\x93NUMPY" + bytes(version) + size + text + pad


def npy(content: bytes, rng: Rng) -> bytes:
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
    except (ValueError, SyntaxError, TypeError, tokenize.TokenError):  # a fault before has changed the header
        return flipped(content, rng)
    rest = content[stream.tell() :]
    descr: object = dtype.descr if dtype.names else dtype.str
    kind = int(rng.integers(7))
    if kind == 0:
        shape = tuple(pick(rng, HUGE) if rng.random() < 0.5 else n for n in (*shape, 1))
    elif kind == 1:
        shape = pick(rng, [(), (0,), (3,), (2, 0), shape[::-1], (*shape, 1), (10**9,), "x", None, (1.5,), [4]])
    elif kind == 2:
        descr = pick(rng, ["|O", "<f2", "<c16", "<U5", "|S9", "<M8[s]", "|b1", "<i1", ">f8", "x", None, "<f999", "|V8"])
    elif kind == 3:
        descr = [("timestamp", "<f8"), ("rgb", "|O")]
    elif kind == 4:
        fortran = pick(rng, [True, 1, "x"])
    elif kind == 5:
        version = pick(rng, [(1, 0), (2, 0), (3, 0), (9, 9)])
    else:
        rest = rest[: int(rng.integers(len(rest) + 1))]
    return npy_header(shape, descr, fortran=fortran, version=version) + rest


BOMB = 256 << 20
"""Bytes of zeros that a bomb inflates to."""
_ZEROS: list[bytes] = []


def zeros() -> bytes:
    if not _ZEROS:
        deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
        block = bytes(1 << 20)
        _ZEROS.append(b"".join([*(deflate.compress(block) for _ in range(BOMB >> 20)), deflate.flush()]))
    return _ZEROS[0]


def bomb_entry(name: str, head: bytes) -> bytes:
    """A zip with one entry: `head`, then `BOMB` zeros, deflated to a thousandth."""
    stored = zlib.compressobj(0, zlib.DEFLATED, -15)
    data = stored.compress(head) + stored.flush(zlib.Z_FULL_FLUSH) + zeros()
    size, crc = len(head) + BOMB, 0
    crc = zlib.crc32(head)
    for _ in range(BOMB >> 20):
        crc = zlib.crc32(bytes(1 << 20), crc)
    encoded = name.encode()
    common = struct.pack("<HHHHHIIIHH", 20, 0, 8, 0, 33, crc, len(data), size, len(encoded), 0)
    local = b"PK\x03\x04" + common + encoded + data
    central = b"PK\x01\x02" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, 0) + encoded
    return local + central + struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, 1, 1, len(central), len(local), 0)


def zipped(inner: Callable[[str], list[Fault]]) -> Fault:
    """Faults of a zip: of what is in it (`inner` says for a name which), of its directory, and bombs."""

    def fault(content: bytes, rng: Rng) -> bytes:
        try:
            with zipfile.ZipFile(io.BytesIO(content)) as z:
                entries = {n: z.read(n) for n in z.namelist()}
        except BROKEN:  # a fault before has made it no zip any more
            return flipped(content, rng)
        name = pick(rng, sorted(entries) or ["x"])
        kind = int(rng.integers(8))
        method = pick(rng, [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
        if kind <= 2 and entries:
            entries[name] = pick(rng, inner(name))(entries[name], rng)
        elif kind == 3:
            entries[pick(rng, ["../x", "/x", "a/" * 500 + "x", "x.npy", "frame", "\u0663", name.upper()])] = b"1"
        elif kind == 4 and entries:
            del entries[name]
        elif kind == 5 and entries:
            entries[name + "2"] = entries.pop(name)
        elif kind == 6 and rng.random() < 0.05:
            return bomb_entry(name, npy_header((BOMB // 8,), "<f8") if name.endswith("npy") else b"")
        else:
            return flipped(content, rng)
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", method) as z:
            for n, data in entries.items():
                z.writestr(n, data)
        return buffer.getvalue()

    return fault


def mat_elements(content: bytes, rng: Rng) -> bytes:
    """A MAT file 5: a tag of an element says another type or size, or a compressed element holds another thing."""
    places, at = [], 128
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        places.append((at, kind, size))
        at += 8 + size
    if not places:
        return flipped(content, rng)
    at, kind, size = pick(rng, places)
    choice = int(rng.integers(5))
    if choice == 0:
        return content[:at] + struct.pack("<II", int(rng.integers(0, 20)), size) + content[at + 8 :]
    if choice == 1:
        lie = int(pick(rng, [0, 1, 7, 2**31 - 1, 2**32 - 1, size + 1, max(size - 1, 0)]))
        return content[:at] + struct.pack("<II", kind, lie) + content[at + 8 :]
    if kind != 15:
        return content[:at] + _within(content[at : at + 8 + size], rng) + content[at + 8 + size :]
    if choice == 2 and rng.random() < 0.05:
        data = b"\x78\xda" + zeros() + struct.pack(">I", 1)
        return content[:at] + struct.pack("<II", 15, len(data)) + data
    try:
        inner = zlib.decompress(content[at + 8 : at + 8 + size])
    except zlib.error:
        return flipped(content, rng)
    data = zlib.compress(_within(inner, rng))
    return content[:at] + struct.pack("<II", 15, len(data)) + data + content[at + 8 + size :]


def _within(element: bytes, rng: Rng) -> bytes:
    """One aligned word of an element is another number: a type, a size, a dimension, a flag."""
    if len(element) < 16:
        return flipped(element, rng)
    at = 4 * int(rng.integers(min(len(element), 400) // 4 - 1))
    value = int(
        pick(rng, [0, 1, 2, 3, 5, 6, 9, 14, 15, 16, 255, 10**9, 2**31 - 1, 2**32 - 1, int(rng.integers(2**32))])
    )
    return element[:at] + struct.pack("<I", value) + element[at + 4 :]


MAT: list[Fault] = [mat_elements, mat_elements, mat_elements, flipped, truncated, extended, emptied]
NPY: list[Fault] = [npy, npy, npy, flipped, truncated, extended, emptied]


def mutated(files: Files, faults_of: Callable[[str], list[Fault]], rng: Rng) -> Files:
    """One to three faults anywhere in a folder; a file may be missing, too."""
    broken = dict(files)
    for _ in range(int(rng.integers(1, 4))):
        name = pick(rng, sorted(broken))
        if len(broken) > 1 and rng.random() < 0.03:
            del broken[name]
            continue
        broken[name] = pick(rng, faults_of(name))(broken[name], rng)
    return broken
