"""Robots that observe each other: one estimate of all of them, or each its own with an exchange of estimates."""

from data.wing import Wing, World

TEAM = World("wings.cooperative.world", "Team", "team:0 or team:0:robots=3+exchange=naive")

wing = Wing(
    "cooperative", worlds={"team": TEAM}, replays=("wings.cooperative.runs:team_runs",),
    teams=("wings.cooperative.experiments:experiments",), company=("wings.cooperative.report:company",),
    sections=("wings.cooperative.report:team_sections",), templates="wings.cooperative",
)  # fmt: skip
