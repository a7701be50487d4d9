"""The cheapest assignments of the observations of a frame, in order (Murty, "An algorithm for ranking all the
assignments in order of increasing cost", Operations Research 16(3), 1968).
"""

import heapq

import numpy as np
import scipy

from data.inputs import IntArray
from data.se2 import Array


def best_assignments(cost: Array, most: int, slack: float) -> list[tuple[float, IntArray]]:
    """Assignments of all rows to different columns, cheapest first.

    Args:
        cost: (m, n), infinite where a row cannot have a column.
        most: greatest number of assignments.
        slack: those that cost more than the cheapest one by this are left out.

    Returns:
        Summed cost and column (m,) of each; empty if every assignment has an infinite cost.
    """
    found = list[tuple[float, IntArray]]()
    problems = list[tuple[float, int, IntArray, Array, int]]()  # cost, order, columns; what is allowed, rows fixed
    limit = np.inf

    def solve(allowed: Array, fixed: int) -> None:
        try:
            rows, columns = scipy.optimize.linear_sum_assignment(allowed)
        except ValueError:  # every assignment has an infinite cost
            return
        total = float(allowed[rows, columns].sum())
        if total <= limit:
            heapq.heappush(problems, (total, len(found) * len(cost) + fixed, columns, allowed, fixed))

    solve(cost, 0)
    while problems and len(found) < most:
        total, _, columns, allowed, fixed = heapq.heappop(problems)
        found.append((total, columns))
        limit = found[0][0] + slack
        # the other assignments of this problem: the first that differs in a row, by row
        left = allowed.copy()
        for row in range(fixed, len(cost)):
            other = left.copy()
            other[row, columns[row]] = np.inf
            solve(other, row)
            left[row, np.arange(left.shape[1]) != columns[row]] = np.inf
    return found
