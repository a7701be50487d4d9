"""`python -m eval.detect IMAGE REFERENCE...`: find reference pictures in a photo of one's own, and outline them.

Only the parser is imported at once, so that `--help` does not wait for the numerical libraries.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from data.command import Command
from data.errors import DataError, UsageError
from data.terminal import ended

PROG = "python -m eval.detect"
LARGEST = 1600
"""px; longer side that a photo is scaled down to while it is searched: twice a camera's frame, for which the detector
was made. Corners are given in the photo's own pixels."""
EXAMPLES = """\
examples:
  python -m eval.detect photo.jpg landmark/*.jpg                    which of these pictures are in the photo, and where
  python -m eval.detect photo.jpg poster.png --out found.png        and a copy of the photo with their outlines

A line for each picture found: its file, corners (u, v) in px from the centre of the upper left pixel (upper left, upper
right, lower right, lower left corner of the picture), matched features that agree, RMS distance of these from where the
homography puts them, standard deviation of the least certain corner. A picture that is partly hidden by the edge of the
photo, or too oblique, is refused; why is said, too.

exit status: 0 fine (also if nothing was found), 2 wrong usage or an image that cannot be read"""


def main(argv: Sequence[str] | None = None, prog: str = PROG) -> int:
    """The whole command, called `prog`; returns the exit status."""
    return ended(lambda: _detect_as_asked(argv, prog))


def _detect_as_asked(argv: Sequence[str] | None, prog: str) -> None:
    parser = Command(
        prog,
        PROG,
        "Find reference pictures in a photo, by SIFT and a checked homography.",
        EXAMPLES,
    )
    parser.add_argument("image", metavar="IMAGE", type=Path, help="the photo")
    parser.add_argument(
        "references", metavar="REFERENCE", type=Path, nargs="+", help="an image of a whole picture and nothing else"
    )
    parser.add_argument(
        "--out", metavar="FILE.png", type=Path, help="write the photo with the outlines of what was found"
    )
    options = parser.read(argv)
    if options.out is not None and options.out.suffix.lower() != ".png":
        raise UsageError(f"--out {options.out}: a file name that ends in .png is needed")
    _detect(options.image, options.references, options.out)


def _detect(image: Path, references: Sequence[Path], out: Path | None) -> None:
    """Print what was found; write the picture if one is wanted."""
    import cv2
    import numpy as np

    from data.formats.lab.folder import read_image
    from data.visual.detector import Detector

    photo = read_image(image)
    pictures = [read_image(path) for path in references]
    scale = min(1.0, LARGEST / max(photo.shape[:2]))
    size = (max(1, round(photo.shape[1] * scale)), max(1, round(photo.shape[0] * scale)))
    searched = photo if scale == 1.0 else np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
    try:
        detector = Detector(pictures)
    except DataError as fault:
        raise DataError(f"{fault} (numbered as given: {', '.join(p.name for p in references)})") from None
    result = detector.detect(searched)
    same = Counter(p.name for p in references)
    names = [p.name if same[p.name] == 1 else str(p) for p in references]
    # pixel centres at whole numbers: the image begins half a pixel before the first of them
    placed = [(d, (d.pixels + 0.5) / scale - 0.5) for d in result.detections]
    print(f"{image.name}: {len(placed)} of {len(names)} pictures found")
    for d, corners in placed:
        where = " ".join(f"({u:.1f}, {v:.1f})" for u, v in corners.tolist())
        print(
            f"{names[d.picture]}: corners {where} px; {d.inliers} features agree, reprojection RMS"
            f" {d.reprojection / scale:.2f} px, worst corner σ {d.corner_sigma / scale:.2f} px"
        )
    for picture, reason in result.refused:
        print(f"{names[picture]}: {reason}")
    if out is not None:
        from data.visual.outlined import outlined
        from data.whole import whole_file

        png = outlined(photo, [(names[d.picture], corners) for d, corners in placed])
        try:
            with whole_file(out) as partial:
                partial.write_bytes(png)
        except OSError as fault:
            raise UsageError(f"--out {out}: cannot be written: {fault.strerror}") from fault


if __name__ == "__main__":
    sys.exit(main())
