"""Calls aside in workers; freed memory goes back, and a user's own pool stays."""

import os
from functools import partial

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from evaluation.pool.memory import release_memory_after
from evaluation.pool.workers import run_in_idle_worker, start_workers_early


def test_the_pool_is_the_users_again_even_after_an_error():
    before = pa.default_memory_pool().backend_name
    with pytest.raises(LookupError, match="system"), release_memory_after():
        raise LookupError(pa.default_memory_pool().backend_name)
    assert pa.default_memory_pool().backend_name == before


def process_unless(dies_in, *, raises=False):
    if raises:
        raise LookupError(os.getpid())
    if dies_in != os.getpid() and dies_in:
        os._exit(1)
    return os.getpid()


@pytest.mark.parametrize("n_workers", [0, 1])
def test_a_call_is_made_by_a_worker_if_one_waits_and_here_if_it_dies(n_workers):
    with start_workers_early(n_workers):
        for _ in range(2):  # the worker goes on waiting
            with run_in_idle_worker(partial(process_unless, 0)) as answer:
                assert (answer() != os.getpid()) == bool(n_workers)
        with (
            pytest.raises(LookupError),
            run_in_idle_worker(partial(process_unless, 0, raises=True)) as answer,
        ):
            answer()
        with run_in_idle_worker(partial(process_unless, os.getpid())) as answer:
            assert answer() == os.getpid()


def test_what_a_worker_finds_comes_back_as_it_was():
    table = pa.table({"a": [1.0, None], "b": ["x", "y"]})
    grid = np.arange(12.0).reshape(3, 4)
    result = {"whole": grid, "columns": np.asfortranarray(grid), "some": grid[:, ::2]}
    result |= {"none": np.zeros((0, 3)), "objects": np.array(["a", None], dtype=object)}
    with (
        start_workers_early(1),
        run_in_idle_worker(
            partial(dict, **result, table=table, frame=pd.DataFrame(grid))
        ) as answer,
    ):
        back = answer()
    assert back.pop("table").equals(table)
    pd.testing.assert_frame_equal(back.pop("frame"), pd.DataFrame(grid))
    for name, values in result.items():
        np.testing.assert_array_equal(back[name], values, strict=True)
