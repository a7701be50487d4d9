"""`python -m eval.camera`: the camera's calibration from a recording with images, of the wing `camera`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.camera.command:main")())
