"""Audit of any factor graph: leverage, deleted residuals, variance components, reliability, influence."""

from data.wing import Wing

wing = Wing(
    "audit", commands={"audit": ("wings.audit.command:main", "examine any factor graph: g2o, Toro, or gtsam")},
    api={"audit": "wings.audit.examined"}, kernels={"audit": "wings.audit.audit:warm"}, templates="wings.audit",
)  # fmt: skip
