"""`python -m data.robot.simulate`: the simulated robot, of the wing `robot`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.robot.simulate:main")())
