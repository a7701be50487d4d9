"""The visual log's motion and observation models with their Jacobians, as formulas to be typeset.

They stand once, as the LaTeX of their entries. What they say is computed by `data.motion.velocity.step`,
`data.se2.compose` and `data.sensors.measure`; a test evaluates the entries below and compares them with those.
"""

from __future__ import annotations

from dataclasses import dataclass

from eval.figures.paper.tex import tex_escape
from eval.page.equations import Equation, Matrix, Where, latex


@dataclass(frozen=True)
class Model:
    """What is modelled, in words (plain text) and equations; `name` is its part of file names."""

    name: str
    title: str
    about: str
    lines: tuple[Equation | Where, ...]


COMMAND_TERMS = Where((("D", r"v\,\Delta t"), (r"\alpha", r"\omega\,\Delta t"), ("d_x", "a D"), ("d_y", "b D")))
ARC_TERMS = Where((
    ("a", r"\dfrac{\sin\alpha}{\alpha}"), ("b", r"\dfrac{1 - \cos\alpha}{\alpha}"),
    ("a'", r"\dfrac{\cos\alpha - a}{\alpha}"), ("b'", r"\dfrac{\sin\alpha - b}{\alpha}"),
), "and")  # fmt: skip
NEXT_POSE = Matrix((
    (r"x + d_x \cos\theta - d_y \sin\theta",), (r"y + d_x \sin\theta + d_y \cos\theta",), (r"\theta + \alpha",),
))  # fmt: skip
POSE_JACOBIAN = Matrix((
    ("1", "0", r"-d_x \sin\theta - d_y \cos\theta"), ("0", "1", r"d_x \cos\theta - d_y \sin\theta"), ("0", "0", "1"),
))  # fmt: skip
CONTROL_JACOBIAN = Matrix((
    (r"a \cos\theta - b \sin\theta", r"D (a' \cos\theta - b' \sin\theta)"),
    (r"a \sin\theta + b \cos\theta", r"D (a' \sin\theta + b' \cos\theta)"),
    ("0", "1"),
), factor=r"\Delta t")  # fmt: skip
CONTROL_NOISE = Matrix(((r"\sigma_v^2", "0"), ("0", r"\sigma_\omega^2")))

ANGLE = (r"\psi", r"\varphi - \theta")
ROTATION = Matrix(((r"\cos\varphi", r"-\sin\varphi"), (r"\sin\varphi", r"\cos\varphi")))
EXPECTED = Matrix((
    (r"(l_{x} - x) \cos\psi - (l_{y} - y) \sin\psi + T_x",), (r"(l_{x} - x) \sin\psi + (l_{y} - y) \cos\psi + T_z",),
))  # fmt: skip
OBSERVATION_JACOBIAN = Matrix((
    (r"-\cos\psi", r"\sin\psi", "z^c_j - T_z"), (r"-\sin\psi", r"-\cos\psi", "T_x - x^c_j"),
))  # fmt: skip
CORNER_JACOBIAN = Matrix(((r"\cos\psi", r"-\sin\psi"), (r"\sin\psi", r"\cos\psi")))
CORNER_NOISE = Matrix(((r"\sigma_x^2", "0"), ("0", r"\sigma_z^2")))

