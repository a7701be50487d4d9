"""EKF-SLAM: landmarks behind pose and systematic errors, with full cross-covariance, removable and parkable.

Landmarks that several observations determine together are initialized late, from poses that are kept in the state. With
whitened residuals r = Hx dx + Hl dl + v of all observations at the place found, an orthogonal Q splits them: the
two rows of Q' Hl that are not zero give the landmark and its correlations, the others measure the poses alone and
update them (Mourikis and Roumeliotis, ICRA 2007, section III-D, projects likewise). So no observation is used twice,
and none is lost.
"""

import math
from collections.abc import Sequence

import numpy as np

from association.expectation import Expectation
from data.blocks import block_diagonal, coordinates, coordinates_from
from data.inputs import FrameObservations, IntArray, Prior, Systematic
from data.result import NEW, Finished, MapState, Updated
from data.se2 import Array, BoolArray, wrap_angle
from data.sensors import LINE, EachSensor, Sensor
from ekf import kernels, systematic
from ekf.filter import DEFAULT, Filter, FilterDivergedError, FilterOptions
from ekf.parking import LONGEST, Parked, symmetric
from ekf.pose_updates import correct_all

MARGIN = 1.0 + 1e-6  # factor on squared distances, so that rounding excludes no landmark
JOINED = 1e-4  # m, of a wall also rad; standard deviation of the difference of two merged landmarks


