"""ROS bags, broken: one clear error or a right load, at once, in little memory; nothing else."""

from __future__ import annotations

import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'slamref[ros]'")
from tests.faults.bag_readers import BAG_READERS, compile_once
from tests.faults.fuzzing import try_faults


@pytest.mark.slow
@pytest.mark.parametrize("name", BAG_READERS)
def test_a_broken_bag_is_refused_in_one_line_or_read_right_at_once_and_in_little_memory(name):
    with compile_once():
        try_faults(name, BAG_READERS[name], 10_000)
