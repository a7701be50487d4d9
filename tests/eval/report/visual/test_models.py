"""The typeset models say what the code computes, and are set cleanly."""

from __future__ import annotations

import re
import shutil
import subprocess
from itertools import combinations

import numpy as np
import pytest

from data import se2
from data.inputs import Increments, Inputs, LandmarkMap, Observations, Prior
from data.motion.velocity import ARC, VelocityModel, VelocityNoise, preintegrate, step
from data.sensors import RelativePoint
from ekf import kernels
from eval.replay.estimators import make_estimator
from eval.report import visual
from eval.report.page.equations import Equation, Matrix, Where, formula_figure, latex

TOKEN = re.compile(r"(?:\\[a-zA-Z]+|[a-zA-Z]'?)(?:[_^](?:\{\w\}|\w|\\[a-z]+))*|\d+|[-+(){}]|\\,|\s+")


def evaluate(text: str, value: dict[str, float]) -> float:
    """A formula of sums, products, fractions, sines and cosines, with the symbols' values."""
    tokens = TOKEN.findall(text)
    assert "".join(tokens) == text
    tokens = [t for t in tokens if t.strip() and t != r"\,"]

    def take(expected: str | None = None) -> str:
        token = tokens.pop(0)
        assert expected is None or token == expected
        return token

    def total() -> float:
        sign = -1.0 if tokens[0] == "-" else 1.0
        if tokens[0] in "+-":
            take()
        result = sign * product()
        while tokens and tokens[0] in ("+", "-"):
            result += product() if take() == "+" else -product()
        return result

    def product() -> float:
        result = factor()
        while tokens and tokens[0] not in ("+", "-", ")", "}"):
            result *= factor()
        return result

    def enclosed(left: str, right: str) -> float:
        take(left)
        result = total()
        take(right)
        return result

    def factor() -> float:
        if tokens[0] == "(":
            return enclosed("(", ")")
        token = take()
        if token == r"\dfrac":
            above = enclosed("{", "}")
            return above / enclosed("{", "}")
        if token in (r"\sin", r"\cos"):
            return float(getattr(np, token[1:])(factor()))
        if token == r"\Delta":
            return value[r"\Delta " + take()]
        return float(token) if token.isdigit() else value[token]

    result = total()
    assert not tokens
    return result


def array(matrix: Matrix, value: dict[str, float]) -> np.ndarray:
    factor = evaluate(matrix.factor, value) if matrix.factor else 1.0
    return factor * np.array([[evaluate(entry, value) for entry in row] for row in matrix.rows])


def central(f, at: np.ndarray, h: float = 1e-6) -> np.ndarray:
    steps = h * np.eye(len(at))
    return np.stack([(f(at + s) - f(at - s)) / (2 * h) for s in steps], axis=-1)


def test_the_evaluator_of_formulas_knows_arithmetic():
    value = {"a": 2.0, "b'": 3.0, "d_x": 5.0, "x^c_j": 7.0, r"\Delta t": 0.5, r"\theta": np.pi / 6}
    assert evaluate(r"-a (b' - d_x) + \dfrac{x^c_j - 1}{a b'}", value) == pytest.approx(5.0)
    assert evaluate(r"a\,\Delta t \sin\theta + 4 \cos(\theta + \theta)", value) == pytest.approx(2.5)


# motion
MOTIONS = [
    ((1.0, -2.0, 0.4), (0.3, 0.5), 0.25),
    ((0.0, 3.0, np.pi - 0.01), (0.8, 1.5), 0.1),
    ((-4.0, 0.2, -2.9), (-0.5, -0.9), 0.5),
    ((2.0, 2.0, 1.6), (0.4, 1e-3), 0.2),
]


def moved(pose: np.ndarray, control: np.ndarray, dt: float) -> np.ndarray:
    """The code's motion; its heading not wrapped, so that it can be differentiated."""
    mean, G = np.zeros(3), np.zeros((3, 2))
    step(ARC, control[0] * dt, control[1] * dt, mean, G)
    after = se2.compose(pose, mean)
    return np.array([*after[:2], pose[2] + mean[2]])


def motion_values(pose, control, dt) -> dict[str, float]:
    value = {"x": pose[0], "y": pose[1], r"\theta": pose[2], "v": control[0], r"\omega": control[1], r"\Delta t": dt}
    arc = dict(visual.ARC_TERMS.terms)
    arc_first = {**dict(visual.COMMAND_TERMS.terms[:2]), **arc, **dict(visual.COMMAND_TERMS.terms[2:])}
    for symbol, meaning in arc_first.items():
        value[symbol] = evaluate(meaning, value)
    return value