class EkfSlam(Filter):
    """Extended Kalman filter over the pose and all landmarks (Probabilistic Robotics, section 10.2).

    The buffers hold pose, systematic errors, active landmarks, y and recent landmarks (`ekf.parking`), in this order. A
    landmark number is the order of creation and is never reused; landmark `self._number[i]` is at offset base + 2 i.
    Numbers ascend with the slots. Parked landmarks have no slot and no cost until they are restored.
    """

    def __init__(
        self, prior: Prior, sensor: Sensor, options: FilterOptions = DEFAULT, *, systematic: Systematic | None = None
    ) -> None:
        """Start at the prior with an empty map; `systematic`: errors to estimate."""
        super().__init__(prior, sensor, options, systematic, landmarks=16)
        self._number = np.empty(0, np.int64)
        self._offset: dict[int, int] = {}
        self._parked = Parked()
        self.created = 0

    def _select(self, index: IntArray) -> None:
        """Keep the buffer entries `index`, in that order."""
        d = len(index)
        self._mean[:d] = self._mean[index]
        self._P[:d, :d] = self._P[np.ix_(index, index)]
        if len(self._first):
            self._first[:d] = self._first[index]

    def _renumber(self, number: IntArray) -> None:
        self._number = number
        self._offset = {int(n): self.base + 2 * i for i, n in enumerate(number)}

    @property
    def _recent(self) -> int:
        """Offset of the landmarks parked since the epoch began."""
        return self.size + self._parked.k

    @property
    def active(self) -> IntArray:
        """Numbers (a,) of the active landmarks, ascending."""
        return self._number

    @property
    def parked(self) -> IntArray:
        """Numbers (b,) of the parked landmarks, ascending."""
        return self._parked.numbers

    @property
    def carried(self) -> int:
        """Number of states carried besides the active ones."""
        return self._carried

    def parked_xy(self) -> Array:
        """Present means (b, 2) of the parked landmarks, ordered as `parked`."""
        p, d, r = self._parked, self.size, self._recent
        number = np.concatenate([np.flatnonzero(p.based), p.recent])
        xy = np.concatenate([p.xy(self._mean[d:r]), self._mean[r : self._used][: 2 * len(p.recent)].reshape(-1, 2)])
        return self._frame.points_out(xy[np.argsort(number)], self._mean[3 : self.base])[0]

    def parked_within(self, observations: FrameObservations, within: float) -> IntArray:
        """Parked landmarks (r,) that may be within a squared Mahalanobis distance of some observation."""
        if not len(observations.z) or not np.isfinite(within):
            return self.parked if len(observations.z) else np.empty(0, np.int64)
        p, d, r = self._parked, self.size, self._recent
        here = r + np.arange(2 * len(p.recent)).reshape(-1, 2)
        xy = np.concatenate([p.xy(self._mean[d:r]), self._mean[here]])
        # that of the epoch's begin, which can only have become smaller
        own = np.concatenate([p.own[p.based], self._P[here[:, :, None], here[:, None, :]]])
        based = (p.D @ self._P[d:r, :3]).reshape(-1, 2, 3)[p.based]
        z_hat, Hx, Hl = self.sensor.linearize(self._mean[:3], xy)
        mixed = Hx @ (Hl @ np.concatenate([based, self._P[here, :3]])).transpose(0, 2, 1)
        HPHt = Hx @ self._P[:3, :3] @ Hx.transpose(0, 2, 1) + mixed + mixed.transpose(0, 2, 1)
        HPHt += Hl @ own @ Hl.transpose(0, 2, 1)
        z, R, side = observations.z[:, None], observations.R[:, None], np.ones(1)
        if self.sensor.kind == LINE:  # the noise of a wall's observation has the sign of its own normal
            side = np.where(np.cos(z[..., 1] - z_hat[:, 1]) < 0.0, -1.0, 1.0)
        x, y = np.moveaxis(self.sensor.residual(z, z_hat), -1, 0)
        a, b, c = (HPHt[:, i, j] + sign * R[..., i, j] for i, j, sign in ((0, 0, 1.0), (0, 1, side), (1, 1, 1.0)))
        near: BoolArray = c * x * x - 2.0 * b * x * y + a * y * y <= within * MARGIN * (a * c - b * b)
        return np.concatenate([np.flatnonzero(p.based), p.recent])[near.any(axis=0)]

    def park(self, numbers: IntArray) -> None:
        """Move active landmarks out of the state without loss; `restore` is the inverse.

        Raises ValueError for a landmark that is parked already or not in the map, in the invariant filter, which moves
        every landmark, with first estimates, which a parked landmark would lose, and beside kept poses (`keep`).
        """
        if self.options.invariant:
            raise ValueError("the invariant filter moves all landmarks together; none can be parked")
        if self.options.first_estimates:
            raise ValueError("a parked landmark would lose its first estimate; none can be parked")
        if self._clones.expected:
            raise ValueError("poses of earlier frames are kept for closures; no landmark can be parked beside them")
        away = np.unique(np.asarray(numbers, np.int64))
        for n in away.tolist():
            if n not in self._offset:
                why = "it is parked already" if self._parked.holds(n) else "no landmark has this number"
                raise ValueError(f"cannot park landmark {n}: {why}")
        if not len(away):
            return
        self._version += 1
        out = np.isin(self._number, away)
        moved = self.base + coordinates(np.flatnonzero(out))
        self._select(np.concatenate([np.delete(np.arange(self._used), moved), moved]))
        self.size -= len(moved)
        self._carried += len(moved)
        self._parked.recent = np.concatenate([self._parked.recent, away])
        self._renumber(self._number[~out])
        self._begin_epoch_if_due()

    def restore(self, numbers: IntArray) -> None:
        """Return parked landmarks to the state. Raises ValueError for a landmark that is not parked."""
        back = np.unique(np.asarray(numbers, np.int64))
        for n in back.tolist():
            if not self._parked.holds(n):
                raise ValueError(f"cannot restore landmark {n}: it is not parked")
        if not len(back):
            return
        self._version += 1
        parked, d, r, e = self._parked, self.size, self._recent, self._used
        again = np.isin(parked.recent, back)
        place = r + coordinates(np.arange(len(again))).reshape(-1, 2)
        number = np.concatenate([self._number, parked.recent[again]])
        slots = [np.arange(self.base, d).reshape(-1, 2), place[again]]
        grown = np.empty(0, np.int64)
        old = back[~np.isin(back, parked.recent)]
        if len(old):
            n = 2 * len(old)
            self._grow(2 * len(old))
            x, P = self._mean, self._P
            mean, D_p, own, small = parked.restoring(old, x[d:r], P[d:r, d:r])
            cross = D_p @ P[d:r, :e]  # append the present landmarks and the new end of y
            cross[:, d:r] += D_p
            x[e : e + n], x[e + n : e + 2 * n] = mean, 0.0
            P[e : e + n, :e], P[:e, e : e + n], P[e : e + n, e : e + n] = cross, cross.T, own
            P[e + n : e + 2 * n, : e + 2 * n], P[: e + 2 * n, e + n : e + 2 * n] = 0.0, 0.0
            P[e : e + n, e + n : e + 2 * n], P[e + n : e + 2 * n, e : e + n] = small, small.T
            number = np.concatenate([number, old])
            slots.append(np.arange(e, e + n).reshape(-1, 2))
            grown = np.arange(e + n, e + 2 * n)
        parked.recent = parked.recent[~again]
        order = np.argsort(number)
        rows = np.concatenate(slots)[order].ravel()
        self._select(np.concatenate([np.arange(self.base), rows, np.arange(d, r), grown, place[~again].ravel()]))
        self.size = self.base + len(rows)
        self._carried += len(grown) - 2 * int(again.sum())
        self._renumber(number[order])
        self._begin_epoch_if_due()

    def _marginalize_parked(self, removed: IntArray) -> None:
        parked = self._parked
        out = np.isin(parked.recent, removed)
        if out.any():
            place = self._recent + coordinates(np.flatnonzero(out))
            self._select(np.delete(np.arange(self._used), place))
            self._carried -= len(place)
            parked.recent = parked.recent[~out]
        parked.leave(removed[~np.isin(removed, parked.recent) & np.isin(removed, np.flatnonzero(parked.based))])
        self._begin_epoch_if_due()

    def _begin_epoch_if_due(self) -> None:
        """Update all parked landmarks if the carried part has grown too long, which makes it as short as possible."""
        parked, d, r, e = self._parked, self.size, self._recent, self._used
        if self._carried <= min(LONGEST * d, 2 * parked.count):
            return
        x, P = self._mean, self._P
        self._version += 1
        parked.update(self.created, x[d:r], P[d:r, d:r], (x[r:e], P[r:e, d:r], P[r:e, r:e]))
        at = coordinates(parked.recent)
        C = np.zeros((len(parked.mean), d))
        if parked.k:
            np.matmul(parked.D, P[d:r, :d], out=C)
        C[at] = P[r:e, :d]
        short = 2 * parked.count <= d
        self._carried = 2 * parked.count if short else d
        self._grow(0)
        x, P = self._mean, self._P
        e = self._used
        if short:
            all_of_them = coordinates(parked.numbers)
            x[d:e], P[d:e, d:e] = parked.empty()
            P[d:e, :d] = C[all_of_them]
            P[:d, d:e] = P[d:e, :d].T
        else:
            L = parked.begin(C, P[:d, :d])
            x[d:e], P[d:e, d:e] = 0.0, 0.0
            P[:d, d:e], P[d:e, :d] = L, L.T
        if len(x) > 4 * e:  # far too large once most of a map is parked
            self._mean, self._P = x[: 2 * e].copy(), P[: 2 * e, : 2 * e].copy()

    def _at(self, numbers: IntArray) -> IntArray:
        """Offsets of the coordinates of active landmarks (n,) in the state (2n,)."""
        return coordinates_from(np.array([self._offset[n] for n in numbers.tolist()], np.int64))

    def expect(self, observations: FrameObservations) -> Expectation:
        """Expectation of every active landmark, valid until the next `predict` or `update`."""
        at = self.base + 2 * np.arange(len(self._number), dtype=np.int64)
        return self._expect(observations, self._number, at, np.zeros((len(self._number), 2)))

    def update(
        self, observations: FrameObservations, decisions: IntArray, *, threshold: float = np.inf,
        at: Array | None = None, innovations: bool = True,
    ) -> Updated:  # fmt: skip
        """One update with all pairings below `threshold`, then new landmarks in order, from the updated pose.

        Linearized first at the prediction, or at a pose `at` (3,). A filter always forms its innovations. Raises
        ValueError for a decision that names a landmark that is not in the map, or parked.
        """
        decisions = np.array(decisions, np.int64)
        listed = decisions.tolist()
        try:
            offset = np.array([self._offset[n] if n >= 0 else -1 for n in listed], np.int64)
        except KeyError as unknown:
            if self._parked.holds(unknown.args[0]):
                raise ValueError(f"landmark {unknown} is parked: restore it first") from None
            raise ValueError(f"no landmark has number {unknown}") from None
        updated = self._updated(observations, decisions, offset, np.zeros((len(offset), 2)), threshold, at)
        if NEW not in listed:
            return updated
        fresh = np.flatnonzero(decisions == NEW)
        self._grow(len(fresh))
        end = self._used
        for z, R in zip(observations.z[fresh], observations.R[fresh], strict=True):
            variance = self.options.augment_variance(float(self.sensor.polar(z[None])[0, 0]))
            kernels.augment(self._kind, self._extrinsic, self._mean, self._P, end, z, R, variance, self._first)
            end += 2
        if self._carried and len(fresh):
            self._before_carried(self.size, self._used, end)
        for i in fresh:
            self._offset[self.created] = self.size
            updated.created[i] = self.created
            self._number = np.append(self._number, self.created)
            self.created += 1
            self.size += 2
        return updated

    def hold(self, frame: int) -> None:
        """Keep the present frame's pose for `initialize`, until `release`; no landmark can be parked meanwhile."""
        self._clones.hold(frame)

    def release(self, frame: int) -> None:
        """Keep a frame's pose no longer for `initialize`."""
        self._clones.release(frame)

    def _at_poses(self, frames: IntArray) -> IntArray:
        """Offsets (3n,) of the poses of frames (n,), kept or the present one."""
        places = [0 if k == self._clones.now else self.size + 3 * self._clones.frames.index(k) for k in frames.tolist()]
        return np.asarray((np.array(places, np.int64)[:, None] + np.arange(3)).ravel())

    def held(self, frames: IntArray) -> tuple[Array, Array]:
        """Poses (n, 3) of frames, kept or the present one, and their joint covariance (3n, 3n), in the world."""
        at = self._at_poses(frames)
        return self._mean[at].reshape(-1, 3), self._P[np.ix_(at, at)]

    def initialize(
        self, frames: IntArray, sensors: Sequence[Sensor], observations: FrameObservations, xy: Array
    ) -> tuple[int, float, int, float]:
        """A new landmark near xy (2,), from all its observations (m) by sensors (m), from frames (m,), kept or present.
        Returns its number, and NIS, degrees of freedom and log-likelihood of what updated the poses.
        """
        self._version += 1
        self._grow(1)
        at, d, n = self._at_poses(frames), self._used, len(frames)
        each, points = EachSensor(tuple(sensors), np.arange(n)), np.repeat(xy[None], n, axis=0)
        z_hat, Hx, Hl = each.linearize(self._mean[at].reshape(-1, 3), points)
        if len(self._first):
            Hx, Hl = each.jacobians(self._first[at].reshape(-1, 3), points)
            self._first[d : d + 2] = xy
        root = np.linalg.cholesky(observations.R)
        nu = each.residual(observations.z, z_hat)[:, :, None]
        nu, Hx, Hl = (np.linalg.solve(root, part) for part in (nu, Hx, Hl))
        Q, triangle = np.linalg.qr(Hl.reshape(-1, 2), mode="complete")
        nu, H = Q.T @ nu.ravel(), Q.T @ block_diagonal(Hx)
        mean, P, back = self._mean, self._P, np.linalg.inv(triangle[:2])
        A = -back @ H[:2]
        mean[d : d + 2] = xy + back @ nu[:2]
        P[d : d + 2, :d] = A @ P[at, :d]
        P[:d, d : d + 2] = P[d : d + 2, :d].T
        P[d : d + 2, d : d + 2] = A @ P[np.ix_(at, at)] @ A.T + back @ back.T
        H, rest, rows = H[2:], nu[2:], P[at, : d + 2]
        S = H @ rows[:, at] @ H.T + np.eye(len(rest))
        try:
            L = np.linalg.cholesky(0.5 * (S + S.T))
        except np.linalg.LinAlgError:
            raise FilterDivergedError(kernels.FAILURES[kernels.NOT_PSD]) from None
        white = np.asarray(np.linalg.solve(L, rest), np.float64)
        V = np.ascontiguousarray(np.linalg.solve(L, H @ rows))
        status = correct_all(mean, P, d + 2, V, white, self._rule[0], self.size, self.size + self.kept)
        if status != kernels.OK:
            raise FilterDivergedError(kernels.FAILURES[status])
        nis, dof = float(white @ white), sum(len(s.measures) for s in sensors) - 2
        log_det = 2.0 * float(np.log(np.diag(L)).sum())
        self._before_carried(self.size, d, d + 2)
        self._number = np.append(self._number, self.created)
        self._offset[self.created] = self.size
        self.created += 1
        self.size += 2
        return self.created - 1, nis, dof, -0.5 * (nis + log_det + dof * math.log(2.0 * math.pi))

    def remove(self, numbers: IntArray) -> None:
        """Marginalize landmarks out, active or parked."""
        removed, parked = np.isin(self._number, numbers), np.isin(self.parked, numbers)
        if removed.sum() + parked.sum() != len(set(np.asarray(numbers).tolist())):
            raise ValueError(f"cannot remove {np.asarray(numbers).tolist()}: not all are in the map")
        self._version += 1
        kept = np.concatenate([np.ones(self.base, np.bool_), np.repeat(~removed, 2), np.ones(self._carried, np.bool_)])
        self._select(np.flatnonzero(kept))
        self.size -= 2 * int(removed.sum())
        self._renumber(self._number[~removed])
        if parked.any():
            self._marginalize_parked(self.parked[parked])

    @property
    def xy(self) -> Array:
        """Means (a, 2) of the active landmarks, in the frame of the state (copies)."""
        return self._mean[self.base : self.size].reshape(-1, 2).copy()

    def position(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (2n,) and joint covariance (2n, 2n) of active landmarks, in the frame of the state."""
        at = self._at(numbers)
        return self._mean[at], self._P[np.ix_(at, at)]

    def places(self, numbers: IntArray) -> tuple[Array, Array]:
        """Means (n, 2) of active landmarks, and the variance of x plus that of y (n,)."""
        at = self._at(numbers).reshape(-1, 2)
        return self._mean[at], self._P[at, at].sum(axis=1)

    def merge(self, merged: IntArray, kept: IntArray) -> None:
        """Merge active landmarks `merged` (k,) into `kept` (k,) by the measurement that their difference is zero."""
        self._version += 1
        e, a, b = self._used, self._at(merged), self._at(kept)
        P, mean = self._P[:e, :e], self._mean[:e]
        difference, opposite = self.sensor.difference(mean[a].reshape(-1, 2), mean[b].reshape(-1, 2))
        apart, sign = difference.ravel(), np.ones(len(a))
        sign[0::2] = np.where(opposite, -1.0, 1.0)
        PHt = sign * P[:, a] - P[:, b]
        S = sign[:, None] * PHt[a] - PHt[b] + JOINED**2 * np.eye(len(a))
        gain = np.linalg.solve(S, PHt.T).T
        mean -= gain @ apart
        mean[2] = wrap_angle(float(mean[2]))
        P -= gain @ PHt.T  # Joseph's form, so that the small variance of the difference is not rounding
        PHt = sign * P[:, a] - P[:, b]
        P -= PHt @ gain.T
        P += JOINED**2 * gain @ gain.T
        P[:] = symmetric(P)
        self.remove(merged)

    def landmarks(self) -> MapState:
        """The present map, active and parked landmarks."""
        d, r, b = self.size, self._recent, slice(3, self.base)
        based, xy, blocks, D = self._parked.now(self._mean[d:r], self._P[d:r, d:r])
        here = np.concatenate([np.arange(self.base, d), r + np.arange(2 * len(self._parked.recent))]).reshape(-1, 2)
        number = np.concatenate([self._number, self._parked.recent, based])
        xy = np.concatenate([self._mean[here], xy])
        blocks = np.concatenate([self._P[here[:, :, None], here[:, None, :]], blocks])
        cross = np.concatenate([self._P[here, b], D @ self._P[d:r, b]])
        order = np.argsort(number)
        found = MapState(number[order], xy[order], blocks[order])
        return systematic.landmarks(found, cross[order], self._mean[b], self._P[b, b], self._frame)

    def finish(self) -> Finished:
        """The last map; a filter does not revise its path."""
        return Finished(None, self.landmarks())
