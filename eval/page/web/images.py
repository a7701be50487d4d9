"""Figures inside the page: as WebP where that is smaller than the PNG file, with the size they are shown at."""

from __future__ import annotations

import base64
import html
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from cv2.typing import MatLike

QUALITY, LOSSLESS = 60, 101
"""Of WebP. At 60, lines drawn at two pixels for a page pixel look the same (compared) at half the lossless size."""
FLAT = 2.0
"""A figure whose PNG is less than so many times as large has few colours, and lossless may be smaller still: bars."""
THREADS = 2


def images(folder: Path, stems: Sequence[str]) -> dict[str, str]:
    """`<img` with size and source (no alternative text, not closed) for each of `folder/figures/<stem>.png`.

    Raises FileNotFoundError, which names a missing one.
    """
    wanted = list(dict.fromkeys(stems))
    with ThreadPoolExecutor(THREADS) as threads:
        made = threads.map(_image, [folder / "figures" / f"{stem}.png" for stem in wanted])
        return dict(zip(wanted, made, strict=True))


def _image(path: Path) -> str:
    data = path.read_bytes()
    width, height = _png_size(data)
    kind, shown = "png", data
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is not None:
        found = [_webp(pixels, QUALITY)]
        if len(data) < FLAT * len(found[0]):
            found.append(_webp(pixels, LOSSLESS))
        smallest = min(found, key=len)
        if len(smallest) < len(data):
            kind, shown = "webp", smallest
    # two image pixels for a page pixel: sharp on fine screens
    size = f'width="{width // 2}" height="{height // 2}"'
    return f'<img {size} src="data:image/{kind};base64,{base64.b64encode(shown).decode()}"'


def _webp(pixels: MatLike, quality: int) -> bytes:
    return cv2.imencode(".webp", pixels, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


def with_alt(image: str, alt: str) -> str:
    """The whole element."""
    return f'{image} alt="{html.escape(alt)}">'


def _png_size(data: bytes) -> tuple[int, int]:
    """Width and height in pixels, from the header (PNG specification, section 11.2.1)."""
    width, height = struct.unpack(">II", data[16:24])
    return int(width), int(height)