@pytest.mark.parametrize(("pose", "control", "dt"), MOTIONS)
def test_the_typeset_motion_model_and_its_jacobians_are_the_codes(pose, control, dt):
    pose, control = np.array(pose), np.array(control)
    value = motion_values(pose, control, dt)
    assert array(visual.NEXT_POSE, value)[:, 0] == pytest.approx(moved(pose, control, dt), abs=1e-12)
    F = central(lambda p: moved(p, control, dt), pose)
    G = central(lambda u: moved(pose, u, dt), control)
    assert array(visual.POSE_JACOBIAN, value) == pytest.approx(F, abs=1e-8)
    assert array(visual.CONTROL_JACOBIAN, value) == pytest.approx(G, abs=1e-8)


@pytest.mark.parametrize(("pose", "control", "dt"), MOTIONS)
def test_the_filter_propagates_the_covariance_that_the_typeset_jacobians_give(pose, control, dt):
    sigma = (0.01, np.radians(4.0))
    value = motion_values(np.array(pose), control, dt)
    F, G = array(visual.POSE_JACOBIAN, value), array(visual.CONTROL_JACOBIAN, value)
    Q = array(visual.CONTROL_NOISE, {r"\sigma_v^2": sigma[0] ** 2, r"\sigma_\omega^2": sigma[1] ** 2})
    P = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
    model = VelocityModel(VelocityNoise("velocity", sigma))
    time = np.array([0.0, dt])
    made, _ = preintegrate(model, time, np.full(2, control[0]), np.full(2, control[1]), time)
    mean, covariance = np.array(pose), P.copy()
    kernels.predict(mean, covariance, 3, made.mean[1], made.covariance[1], kernels.NEWEST)
    assert covariance == pytest.approx(F @ P @ F.T + G @ Q @ G.T, abs=1e-12)


# observation
SIGHTS = [
    ((1.0, -2.0, 0.4), (3.0, 1.0), np.pi / 2, (0.0, 0.0)),
    ((0.0, 3.0, np.pi - 1e-9), (-2.0, 2.5), 2.9, (0.1, -0.2)),
    ((-4.0, 0.2, -2.9), (-4.5, 3.0), -0.3, (-0.05, 0.3)),
]


@pytest.mark.parametrize(("pose", "corner", "turn", "shift"), SIGHTS)
def test_the_typeset_observation_model_and_its_jacobians_are_the_codes(pose, corner, turn, shift):
    pose, corner = np.array(pose), np.array(corner)
    sensor = RelativePoint(rotation=turn, translation=shift)
    value = {
        "x": pose[0], "y": pose[1], r"\theta": pose[2], "l_{x}": corner[0], "l_{y}": corner[1], r"\varphi": turn,
        "T_x": shift[0], "T_z": shift[1],
    }  # fmt: skip
    symbol, meaning = visual.ANGLE
    value[symbol] = evaluate(meaning, value)
    seen = sensor.predict(pose, corner[None])[0]
    assert array(visual.EXPECTED, value)[:, 0] == pytest.approx(seen, abs=1e-12)
    chain = array(visual.ROTATION, value) @ se2.rotation(pose[2]).T @ (corner - pose[:2]) + shift
    assert chain == pytest.approx(seen, abs=1e-12)
    value |= {"x^c_j": seen[0], "z^c_j": seen[1]}
    H, L = array(visual.OBSERVATION_JACOBIAN, value), array(visual.CORNER_JACOBIAN, value)
    assert pytest.approx(central(lambda p: sensor.predict(p, corner[None])[0], pose), abs=1e-8) == H
    assert pytest.approx(central(lambda c: sensor.predict(pose, c[None])[0], corner), abs=1e-8) == L
    Hx, Hl = sensor.jacobians(pose, corner[None])
    assert pytest.approx(Hx[0], abs=1e-12) == H
    assert pytest.approx(Hl[0], abs=1e-12) == L


# typesetting
def test_all_that_is_checked_above_is_what_is_typeset():
    shown = [part for m in visual.MODELS for line in m.lines if isinstance(line, Equation) for part in line.right]
    for matrix in (
        visual.NEXT_POSE, visual.POSE_JACOBIAN, visual.CONTROL_JACOBIAN, visual.CONTROL_NOISE, visual.ROTATION,
        visual.EXPECTED, visual.OBSERVATION_JACOBIAN, visual.CORNER_JACOBIAN,
    ):  # fmt: skip
        assert any(part is matrix for part in shown)
    assert visual.COMMAND_TERMS in visual.MOTION.lines
    assert visual.ARC_TERMS in visual.MOTION.lines
    assert " = ".join(visual.ANGLE) in latex(visual.OBSERVATION.lines)


