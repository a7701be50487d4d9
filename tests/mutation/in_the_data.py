"""Faults in what a log is made of: odometry, time, calibration, identities, the simulators' own statements."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from data import se2
from data.formats import mrclam
from data.formats.mrclam import Calibration, Grid
from data.inputs import CLUTTER, Prior
from data.motion.velocity import VelocityModel, VelocityNoise, preintegrate
from data.timeline import truth_at
from data.truth_windows import misplaced
from data.worlds.corridor import Corridor
from data.worlds.corridor import simulate as simulate_corridor
from eval.referee import consistency
from tests.data.formats.mrclam import world as recording
from tests.mutation.faults import Check, Fault, changed, replaced
from tests.mutation.verdicts import FRESH_NEES

LATENCY = 0.04
MEASURED = "Robot1_Measurement.dat"


# a recording in the published form, without noise (see `tests.data.formats.mrclam.world`), whose camera is late


def files():
    """Stamps of the readings are late by `LATENCY`."""
    texts = recording.texts()
    rows = [line.split(None, 1) for line in texts[MEASURED].splitlines() if not line.startswith("#")]
    late = [f"{float(stamp) + LATENCY:.3f} \t {rest}" for stamp, rest in rows]
    texts[MEASURED] = "\n".join(late) + "\n"
    return texts


def load(**arguments):
    with tempfile.TemporaryDirectory() as folder:
        source = recording.save_folder(Path(folder) / "set", files())
        return mrclam.load_mrclam(source, 1, mrclam.Treatment(calibration=Calibration(latency=LATENCY), **arguments))


def readings_fit_the_truth():
    """Every reading is what the sensor predicts from the true pose of its frame and the landmark of its barcode."""
    log = load()
    o, known, ids = log.recorded.observations, log.recorded.map, log.truth.landmark_of
    wanted = [row[1] for row in recording.measurement_rows() if row[1] in recording.LANDMARKS]
    assert ids.tolist() == wanted, f"{len(ids)} readings arrive, {len(wanted)} were recorded, or under other numbers"
    predicted = log.recorded.sensor.predict(log.truth.pose[o.frame], known.xy[np.searchsorted(known.id, ids)])
    worst = np.abs(log.recorded.sensor.residual(o.z, predicted)).max()
    assert worst < 1e-3, f"a reading is {worst:.2g} (m or rad) off"


def survey_fits_the_readings():
    wrong = misplaced(load())
    assert not wrong, f"landmark {wrong[0].id} is seen {wrong[0].distance:.1f} m away"


def robots_are_clutter():
    log = load(keep_robots=True)
    robots = [row for row in recording.measurement_rows() if row[1] not in recording.LANDMARKS]
    clutter = int((log.truth.landmark_of == CLUTTER).sum())
    assert clutter == len(robots), f"{clutter} of {len(robots)} sightings of a robot are clutter"


def bad_truth_is_left_out():
    log = load(exclude_truth=[(3.0, 5.0)])
    bad = np.isnan(log.truth.pose[:, 0])
    assert bad.any(), "it is known"


READINGS_FIT = Check("a noise-free reading is what the sensor predicts", readings_fit_the_truth)
SURVEY_FITS = Check("the readings agree with the landmark file", survey_fits_the_readings)
ROBOTS = Check("observations of other robots are clutter", robots_are_clutter)
BAD_TRUTH = Check("truth that is marked bad is unknown", bad_truth_is_left_out)


def truth_of_the_frame_before(real):
    def truth_at_the_frame_before(time, pose, at):
        found = real(time, pose, at)
        return np.concatenate([found[:1], found[:-1]])

    return truth_at_the_frame_before


def on_a_grid(real):
    """Frames 0.03 s apart, whatever was asked for."""

    def lay_out(readings, odometry, first, last, grid, motion):
        return real(readings, odometry, first, last, Grid(0.03), motion)

    return lay_out


def barcodes_for_subjects(real):
    return lambda files: {barcode: barcode for barcode in real(files)}


def two_landmarks_exchanged(real):
    def read_landmarks(files, path=None):
        survey = real(files, path)
        xy, rows = survey.xy.copy(), np.searchsorted(survey.id, [7, 20])
        xy[rows] = xy[rows[::-1]]
        return replace(survey, xy=xy)

    return read_landmarks


def bad_stretches_forgotten(monkeypatch):
    monkeypatch.setattr(mrclam, "_true_at", lambda truth, _, instants: truth_at(truth[:, 0], truth[:, 1:], instants))


# odometry


def across_a_gap():
    """A robot keeps driving while 3 s of odometry are missing: the increment over the gap must own up to that."""
    t = np.concatenate([np.arange(0.0, 2.0, 0.1), np.arange(5.0, 7.0, 0.1)])
    model = VelocityModel(VelocityNoise("density", (0.02, 0.02)))
    increments, gaps = preintegrate(model, t, np.full(len(t), 0.5), np.full(len(t), 0.1), np.array([0.0, 1.9, 5.0]))
    every = np.arange(0.0, 7.0, 0.1)
    true = preintegrate(model, every, np.full(70, 0.5), np.full(70, 0.1), np.array([0.0, 1.9, 5.0]))[0].mean
    assert gaps == 1, f"{gaps} gaps counted"
    distance = consistency.squared_distance(true[2:] - increments.mean[2:], increments.covariance[2:])[0]
    assert distance < 11.3, f"squared distance {distance:.3g}, 11.3 allowed"


def however_it_is_cut():
    model = VelocityModel(VelocityNoise("velocity", (0.1, 0.05)))
    t, v, omega = np.array([0.0, 1.0]), np.array([0.8, 0.8]), np.array([0.0, 0.0])
    whole, cut = (preintegrate(model, t, v, omega, at)[0] for at in (np.array([0.0, 1.0]), np.linspace(0.0, 1.0, 5)))
    ratio = cut.covariance[:, 0, 0].sum() / whole.covariance[1, 0, 0]
    assert abs(ratio - 1.0) < 1e-9, f"{ratio:.3g} times the variance, cut in four"


GAP = Check("the true motion over a gap lies in its ellipse", across_a_gap)
CUT = Check("cutting a sample leaves the total variance", however_it_is_cut)
PREINTEGRATE = "data.motion.velocity._preintegrate"
NO_GROWTH = {"fastest[0] ** 2 * gap * dt": "1e-10", "fastest[1] ** 2 * gap * dt": "1e-10"}
SQUARED_PIECES = {"rate[k, 0] * dt, rate[k, 1] * dt": "rate[k, 0] / hold[k] * dt**2, rate[k, 1] / hold[k] * dt**2"}


# angles, the simulators


def truth_across_the_cut():
    pose = np.array([[0.0, 0.0, np.radians(179.0)], [1.0, 0.0, np.radians(-179.0)]])
    between = truth_at(np.array([0.0, 1.0]), pose, np.array([0.5]))[0, 2]
    off = abs(np.degrees(se2.wrap_angle(between - np.pi)))
    assert off < 1e-6, f"{off:.0f} degrees off half-way between 179 and -179"


def noise_from_the_reading():
    o = simulate_corridor(Corridor(frames=20), 0).recorded.observations
    c, r = Corridor(), np.hypot(*o.z.T)
    along, across = o.z / r[:, None], np.stack([-o.z[:, 1], o.z[:, 0]], 1) / r[:, None]
    R = (c.srho * r)[:, None, None] ** 2 * along[:, :, None] * along[:, None, :]
    R += (c.sphi * r)[:, None, None] ** 2 * across[:, :, None] * across[:, None, :]
    off = np.abs(R - o.R).max() / o.R.max()
    assert off < 1e-9, f"it differs by {off:.2g}"


ACROSS = Check("truth is interpolated the shorter way", truth_across_the_cut)
FROM_THE_READING = Check("R in the corridor follows from the reading", noise_from_the_reading)
FROM_THE_TRUTH = {
    "corridor.srho * r[:, None]": "corridor.srho * polar[:, :1]",
    "corridor.sphi * r[:, None]": "corridor.sphi * polar[:, :1]",
}

FAULTS = (
    Fault(1, "headings averaged across the cut", ACROSS,
          changed("data.se2.interpolate", {"np.unwrap(poses[:, 2])": "poses[:, 2]"})),
    Fault(8, "true pose of the frame before", READINGS_FIT,
          replaced("data.formats.mrclam.truth_at", truth_of_the_frame_before)),
    Fault(14, "prior covariance filled with one constant", FRESH_NEES,
          replaced("data.worlds.parameters.Prior", lambda real: lambda mean, P: Prior(mean, np.full((3, 3), P[0, 0]))),
          match="overconfident"),
    Fault(20, "readings moved to a grid of 0.03 s", READINGS_FIT,
          replaced("data.formats.mrclam.lay_out", on_a_grid)),
    Fault(21, "MRCLAM: barcode taken for the subject", READINGS_FIT,
          replaced("data.formats.mrclam.read_barcodes", barcodes_for_subjects)),
    Fault(21, "MRCLAM: another robot taken for a landmark", ROBOTS,
          changed("data.formats.mrclam.identify", {"np.where(robot, CLUTTER, subject)": "subject"})),
    Fault(21, "MRCLAM: camera lag forgotten", READINGS_FIT,
          changed("data.formats.mrclam.load_mrclam", {"-calibration.latency": "0.0"})),
    Fault(21, "MRCLAM: two landmarks exchanged in the survey", SURVEY_FITS,
          replaced("data.formats.mrclam.read_landmarks", two_landmarks_exchanged),
          match="landmark 7 is seen 3.7 m away"),
    Fault(21, "MRCLAM: bad ground truth not left out", BAD_TRUTH, bad_stretches_forgotten),
    Fault(22, "covariance that does not grow over a gap", GAP, changed(PREINTEGRATE, NO_GROWTH)),
    Fault(24, "(sigma dt)^2 for each piece of a sample", CUT, changed(PREINTEGRATE, SQUARED_PIECES)),
    Fault(25, "corridor: R from the true range", FROM_THE_READING, changed("data.worlds.corridor._observe",
    FROM_THE_TRUTH)),
)  # fmt: skip
