"""The park world: parameters out of range."""

import pytest

from data.errors import UsageError
from data.worlds.registry import named_log


@pytest.mark.parametrize("key", ["block=19", "detection=1.5", "spacing=0", "frames=0"])
def test_parameters_out_of_range_are_refused(key):
    with pytest.raises(UsageError, match=key.partition("=")[0]):
        named_log(f"park:0:{key}")
