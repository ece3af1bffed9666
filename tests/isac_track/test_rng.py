from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest

from isac_track.rng import stream


def first(seed, *keys):
    return stream(seed, *keys).integers(2**63)


def test_keying_is_pinned():
    # Computed separately from the bytes. A change of the keying changes all results.
    assert first(0, "a") == 7582406776310106918
    assert first(7, "sensing", "scene", 17) == 2578434188189093347


@pytest.mark.parametrize(
    "seed", [0, 7, 2**32 - 1, 2**32, 2**128 - 1, 2**128, 2**200 + 1]
)
def test_a_stream_and_its_children_are_those_of_a_seed_sequence_with_a_spawn_key(seed):
    text = b"sname"
    name = len(text).to_bytes(8, "little") + text
    key = struct.unpack("<4I", hashlib.sha256(name).digest()[:16])
    plain = np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key))
    )
    ours = stream(seed, "name")
    assert [child.random() for child in ours.spawn(2)] == [
        child.random() for child in plain.spawn(2)
    ]
    assert ours.random() == plain.random()


def test_streams_do_not_depend_on_the_order_of_their_making():
    forwards = {key: stream(1, "scene", key).random() for key in range(20)}
    backwards = {key: stream(1, "scene", key).random() for key in reversed(range(20))}
    assert forwards == backwards


@pytest.mark.parametrize(
    ("names", "others"),
    [
        (("ab", "c"), ("a", "bc")),
        (("abc",), ("a", "b", "c")),
        (("1",), (1,)),
        (("a", ""), ("a",)),
        (("a", "b"), ("b", "a")),
        ((1, 2), (12,)),
        ((-1,), (1,)),
        (("s1",), (1,)),
        (("i1",), (1,)),
    ],
)
def test_names_differ_by_boundary_type_and_order(names, others):
    assert first(0, *names) != first(0, *others)


def test_seeds_make_other_streams_and_the_type_of_an_integer_does_not():
    assert len({first(seed, "a") for seed in range(100)}) == 100
    assert first(0, np.int64(17)) == first(0, np.int32(17)) == first(0, 17)


def test_streams_are_uncorrelated():
    draws = np.stack(
        [stream(0, "scene", key).standard_normal(2000) for key in range(20)]
    )
    correlation = np.corrcoef(draws)[~np.eye(20, dtype=bool)]
    # 190 pairs, standard error 1 / sqrt(2000): five of them are never reached by chance
    assert np.abs(correlation).max() < 5 / np.sqrt(2000)


def test_a_stream_needs_a_name_and_a_seed_that_is_not_negative():
    with pytest.raises(ValueError, match="needs a name"):
        stream(0)
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        stream(-1, "a")
