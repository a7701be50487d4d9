"""`python -m eval.step`: walk through a log, one frame at each press of Enter, of the wing `labs`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.labs.stepping.command:main")())
