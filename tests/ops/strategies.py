"""Random inputs of the properties that hold for all."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

sizes = st.tuples(st.integers(1, 2), st.integers(1, 5), st.integers(1, 5), st.integers(1, 40))
seeds = st.integers(0, 2**31)
offsets = st.integers(-12, 12)
spans = st.integers(0, 14)
directions = st.integers(0, 3)
few = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
