"""Dense statistics of a factor graph: explicit deletion and solution by singular values."""

import gtsam
import numpy as np

from wings.audit.linear import IGNORED

RANK = 1e-9


def rows(graph, values):
    """Stated A, r of each factor, dense, and its weight."""
    keys = sorted(graph.keyVector())
    dims = values.dims()
    at = dict(zip(keys, np.cumsum([0] + [dims[k] for k in keys])))
    out = []
    for i in range(graph.size()):
        f = graph.at(i)
        model = f.noiseModel()
        weight = 1.0
        if isinstance(model, gtsam.noiseModel.Robust):
            J = gtsam.JacobianVector([np.empty((0, 0))] * len(f.keys()))
            r = f.unwhitenedError(values, J)
            R = np.linalg.cholesky(np.linalg.inv(model.noise().covariance())).T
            A, r = R @ np.hstack(list(J)), R @ r
            weight = max(model.robust().weight(float(np.sqrt(r @ r))), IGNORED)
        else:
            A, b = f.linearize(values).jacobian()
            r = -b
        full = np.zeros((len(r), sum(dims[k] for k in keys)))
        c = 0
        for k in list(f.keys()):
            full[:, at[k] : at[k] + dims[k]] += A[:, c : c + dims[k]]
            c += dims[k]
        out.append((full, r, weight))
    return out


def solve(parts, skip=None):
    """Step, covariance (pseudo-inverse) and a basis of what is not determined; columns scaled."""
    A = np.vstack([np.sqrt(w) * A for i, (A, _, w) in enumerate(parts) if i != skip])
    r = np.concatenate([np.sqrt(w) * r for i, (_, r, w) in enumerate(parts) if i != skip])
    norm = np.sqrt((np.vstack([np.sqrt(w) * A for A, _, w in parts]) ** 2).sum(0))
    norm[norm == 0.0] = 1.0
    U, s, Vt = np.linalg.svd(A / norm, full_matrices=True)
    k = int((s > RANK * s[0]).sum())
    W = Vt[:k].T / s[:k]
    x = -(W @ (U[:, :k].T @ r)) / norm
    return x, (W @ W.T) / norm[:, None] / norm, Vt[k:].T / norm[:, None], k


def deleted(parts, i):
    """T and degrees of freedom of factor i, predicted from the others."""
    A, r, _ = parts[i]
    x, C, N, _ = solve(parts, i)
    U, s, _ = np.linalg.svd(A @ N) if N.shape[1] else (np.eye(len(r)), np.zeros(0), None)
    lost = int((s > 1e-6 * max(1.0, np.abs(A).max())).sum())
    U = U[:, lost:]
    e = U.T @ (r + A @ x)
    S = U.T @ (np.eye(len(r)) + A @ C @ A.T) @ U
    return float(e @ np.linalg.solve(S, e)) if len(e) else 0.0, len(e)
