"""A worker's side: what it does when its parent ends."""

from evaluation.pool.serve import _compute_messages


def test_messages_that_nobody_reads_end_in_silence():
    messages = _compute_messages(iter, [1, 2])
    next(messages)
    # Closed as the interpreter closes it: an error here is printed by the worker.
    messages.close()
    assert list(messages) == []
