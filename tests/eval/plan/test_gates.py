"""The gate outside which an observation may start a landmark is not inside the gate of the pairings."""

from __future__ import annotations

import pytest

from data.errors import UsageError
from eval.plan.flags.options import read_options
from eval.studies.scenario import load_scenario
from wings.labs.stepping.command import read

NESTED = [
    ("0.999", "0.999"), ("0.95", "0.99"), ("none", "0.5"), ("0.999", "none"), ("none", "none"),
]  # fmt: skip
"""Equal is the lab's rule; none is no gate, outside of any."""


@pytest.mark.parametrize(("gate", "new_gate"), NESTED)
def test_nested_gates_are_taken(gate, new_gate):
    read_options(["--gate", gate, "--new-gate", new_gate])


@pytest.mark.parametrize("arguments", [
    ["--gate", "0.999", "--new-gate", "0.5"], ["--new-gate", "0.98"], ["--gate", "0.9999999"],
])  # fmt: skip
def test_a_new_gate_inside_the_gate_is_refused_in_one_line_that_names_both(arguments):
    for refuse in (read_options, lambda given: read(["--log", "arena:0", *given])):
        with pytest.raises(UsageError, match=r"--new-gate 0\.\d+: must not be less than --gate 0\.\d+") as fault:
            refuse(arguments)
        assert "\n" not in str(fault.value)


def test_so_it_is_in_a_config_file(tmp_path):
    config = tmp_path / "run.toml"
    config.write_text("gate = 0.999\nnew_gate = 0.5\n")
    with pytest.raises(UsageError, match=r"--new-gate 0\.5: must not be less than --gate 0\.999"):
        read_options(["--config", str(config)])
    assert read_options(["--config", str(config), "--gate", "0.5"]).setup.gate == 0.5


@pytest.mark.parametrize(("setup", "words"), [
    ("gate = 0.999\nnew_gate = 0.5", "new_gate = 0.5: must not be less than gate = 0.999"),
    ("gate = 5", "gate = 5: a probability between 0 and 1"), ('lag = "none"', "lag = none: a number is needed"),
    ("maintain = 1", "maintain = 1: true or false is needed"), ("forget_after = -1", "a positive number is needed"),
])  # fmt: skip
def test_so_it_is_in_the_setup_of_a_scenario_as_every_other_fault(tmp_path, setup, words):
    path = tmp_path / "small.toml"
    path.write_text(f'about = "x"\n[world]\nkind = "arena"\nframes = 40\n[estimators]\nekf = {{}}\n[setup]\n{setup}\n')
    with pytest.raises(UsageError, match=r"small\.toml: \[setup\] ") as fault:
        load_scenario(str(path))
    assert words in str(fault.value)
