"""Every reader, given broken files: one clear error or a right load, at once, in little memory; nothing else."""

import pytest

from tests.faults.readers import READERS, try_faults

COUNTS = [4, pytest.param(2000, marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("count", COUNTS)
def test_broken_input_is_refused_in_one_line_or_read_right_at_once_and_in_little_memory(name, count):
    try_faults(name, READERS[name], count)
