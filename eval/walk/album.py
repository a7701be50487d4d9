"""Where the pictures of a walk through a log go: windows, files, both, or nowhere."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.image import imread

from data.errors import UsageError
from data.whole import whole_file
from eval.figures.style import drawing

DPI = 110
WINDOWED = ("macosx", "qt", "tk", "gtk", "wx")
"""How the names of matplotlib's backends begin that open windows."""
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")


def open_windows() -> Any:
    """Matplotlib's pyplot if it can open windows here, else None."""
    if sys.platform not in ("darwin", "win32") and not any(os.environ.get(name) for name in SCREENS):
        return None
    try:
        from matplotlib import pyplot

        pyplot.switch_backend(pyplot.get_backend())
    except (ImportError, ValueError, RuntimeError):
        return None
    return pyplot if pyplot.get_backend().lower().startswith(WINDOWED) else None


class Album:
    """Where pictures go: windows, files, both, or nowhere."""

    def __init__(self, folder: Path | None, windows: Any) -> None:
        """Makes the folder; raises UsageError if that cannot be done."""
        self.folder, self.windows = folder, windows
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as fault:
                raise UsageError(f"--save {folder}: {fault.strerror}") from fault

    @property
    def wanted(self) -> bool:
        """Whether anybody sees a picture."""
        return self.folder is not None or self.windows is not None

    def show(self, name: str, paint: Callable[[Figure], object], stem: str | None) -> None:
        """A picture in the window `name` and, with a stem, as a file; nothing is painted for nobody."""
        if self.windows is None and (self.folder is None or stem is None):
            return
        # a layout engine would draw everything twice, and the painters know where things stand; saving a figure puts
        # back the one that the settings name, so they must not name any until all is done
        with drawing(), rc_context({"figure.constrained_layout.use": False}):
            figure = Figure() if self.windows is None else self.windows.figure(num=name, clear=True)
            paint(figure)
            if stem is not None:
                self.write(f"{stem}.png", _png(figure))
            if self.windows is not None:
                figure.canvas.draw_idle()
                self.windows.pause(0.01)

    def show_made(self, name: str, figure: Figure) -> None:
        """The same for a figure that exists already, as the file `name`; a window gets an image of it."""
        with drawing():
            png = _png(figure)
        self.show_image(name, png, name)

    def show_image(self, name: str, png: bytes, stem: str) -> None:
        """An image, as the file `stem` and in the window `name`."""
        self.write(f"{stem}.png", png)
        if self.windows is None:
            return
        image = imread(io.BytesIO(png))
        self.show(name, lambda fig: fig.add_axes((0, 0, 1, 1), frameon=False).imshow(image), None)

    def write(self, name: str, data: bytes) -> None:
        """A whole file, or none."""
        if self.folder is None:
            return
        try:
            with whole_file(self.folder / name) as partial:
                partial.write_bytes(data)
        except OSError as fault:
            raise UsageError(f"--save {self.folder}: {name} cannot be written: {fault.strerror}") from fault


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()
