"""Model solution of the assignment `corridor`."""

import numpy as np

from slamref import NEW


def _distances(e):
    S = e.HPHt[None] + e.R[:, None]
    return np.einsum("mni,mnij,mnj->mn", e.innovations(), np.linalg.inv(S), e.innovations())


def nearest_neighbour(expectation, gate):
    d2 = _distances(expectation)
    decisions = np.full(len(d2), NEW)
    for i, row in enumerate(d2):
        if len(row) and row.min() <= expectation.threshold(gate):
            decisions[i] = expectation.number[np.argmin(row)]
    return decisions


def singles(expectation, gate):
    compatible = _distances(expectation) < expectation.threshold(gate)
    decisions = np.full(len(compatible), NEW)
    for i, row in enumerate(compatible):
        partners = np.flatnonzero(row)
        if len(partners) == 1 and compatible[:, partners[0]].sum() == 1:
            decisions[i] = expectation.number[partners[0]]
    return decisions


def joint_compatibility(expectation, gate):
    e, limit = expectation, [expectation.threshold(gate, k + 1) for k in range(len(expectation.z))]
    compatible = _distances(e) < expectation.threshold(gate)
    nu, joint = e.innovations(), e.joint(np.arange(len(e.number)))
    best = [[], np.inf]

    def distance(pairs):
        i, j = np.array(pairs).T
        at = np.ravel(np.stack([2 * j, 2 * j + 1], axis=1))
        S = joint[np.ix_(at, at)]
        for k, row in enumerate(i):
            S[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += e.R[row]
        v = nu[i, j].ravel()
        return v @ np.linalg.solve(S, v)

    def search(i, pairs, d2):
        left = len(e.z) - i
        if len(pairs) + left < len(best[0]) or (len(pairs) + left == len(best[0]) and d2 >= best[1]):
            return
        if left == 0:
            best[:] = pairs, d2
            return
        taken = [j for _, j in pairs]
        for j in np.flatnonzero(compatible[i]):
            if j not in taken:
                more = distance([*pairs, (i, j)])
                if more < limit[len(pairs)]:
                    search(i + 1, [*pairs, (i, j)], more)
        search(i + 1, pairs, d2)

    search(0, [], 0.0)
    decisions = np.full(len(e.z), NEW)
    for i, j in best[0]:
        decisions[i] = e.number[j]
    return decisions


def maintain(frame, landmarks):
    return landmarks.number[(landmarks.times == 1) & (frame - landmarks.first > 2)]
