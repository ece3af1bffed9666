"""What is freed goes back to the system, and a user's own pool is left alone."""

import pyarrow as pa
import pytest

from evaluation.runs.workers import given_back


def test_the_pool_is_the_users_again_even_after_an_error():
    before = pa.default_memory_pool().backend_name
    with pytest.raises(LookupError, match="system"), given_back():
        raise LookupError(pa.default_memory_pool().backend_name)
    assert pa.default_memory_pool().backend_name == before
