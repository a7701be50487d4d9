"""A whole lab, handed in: its experiments, and its questions answered in order at the top of the report."""

from data.wing import Wing

wing = Wing(
    "labs",
    commands={"step": ("wings.labs.stepping.command:main", "walk through a log, one frame at each press of Enter")},
    run_files=("wings.labs.stepping.text:write_lab_text",), plans=("wings.labs.plan:lab_experiments",),
    hand_in=("wings.labs.sections:hand_in",), write_up=("wings.labs.write_up:write_up",),
    settings=("wings.labs.plan:settings_by_log",), templates="wings.labs",
)  # fmt: skip
