"""`python -m eval.audit`: any factor graph examined, of the wing `audit`."""

import sys

from data.wing import used

if __name__ == "__main__":
    sys.exit(used("wings.audit.command:main")())
