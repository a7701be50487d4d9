"""`python -m eval.detect`: reference pictures found in a photo, of the wing `camera`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.camera.detect:main")())
