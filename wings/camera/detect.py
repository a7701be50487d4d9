"""`slamref detect IMAGE REFERENCE...`: find reference pictures in a photo and outline them."""

from collections import Counter
from collections.abc import Sequence

from data.errors import DataError, UsageError
from data.terminal import ending
from eval.plan.flags import command_of

PROG = "slamref detect"
LARGEST = 1600  # px, longer side of a photo's searched copy, twice that of the camera frames the detector was tuned for


@ending()
def main(argv: Sequence[str] | None = None, prog: str = PROG) -> None:
    """The command `prog`; returns its exit status."""
    options = command_of(prog, PROG, "detect").read(argv)
    image, references, out = options.image, options.references, options.out
    if out is not None and out.suffix.lower() != ".png":
        raise UsageError(f"--out {out}: a file name that ends in .png is needed")
    from wings.camera.detector import Detector, shrunk
    from wings.camera.lab.folder import read_image

    photo = read_image(image)
    pictures = [read_image(path) for path in references]
    scale = min(1.0, LARGEST / max(photo.shape[:2]))
    try:
        detector = Detector(pictures)
    except DataError as fault:
        raise DataError(f"{fault} (numbered as given: {', '.join(p.name for p in references)})") from None
    result = detector.detect(shrunk(photo, LARGEST))
    same = Counter(p.name for p in references)
    names = [p.name if same[p.name] == 1 else str(p) for p in references]
    # pixel centres at whole numbers: the image begins half a pixel before the first of them
    placed = [(d, (d.pixels + 0.5) / scale - 0.5) for d in result.detections]
    print(f"{image.name}: {len(placed)} of {len(names)} pictures found")
    for d, corners in placed:
        where = " ".join(f"({u:.1f}, {v:.1f})" for u, v in corners.tolist())
        fit = f"reprojection RMS {d.reprojection / scale:.2f} px, worst corner σ {d.corner_sigma / scale:.2f} px"
        print(f"{names[d.picture]}: corners {where} px; {d.inliers} features agree, {fit}")
    for picture, reason in result.refused:
        print(f"{names[picture]}: {reason}")
    if out is not None:
        from data.whole import whole_file
        from wings.camera.detector import encoded, outlined

        png = encoded(outlined(photo, [(names[d.picture], corners) for d, corners in placed]))
        try:
            with whole_file(out) as partial:
                partial.write_bytes(png)
        except OSError as fault:
            raise UsageError(f"--out {out}: cannot be written: {fault.strerror}") from fault
