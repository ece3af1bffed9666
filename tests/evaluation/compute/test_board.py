"""Scores of cards: attacks on logs learn fairly, and hidden digits are read."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from helpers.cards import SMALL, small_card, small_maker

from attacks.following.logs import first_half
from evaluation.api.card_entries import cross_entries
from evaluation.compute.board import attack_scores, hidden_message
from evaluation.compute.log_attacks import log_attack
from isac_track.errors import PluginError, SettingsError
from isac_track.plugins import parse, parse_all
from isac_track.types import Knowledge, Reconstruction

SEEN = []  # What the attack of this page was given; emptied by each test.


@dataclass(frozen=True)
class Recorder:
    """Notes what it is given, and rebuilds the truth where it has seen it before."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SIGMA})

    def fit(self, context):
        learnt = {tuple(xy) for xy in context.train.release.xy.tolist()}

        def reconstruct(release):
            SEEN.append((learnt, release))
            return Reconstruction(release.xy, None)

        return reconstruct


@dataclass(frozen=True)
class Demanding:
    """Needs what no log holds."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.ANCHOR})
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, _):
        raise AssertionError


@dataclass(frozen=True)
class Short(Recorder):
    """Returns too few positions."""

    def fit(self, _):
        return lambda release: Reconstruction(release.xy[1:], None)


def shared(mechanism, policy="everything"):
    (entry,) = cross_entries(["plaza"], ["radial"], [mechanism], [policy])
    return small_maker().share(entry), entry.policy


def attack_of(plugin):
    return log_attack(parse_all("attacks", [plugin])[0])


def test_an_attack_never_learns_from_people_it_is_scored_on():
    SEEN.clear()
    network, policy = shared("raw")
    attack_scores(network, policy, [attack_of(Recorder())])
    people = network.setup.patrol.people
    is_first = np.repeat(first_half(people.group), np.diff(people.offsets))
    assert len(SEEN) == 2  # all fleets hold the same log of either half
    for learnt, release in SEEN:
        scored = {tuple(xy) for xy in release.xy.tolist()}
        assert learnt
        assert not learnt & scored
    # Samples after the last query are never sent.
    for (_, release), half in zip(SEEN, (is_first, ~is_first), strict=True):
        assert 0.9 * half.sum() < release.t.size <= half.sum()


def test_an_attack_that_changes_nothing_knows_what_lines_and_smoother_know():
    (entry,) = cross_entries(["plaza"], ["radial"], ["ou:0.4"], ["everything"])
    card = small_card()
    network = small_maker().share(entry)
    (score,) = attack_scores(network, entry.policy, [attack_of("identity")])
    by_log = {item.by: item.value for item in card.scores}
    assert score.estimate.value == max(by_log["log:smooth"], by_log["log:interpolate"])


@pytest.mark.parametrize(
    ("plugin", "message"),
    [
        (Demanding(), "needs ANCHOR, which a log does not hold"),
        ("dtw", "a linker runs in evaluation.matrix"),
    ],
)
def test_an_attack_that_cannot_run_on_a_log_is_refused(plugin, message):
    with pytest.raises(SettingsError, match=message):
        attack_of(plugin)


def test_an_attack_that_breaks_its_contract_is_named():
    network, policy = shared("raw", "window:1.3")
    with pytest.raises(PluginError, match=r"Short.*must return a Reconstruction"):
        attack_scores(network, policy, [attack_of(Short())])


@pytest.mark.parametrize("spec", SMALL.mechanisms)
def test_the_digits_of_honest_mechanisms_say_nothing(spec):
    message = hidden_message(shared(spec)[0])
    assert message.explained < 0.05
    assert not message.is_message


@pytest.mark.parametrize("name", ["Watermark", "Scrambled"])
def test_a_place_in_the_digits_is_read_by_the_test_and_by_the_attack(name):
    network, policy = shared(f"helpers.watermarks:{name}")
    message = hidden_message(network)
    assert message.explained > 0.99
    attack = "attacks.reconstruction.low_digits:LowDigits"
    specs = [attack, "ou_rts"]
    digits, smoother = attack_scores(network, policy, map(attack_of, specs))
    assert digits.estimate.ci_low > 3.0 * smoother.estimate.value


def test_a_place_behind_a_key_is_not_seen():
    """The limit of every such test: digits with a key look random without it."""
    assert not hidden_message(shared("helpers.watermarks:Keyed")[0]).is_message


def test_the_attack_on_digits_leaves_honest_releases_as_they_are():
    network, policy = shared("ou:0.4")
    spec = "attacks.reconstruction.low_digits:LowDigits"
    by_digits, by_nothing = attack_scores(
        network, policy, map(attack_of, [spec, "identity"])
    )
    assert by_digits.estimate.value == by_nothing.estimate.value
    assert parse("attacks", spec)[0].spec == spec
