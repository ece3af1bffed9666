"""What is made of a release is made once, and forgotten with it."""

import weakref

import numpy as np
from helpers.walks import smooth_walks, two_releases

from attacks.linkage.behaviour import features
from attacks.linkage.signals import on_grid
from attacks.remembered import (
    as_shared,
    noise_m2,
    part,
    reconstructed_from,
    remembered,
    whole,
)
from isac_track.types import derived


def test_it_is_made_once_for_each_release_and_dies_with_it():
    made = []

    @remembered
    def counted(release, *rest, factor=1):
        made.append((len(release), rest, factor))
        return len(made)

    one, other = (smooth_walks(3)[0] for _ in range(2))
    asked = [
        (one, 1),
        (one, 1),
        (one, 2),
        (other, 1),
        (one, other),
        (one, 1),
        (one, other),
    ]
    asked += [
        (other, one),
        (one, one),
        (other, one),
    ]  # nobody keeps itself or its partner alive
    assert [counted(*each) for each in asked] == [1, 1, 2, 3, 4, 1, 4, 5, 6, 5]
    alive = [weakref.ref(each) for each in (one, other)]
    assert counted(one, factor=2) == 7
    assert counted(one, factor=3) == 8
    del one, other, asked, made[:]
    assert [each() for each in alive] == [None, None]


def test_what_is_known_of_a_part_is_what_is_made_of_its_tracks_alone():
    release, _, _ = two_releases(9, noise_m=0.3)
    some = part(part(release, np.array([8, 0, 3, 5])), np.array([2, 0]))
    assert whole(some)[0] is release
    assert whole(some)[1].tolist() == [3, 8]
    alone = release.tracks([3, 8])
    assert whole(alone)[0] is alone
    for made in (noise_m2, features):
        np.testing.assert_allclose(made(some), made(alone), rtol=1e-12)
    walks, by_itself = on_grid(some), on_grid(alone)
    assert np.array_equal(walks.sizes, by_itself.sizes)
    for row, cells in enumerate(walks.sizes):
        assert np.array_equal(
            walks.values[:, row, :cells], by_itself.values[:, row, :cells]
        )


def test_a_reconstruction_and_its_parts_know_what_was_shared_for_as_long_as_they_live():
    shared, _, _ = two_releases(9, noise_m=0.3)
    assert as_shared(shared) is shared
    smooth = reconstructed_from(derived(shared, xy=0.5 * shared.xy), shared)
    assert as_shared(smooth) is shared
    some = as_shared(part(part(smooth, np.array([8, 0, 3])), np.array([2, 0])))
    assert whole(some)[0] is shared
    assert np.array_equal(some.xy, shared.tracks([3, 8]).xy)
    alive = weakref.ref(shared)
    del shared, some
    assert alive() is not None
    del smooth
    assert alive() is None
