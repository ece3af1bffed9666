"""What is made of a release is made once, and forgotten with it."""

import weakref

import numpy as np
from helpers.walks import smooth_walks, two_releases

from attacks.linkage.behaviour import features
from attacks.linkage.signals import on_grid
from attacks.remembered import (
    as_shared,
    find_origin,
    memoised,
    noise_m2,
    record_shared,
    select_tracks,
)
from isac_track.types import derived


def test_a_result_is_computed_once_and_dies_with_its_release():
    made = []

    @memoised
    def counted(release, *rest, factor=1):
        made.append((len(release), rest, factor))
        return len(made)

    first, second = (smooth_walks(3)[0] for _ in range(2))
    asked = [
        (first, 1),
        (first, 1),
        (first, 2),
        (second, 1),
        (first, second),
        (first, 1),
        (first, second),
    ]
    asked += [
        (second, first),
        (first, first),
        (second, first),
    ]  # nobody keeps itself or its partner alive
    assert [counted(*each) for each in asked] == [1, 1, 2, 3, 4, 1, 4, 5, 6, 5]
    alive = [weakref.ref(each) for each in (first, second)]
    assert counted(first, factor=2) == 7
    assert counted(first, factor=3) == 8
    del first, second, asked, made[:]
    assert [each() for each in alive] == [None, None]


def test_a_part_has_the_results_of_its_tracks_by_themselves():
    release, _, _ = two_releases(9, noise_m=0.3)
    part = select_tracks(
        select_tracks(release, np.array([8, 0, 3, 5])), np.array([2, 0])
    )
    assert find_origin(part)[0] is release
    assert find_origin(part)[1].tolist() == [3, 8]
    alone = release.tracks([3, 8])
    assert find_origin(alone)[0] is alone
    for function in (noise_m2, features):
        np.testing.assert_allclose(function(part), function(alone), rtol=1e-12)
    walks, by_itself = on_grid(part), on_grid(alone)
    assert np.array_equal(walks.sizes, by_itself.sizes)
    for row, cells in enumerate(walks.sizes):
        assert np.array_equal(
            walks.values[:, row, :cells], by_itself.values[:, row, :cells]
        )


def test_a_reconstruction_and_its_parts_know_the_shared_release_while_they_live():
    shared, _, _ = two_releases(9, noise_m=0.3)
    assert as_shared(shared) is shared
    smooth = record_shared(derived(shared, xy=0.5 * shared.xy), shared)
    assert as_shared(smooth) is shared
    part = as_shared(
        select_tracks(select_tracks(smooth, np.array([8, 0, 3])), np.array([2, 0]))
    )
    assert find_origin(part)[0] is shared
    assert np.array_equal(part.xy, shared.tracks([3, 8]).xy)
    alive = weakref.ref(shared)
    del shared, part
    assert alive() is not None
    del smooth
    assert alive() is None
