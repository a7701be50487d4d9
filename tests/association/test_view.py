"""The view that was read: it grows with what is read, and never shrinks."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from association.candidates import holding
from data.sensors import RangeBearing

POLAR = arrays(float, st.tuples(st.integers(0, 5), st.just(2)), elements=st.floats(0.0, 3.0))


@given(POLAR, POLAR)
def test_a_view_holds_all_that_was_read_and_all_that_it_held(first, second):
    begun = RangeBearing(max_range=1.0, min_angle=-0.5, max_angle=0.5)
    view = holding(holding(begun, first), second)
    both = np.concatenate([first, second])
    assert view.max_range == max(1.0, both[:, 0].max(initial=0.0))
    assert view.min_angle == min(-0.5, both[:, 1].min(initial=0.0))
    assert view.max_angle == max(0.5, both[:, 1].max(initial=0.0))
