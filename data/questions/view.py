"""Questions about what is seen: readings beyond the stated reach, a prior from which the map is not seen."""

from __future__ import annotations

import numpy as np

from data.inputs import Inputs
from data.log import Log
from data.motion.velocity import carried
from data.questions.question import Question
from data.se2 import BoolArray, compose, wrap_angle
from data.sensors import RELATIVE_POINT

BEYOND = 0.01
"""Share of readings past the stated field of view by more than `MARGIN`; noise at its edge gives 3e-5."""
MARGIN = 4.0
"""Standard deviations of a reading."""
FIRST = 50
"""Readings at the start of a log that are looked at: before the odometry has gone astray."""
FEWEST = 5
"""Fewer readings say nothing."""
GATE = 18.42
"""chi-square of 2 at 0.9999."""
EXPLAINED = 0.2
"""Share of the first readings that a prior in the map's frame explains at least; measured: see the tests."""
SLACK, SLACK_HEADING = 1.0, 0.2
"""m, rad: how far prior and first true pose may differ besides five standard deviations of the prior."""


def reach(log: Log) -> list[Question]:
    """Readings past the sensor's stated range or angles."""
    inputs = log.recorded
    sensor, o = inputs.sensor, inputs.observations
    if len(o.z) < FEWEST:
        return []
    polar = sensor.polar(o.z)
    sigma = np.sqrt(np.trace(o.R, axis1=1, axis2=2)) if sensor.kind == RELATIVE_POINT else np.sqrt(o.R[:, 0, 0])
    found = []
    past = polar[:, 0] > sensor.max_range + MARGIN * sigma
    if past.mean() > BEYOND:
        found.append(
            Question(
                "max_range",
                f"{int(past.sum())} of {len(past)} readings are farther than the stated max_range of "
                f"{sensor.max_range:.4g} m, up to {polar[:, 0].max():.4g} m: state the sensor's reach in log.toml, "
                "because what lies beyond it counts as out of view",
            )
        )
    middle, half = 0.5 * (sensor.min_angle + sensor.max_angle), 0.5 * (sensor.max_angle - sensor.min_angle)
    cartesian = sensor.kind == RELATIVE_POINT
    sigma = sigma / np.maximum(polar[:, 0], 1e-6) if cartesian else np.sqrt(o.R[:, 1, 1])
    aside = np.abs(wrap_angle(polar[:, 1] - middle)) > half + MARGIN * sigma
    if aside.mean() > BEYOND:
        low, high = np.degrees([sensor.min_angle, sensor.max_angle])
        found.append(
            Question(
                "field of view",
                f"{int(aside.sum())} of {len(aside)} readings lie outside the stated {low:.4g} to {high:.4g} deg: "
                "state min_angle and max_angle in log.toml as the sensor sees, counter-clockwise from its x axis",
            )
        )
    return found


def prior(log: Log) -> list[Question]:
    """A prior from which the first readings hit no landmark of the map."""
    inputs = log.recorded
    if inputs.map is None or len(inputs.map.id) == 0:
        return []
    hit = explained(inputs)
    if len(hit) < FEWEST or hit.mean() >= EXPLAINED:
        return []
    x, y, theta = inputs.prior.mean
    (x0, y0), (x1, y1) = inputs.map.xy.min(axis=0), inputs.map.xy.max(axis=0)
    there = f"x {x0:.4g} to {x1:.4g} m, y {y0:.4g} to {y1:.4g} m"
    if not inputs.sensor.sees_points:
        there = f"walls, rho {x0:.4g} to {x1:.4g} m"
    text = (
        f"from the prior ({x:.4g}, {y:.4g}) m, {np.degrees(theta):.4g} deg, {int(hit.sum())} of the first {len(hit)} "
        f"readings fit a landmark of the map ({there})"
    )
    if log.truth.pose is not None and np.isfinite(log.truth.pose[0]).all():
        tx, ty, heading = log.truth.pose[0]
        text += f"; the truth starts at ({tx:.4g}, {ty:.4g}) m, {np.degrees(heading):.4g} deg"
    return [
        Question("prior", f"{text}: state [prior] mean in the map's frame, or the map in the prior's (--map-transform)")
    ]


def explained(inputs: Inputs) -> BoolArray:
    """Whether each of the first readings (m,) lies in some landmark's gate, from the prior by dead reckoning; bool."""
    assert inputs.map is not None
    hits: list[bool] = []
    pose, P = np.array(inputs.prior.mean), np.array(inputs.prior.covariance)
    for k in range(len(inputs)):
        if k:
            step = inputs.increment(k)
            _, _, F, B = carried(pose[2], step.mean)
            P = F @ P @ F.T + B @ step.covariance @ B.T
            pose = compose(pose, step.mean)
        seen = inputs.sightings(k)
        if len(seen.z) == 0:
            continue
        z_hat, Hx, _ = inputs.sensor.linearize(pose, inputs.map.xy)
        S = (Hx @ P @ Hx.transpose(0, 2, 1))[None] + seen.R[:, None]
        nu = inputs.sensor.residual(seen.z[:, None], z_hat[None])
        d2 = np.einsum("mli,mli->ml", nu, np.linalg.solve(S, nu[..., None])[..., 0])
        hits += (d2.min(axis=1) < GATE).tolist()
        if len(hits) >= FIRST:
            break
    return np.array(hits[:FIRST], bool)


def truth_start(log: Log) -> list[Question]:
    """A first true pose that the prior excludes: truth in a frame of its own, so that every error is the shift."""
    pose, inputs = log.truth.pose, log.recorded
    if pose is None or not np.isfinite(pose[0]).all():
        return []
    away = pose[0] - inputs.prior.mean
    sigma = np.sqrt(np.diag(inputs.prior.covariance))
    distance, turned = float(np.hypot(*away[:2])), abs(float(wrap_angle(away[2])))
    if distance <= SLACK + 5.0 * sigma[:2].max() and turned <= SLACK_HEADING + 5.0 * sigma[2]:
        return []
    return [
        Question(
            "truth frame",
            f"the truth starts {distance:.4g} m and {np.degrees(turned):.4g} deg from the prior, whose sigmas are "
            f"{sigma[0]:.3g} m, {sigma[1]:.3g} m, {np.degrees(sigma[2]):.3g} deg: bring both into one frame (the "
            "prior, or `data.convert table --truth-transform`), or read aligned errors only",
        )
    ]


def labels_against_map(log: Log) -> list[Question]:
    """Labels and a map whose numbers have nothing to do with each other."""
    label, known = log.granted, log.recorded.map
    if label is None or known is None or not (label >= 0).any():
        return []
    named = label[label >= 0]
    strange = ~np.isin(named, known.id)
    if strange.mean() <= 0.5:
        return []
    return [
        Question(
            "label names",
            f"{int(strange.sum())} of {len(named)} labelled readings name a landmark that is not in the map (labels "
            f"{named.min()} to {named.max()}, map {known.id.min()} to {known.id.max()}): use the same ids in both",
        )
    ]
