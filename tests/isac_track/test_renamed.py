"""Names of the first release: they are the new ones, and say so."""

from importlib import import_module
from types import SimpleNamespace

import pytest

from isac_track.protocols import links_same_stretch

RENAMED = {
    # Of 0.1, by the import paths that stay.
    "isac_track.types:runs_of": "sample_runs",
    "isac_track.protocols:OF_WALKS": "WALK_KNOWLEDGE",
    "isac_track.protocols:kind_of": "attack_kind",
    "isac_track.sharing:names_of": "split_pseudonyms",
    "isac_track.intervals:estimate_of": "estimate_from_replicates",
    "attacks.testing:adversaries_of": "list_adversaries",
}


@pytest.mark.parametrize("place", RENAMED)
def test_an_earlier_name_is_the_new_one_and_warns(place):
    path, _, name = place.partition(":")
    module = import_module(path)
    with pytest.warns(FutureWarning, match=f"{name} is now called {RENAMED[place]}"):
        earlier = getattr(module, name)
    assert earlier is getattr(module, RENAMED[place])


@pytest.mark.parametrize("path", sorted({name.partition(":")[0] for name in RENAMED}))
def test_a_name_that_never_was_is_unknown(path):
    with pytest.raises(AttributeError, match=f"module '{path}' has no attribute 'no'"):
        import_module(path).no  # noqa: B018 - the access is what fails


def test_the_old_name_of_a_linkers_attribute_is_read_with_a_warning():
    with pytest.warns(FutureWarning, match="one_stretch is now called same_stretch"):
        assert links_same_stretch(SimpleNamespace(one_stretch=True))
    assert links_same_stretch(SimpleNamespace(same_stretch=True))
    assert not links_same_stretch(SimpleNamespace())