MOTION = Model(
    "motion",
    "Motion model",
    "The pose is (x, y, θ) in the world frame. A command (v, ω) holds for Δt and drives the robot along a circular arc,"
    " exactly: displacement D along the arc, rotation α, and from these the step (dx, dy, α) in the robot's own frame,"
    " composed with the pose; the heading is then wrapped to ±180°. As ω goes to zero, a goes to 1, b and a' go to 0"
    " and b' to 1/2, and the arc becomes a straight line; the program takes these limits by series. F is the Jacobian"
    " with respect to the pose, G the one with respect to the command, and the noise of v and ω is independent at each"
    " command. Source: Probabilistic Robotics, section 5.3; code: data.motion.velocity.step, data.se2.compose.",
    (
        Equation(r"\mathbf{x}_{k+1}", (r"f(\mathbf{x}_k, \mathbf{u}_k) = ", NEXT_POSE)),
        COMMAND_TERMS,
        ARC_TERMS,
        Equation(r"\mathbf{F}_k", (r"\dfrac{\partial f}{\partial \mathbf{x}} = ", POSE_JACOBIAN)),
        Equation(r"\mathbf{G}_k", (r"\dfrac{\partial f}{\partial \mathbf{u}} = ", CONTROL_JACOBIAN)),
        Equation(
            r"\mathbf{P}_{k+1}",
            (r"\mathbf{F}_k \mathbf{P}_k \mathbf{F}_k^{\mathsf{T}} + ",
             r"\mathbf{G}_k \mathbf{Q}\, \mathbf{G}_k^{\mathsf{T}} ,\qquad \mathbf{Q} = ", CONTROL_NOISE),
        ),
    ),
)  # fmt: skip
OBSERVATION = Model(
    "observation",
    "Observation model",
    "Corner j of a picture is the point l in the world's plan. The stereo camera sees it at x to the right and z ahead;"
    " rotation (by the angle φ) and translation T lead from the robot's frame to the camera's. H is the Jacobian with"
    " respect to the pose and L the one with respect to the corner, which only SLAM needs. All corners of a frame are"
    " stacked into one update, with independent noise. Source: Probabilistic Robotics, section 6.6, for a point instead"
    " of range and bearing; code: data.sensors.measure.",
    (
        Equation(
            r"h_j(\mathbf{x})",
            (Matrix((("x^c_j",), ("z^c_j",))),
             r" = \mathrm{Rot}(\varphi)\, \mathrm{Rot}(\theta)^{\mathsf{T}} (\mathbf{l} - \mathbf{p}) + \mathbf{T}"),
        ),
        Equation("", (EXPECTED,)),
        Equation(r"\mathrm{Rot}(\varphi)", (ROTATION, r",\qquad " + " = ".join(ANGLE))),
        Equation(r"\mathbf{H}_j", (r"\dfrac{\partial h_j}{\partial \mathbf{x}} = ", OBSERVATION_JACOBIAN)),
        Equation(r"\mathbf{L}_j", (r"\dfrac{\partial h_j}{\partial \mathbf{l}} = ", CORNER_JACOBIAN)),
        Equation(
            r"\mathbf{S}",
            (r"\mathbf{H} \mathbf{P} \mathbf{H}^{\mathsf{T}} + \mathbf{R} ,\qquad \mathbf{H} = ",
             Matrix(((r"\mathbf{H}_1",), (r"\vdots",), (r"\mathbf{H}_m",)))),
        ),
        Equation(
            r"\mathbf{R}",
            (r"\mathrm{blockdiag}(\mathbf{R}_1, \ldots, \mathbf{R}_m) ,\qquad \mathbf{R}_j = ", CORNER_NOISE),
        ),
    ),
)  # fmt: skip
UPDATE = Model(
    "update",
    "Update",
    "What was seen corrects what was predicted (the lab's equations 10 to 13): the innovation of all corners of a"
    " frame, its gain, the pose and its covariance after it; quantities with a minus are predicted. S and H are those"
    " of the observation model. Heading differences are wrapped, and in SLAM the corners are part of the state. Source:"
    " Probabilistic Robotics, table 3.3; code: ekf.updates.",
    (
        Equation(r"\nu", (r"\mathbf{z} - h(\mathbf{x}^{-}) \qquad (10)",)),
        Equation(
            r"\mathbf{K}",
            (r"\mathbf{P}^{-} \mathbf{H}^{\mathsf{T}} (\mathbf{H} \mathbf{P}^{-} \mathbf{H}^{\mathsf{T}}",
             r" + \mathbf{R})^{-1} \qquad (11)"),
        ),
        Equation(r"\mathbf{x}^{+}", (r"\mathbf{x}^{-} + \mathbf{K} \nu \qquad (12)",)),
        Equation(r"\mathbf{P}^{+}", (r"(\mathbf{I} - \mathbf{K} \mathbf{H}) \mathbf{P}^{-} \qquad (13)",)),
    ),
)  # fmt: skip
MODELS = (MOTION, OBSERVATION, UPDATE)


def models_latex(models: tuple[Model, ...] = MODELS) -> str:
    """Words and equations of models as a LaTeX fragment; it needs amsmath."""
    greek = str.maketrans({"ω": r"$\omega$", "φ": r"$\varphi$", "ψ": r"$\psi$", "Δ": r"$\Delta$"})
    parts = ["% \\usepackage{amsmath}"]
    for model in models:
        about = tex_escape(model.about).translate(greek)
        parts.append(f"\\paragraph{{{model.title}.}} {about}\n\\[\n{latex(model.lines)}\n\\]")
    return "\n".join(parts) + "\n"
