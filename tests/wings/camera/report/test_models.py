"""The typeset models say what the code computes, and are set cleanly."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from data import se2
from data.motion.velocity import ARC, step
from data.sensors import RelativePoint
from eval.report.words import say, tex
from wings.camera import report as visual

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
        return value[r"\Delta " + take()] if token == r"\Delta" else float(token) if token.isdigit() else value[token]

    result = total()
    assert not tokens
    return result


def array(before: str, value: dict[str, float], model=None) -> np.ndarray:
    """The matrix that stands behind some LaTeX, with the factor between the two."""
    text = (model or visual.OBSERVATION).latex
    at = text.index(before) + len(before)
    factor, rest = text[at:].split(r"\begin{bmatrix}", 1)
    rows = rest.split(r"\end{bmatrix}", 1)[0].split(r"\\")
    scale = evaluate(factor.strip(), value) if factor.strip() else 1.0
    return scale * np.array([[evaluate(entry.strip(), value) for entry in row.split("&")] for row in rows])


def terms(model) -> dict[str, str]:
    """The abbreviations of a model: symbol and meaning, those without a fraction first."""
    lines = [line for line in model.latex.split("\n") if r"\quad D =" in line or r"\quad a =" in line]
    found = dict(part.split(" = ") for line in lines for part in re.split(r",?\\quad ", line.split(r" \\[")[0])[1:])
    return dict(sorted(found.items(), key=lambda item: item[0].startswith("d_")))


def central(f, at: np.ndarray, h: float = 1e-6) -> np.ndarray:
    steps = h * np.eye(len(at))
    return np.stack([(f(at + s) - f(at - s)) / (2 * h) for s in steps], axis=-1)


def test_the_evaluator_of_formulas_knows_arithmetic():
    value = {"a": 2.0, "b'": 3.0, "d_x": 5.0, "x^c_j": 7.0, r"\Delta t": 0.5, r"\theta": np.pi / 6}
    assert evaluate(r"-a (b' - d_x) + \dfrac{x^c_j - 1}{a b'}", value) == pytest.approx(5.0)
    assert evaluate(r"a\,\Delta t \sin\theta + 4 \cos(\theta + \theta)", value) == pytest.approx(2.5)


AFTER_X, AFTER_U = (rf"\dfrac{{\partial f}}{{\partial \mathbf{{{of}}}}} =" for of in "xu")  # motion
MOTIONS = [
    ((1.0, -2.0, 0.4), (0.3, 0.5), 0.25), ((0.0, 3.0, np.pi - 0.01), (0.8, 1.5), 0.1),
    ((-4.0, 0.2, -2.9), (-0.5, -0.9), 0.5), ((2.0, 2.0, 1.6), (0.4, 1e-3), 0.2),
]  # fmt: skip


def moved(pose: np.ndarray, control: np.ndarray, dt: float) -> np.ndarray:
    """The code's motion; its heading not wrapped, so that it can be differentiated."""
    mean, G = np.zeros(3), np.zeros((3, 2))
    step(ARC, control[0] * dt, control[1] * dt, mean, G)
    return np.array([*se2.compose(pose, mean)[:2], pose[2] + mean[2]])


def motion_values(pose, control, dt) -> dict[str, float]:
    value = {"x": pose[0], "y": pose[1], r"\theta": pose[2], "v": control[0], r"\omega": control[1], r"\Delta t": dt}
    for symbol, meaning in terms(visual.MOTION).items():
        value[symbol] = evaluate(meaning, value)
    return value


@pytest.mark.parametrize(("pose", "control", "dt"), MOTIONS)
def test_the_typeset_motion_model_and_its_jacobians_are_the_codes(pose, control, dt):
    pose, control = np.array(pose), np.array(control)
    value = motion_values(pose, control, dt)
    assert array(r"\mathbf{u}_k) =", value, visual.MOTION)[:, 0] == pytest.approx(moved(pose, control, dt), abs=1e-12)
    F = central(lambda p: moved(p, control, dt), pose)
    G = central(lambda u: moved(pose, u, dt), control)
    assert array(AFTER_X, value, visual.MOTION) == pytest.approx(F, abs=1e-8)
    assert array(AFTER_U, value, visual.MOTION) == pytest.approx(G, abs=1e-8)


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
    assert r"\qquad \psi = \varphi - \theta" in visual.OBSERVATION.latex
    value[r"\psi"] = turn - pose[2]
    seen = sensor.predict(pose, corner[None])[0]
    assert array("\n&=", value)[:, 0] == pytest.approx(seen, abs=1e-12)
    chain = array(r"\mathrm{Rot}(\varphi) &=", value) @ se2.rotation(pose[2]).T @ (corner - pose[:2]) + shift
    assert chain == pytest.approx(seen, abs=1e-12)
    value |= {"x^c_j": seen[0], "z^c_j": seen[1]}
    H, L = (array(rf"\dfrac{{\partial h_j}}{{\partial \mathbf{{{of}}}}} =", value) for of in "xl")
    assert pytest.approx(central(lambda p: sensor.predict(p, corner[None])[0], pose), abs=1e-8) == H
    assert pytest.approx(central(lambda c: sensor.predict(pose, c[None])[0], corner), abs=1e-8) == L
    Hx, Hl = sensor.jacobians(pose, corner[None])
    assert pytest.approx(Hx[0], abs=1e-12) == H
    assert pytest.approx(Hl[0], abs=1e-12) == L


# typesetting


def test_the_latex_holds_every_model_in_order_in_characters_that_latex_sets():
    text = say("models/all", models=visual.MODELS) + "\n"
    words, equations = tex(visual.MOTION.about), visual.MOTION.latex
    assert text.startswith(f"% \\usepackage{{amsmath}}\n\\paragraph{{Motion model.}} {words}\n\\[\n{equations}\n\\]\n")
    assert re.findall(r"\\paragraph\{(.*?)\}", text) == ["Motion model.", "Observation model.", "Update."]
    at = [text.index(m.latex) for m in visual.MODELS]
    assert at == sorted(at)
    assert text.isascii()


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX on this machine")
def test_the_latex_of_the_models_compiles_and_fits_the_page(tmp_path):
    body = say("models/all", models=visual.MODELS) + "\n"
    (tmp_path / "m.tex").write_text(
        "\\documentclass{article}\n\\usepackage{amsmath}\n\\begin{document}\n" + body + "\\end{document}\n"
    )
    made = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "m.tex"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert made.returncode == 0, made.stdout[-2000:]
    assert "Overfull" not in made.stdout
