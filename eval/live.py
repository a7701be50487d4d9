"""`python -m eval.live`: online estimates while a small robot drives, of the wing `robot`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.robot.live.__main__:main")())