def test_a_matrix_becomes_a_matrix_aligned_at_the_equals_sign():
    lines = (Equation("A", (Matrix((("1", "x"), ("0", r"\alpha")), "2"),)), Where((("x", "y"),)))
    assert latex(lines) == (
        "\\begin{aligned}\n"
        "A &= 2 \\begin{bmatrix} 1 & x \\\\ 0 & \\alpha \\end{bmatrix} \\\\[1ex]\n"
        "& \\mathrm{where}\\quad x = y\n"
        "\\end{aligned}"
    )


def test_the_update_equations_are_what_the_filter_computes():
    """Equations 10 to 13 by their letters: nu = z - h(x), K = P H' (H P H' + R)^-1, x + K nu, (I - K H) P."""
    corner, R = np.array([3.0, 1.0]), np.diag([0.02, 0.05]) ** 2
    P = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
    sensor = RelativePoint(rotation=0.3, translation=(0.1, -0.2))
    x = np.array([0.2, -0.1, 0.4])
    inputs = Inputs(
        Prior(x, P), np.zeros(1), Increments(np.zeros((1, 3)), np.zeros((1, 3, 3))),
        Observations(np.array([0]), np.array([[1.1, 2.5]]), R[None]), sensor,
        LandmarkMap(np.array([7]), corner[None]),
    )  # fmt: skip
    filtered = make_estimator("ekf", inputs)
    seen = inputs.frame(0).sightings
    filtered.update(seen, np.array([7]))
    H, _ = sensor.jacobians(x, corner[None])
    nu = seen.z[0] - sensor.predict(x, corner[None])[0]
    K = P @ H[0].T @ np.linalg.inv(H[0] @ P @ H[0].T + R)
    mean, covariance = filtered.estimate()
    assert mean == pytest.approx(x + K @ nu)
    assert covariance == pytest.approx((np.eye(3) - K @ H[0]) @ P)
    text = latex(visual.UPDATE.lines)
    assert all(f"({n})" in text for n in (10, 11, 12, 13))


def test_the_latex_of_a_model_is_a_titled_paragraph_of_its_words_and_below_it_its_equations():
    lines = (Equation("a", ("b",)), Equation("c", (r"\omega",)))
    about = "Speed ω for Δt, φ and ψ; θ & 5 % of it."
    first, second = visual.Model("one", "One", about, lines), visual.Model("two", "Two", "Short.", lines[:1])
    assert visual.models_latex((first, second)) == (
        "% \\usepackage{amsmath}\n"
        "\\paragraph{One.} Speed $\\omega$ for $\\Delta$t, $\\varphi$ and $\\psi$; $\\theta$ \\& 5 \\% of it.\n"
        "\\[\n\\begin{aligned}\na &= b \\\\[1ex]\nc &= \\omega\n\\end{aligned}\n\\]\n"
        "\\paragraph{Two.} Short.\n"
        "\\[\n\\begin{aligned}\na &= b\n\\end{aligned}\n\\]\n"
    )


def test_the_latex_holds_every_model_in_order_in_characters_that_latex_sets():
    text = visual.models_latex()
    assert re.findall(r"\\paragraph\{(.*?)\}", text) == ["Motion model.", "Observation model.", "Update."]
    at = [text.index(latex(m.lines)) for m in visual.MODELS]
    assert at == sorted(at)
    assert text.isascii()


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX on this machine")
def test_the_latex_of_the_models_compiles_and_fits_the_page(tmp_path):
    body = visual.models_latex()
    (tmp_path / "m.tex").write_text(
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\begin{document}\n" + body + "\\end{document}\n"
    )
    made = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "m.tex"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout[-2000:]
    assert "Overfull" not in made.stdout


@pytest.mark.parametrize("model", visual.MODELS, ids=lambda m: m.name)
def test_nothing_in_the_picture_of_a_formula_overlaps_or_is_cut(model):
    fig = formula_figure(model.lines)
    fig.set_dpi(400)  # letters are hinted to whole pixels
    fig.draw_without_rendering()
    boxes = [t.get_window_extent() for t in fig.texts] + [a.get_window_extent() for a in fig.artists]
    assert len(fig.texts) > 10
    assert len(fig.artists) == 2 * sum(
        isinstance(p, Matrix) for e in model.lines if isinstance(e, Equation) for p in e.right
    )
    for box in boxes:
        assert box.x0 >= 0
        assert box.y0 >= 0
        assert box.x1 <= fig.bbox.x1
        assert box.y1 <= fig.bbox.y1
    for a, b in combinations(boxes[: len(fig.texts)], 2):
        shared = np.minimum(a.max, b.max) - np.maximum(a.min, b.min)
        assert shared.min() < 0.3 * 400 / 72  # pt
