"""Cards compared: by bits, by joint standard errors, and by who beats whom."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from helpers.cards import made_up_card
from statsmodels.stats.multitest import multipletests

from evaluation.estimates.board_places import on_front, same_board, standings
from evaluation.estimates.card_agreement import agreement
from evaluation.estimates.cards import AXES, card_score, has_own_primary, primary_scores
from evaluation.plan.protocol import read_protocol
from evaluation.reporting.board_page import make_board
from evaluation.reporting.cards import place_line
from evaluation.store.cards import CardPlugin, CardScore
from isac_track.errors import DataError
from isac_track.intervals import Estimate
from isac_track.rng import stream

PROTOCOL = read_protocol()


def many_scores(values, *, error=0.01):
    """A card with a score for each value."""
    first = made_up_card()
    further = tuple(
        CardScore("known_share", f"a{n}", value, None, None, error, 50)
        for n, value in enumerate(values)
    )
    scores = first.scores + further
    return replace(first, scores=scores, primary=primary_scores(scores, PROTOCOL))


class TestAgreement:
    def test_equal_numbers_are_equal_whatever_the_machine(self):
        card = made_up_card()
        elsewhere = replace(card, environment={**card.environment, "python": "3.13"})
        assert agreement(card, elsewhere, PROTOCOL).verdict == "equal"

    def test_under_equal_circumstances_the_last_bit_counts(self):
        card = made_up_card()
        other = made_up_card(known=float(np.nextafter(0.3, 1.0)))
        answer = agreement(card, other, PROTOCOL)
        assert answer.verdict == "differs"
        assert "known_share by ou_rts: card 0.3, computed 0.30000000000000004" in (
            answer.reason
        )

    def test_another_seed_agrees_within_its_errors(self):
        card, other = made_up_card(), made_up_card(known=0.32, seed=1)
        answer = agreement(card, other, PROTOCOL)
        assert answer.verdict == "agrees"
        # 0.02 / (0.01 sqrt 2), and the quantile of 1 - 0.05 / 2 / 4.
        assert "at most 1.41 of 2.50 joint standard errors allowed" in answer.reason
        assert "verify with the seed that the card names" in answer.reason
        far = made_up_card(known=0.36, seed=1)
        answer = agreement(card, far, PROTOCOL)
        assert answer.verdict == "differs"
        assert (
            "card 0.3, computed 0.36; 4.2 joint standard errors" in answer.reason
        )  # 0.06 / (0.01 sqrt 2)

    @pytest.mark.parametrize("claimed", [9.0, 0.001, None])
    def test_a_card_cannot_widen_what_it_is_held_to_by_its_own_errors(self, claimed):
        computed = many_scores([0.4])
        card = replace(many_scores([0.5], error=claimed), seed_commitment="another")
        answer = agreement(card, computed, PROTOCOL)
        assert answer.verdict == "differs"
        assert "known_share by a0: card 0.5, computed 0.4" in answer.reason

    def test_holm_holds_over_the_scores_of_a_card(self):
        rng = stream(0, "test", "holm")
        for _ in range(40):
            gaps = rng.normal(0.0, 2.2, 12)
            card = many_scores(np.full(12, 0.1))
            other = many_scores(0.1 + gaps * 0.01 * np.sqrt(2.0))
            other = replace(other, seed=1, seed_commitment="f" * 64)
            all_gaps = np.append(np.abs(gaps), np.zeros(len(made_up_card().scores)))
            p_values = 2.0 * (1.0 - _normal_cdf(all_gaps))
            is_rejected = multipletests(p_values, alpha=0.05, method="holm")[0].any()
            answer = agreement(card, other, PROTOCOL)
            assert (answer.verdict == "differs") == is_rejected

    def test_a_number_without_an_error_must_be_the_same(self):
        card = many_scores([0.5], error=None)
        other = replace(many_scores([0.5001], error=None), seed_commitment="f" * 64)
        assert agreement(card, other, PROTOCOL).verdict == "differs"

    @pytest.mark.parametrize(
        ("name", "changes"),
        [
            ("form of answer", {"form": "state"}),
            ("claim to protect", {"protects": False}),
            ("list of attacks", {"attacks": ()}),
            ("mechanism", {"level": 0.1}),
        ],
    )
    def test_what_a_card_says_of_its_plugins_is_checked(self, name, changes):
        answer = agreement(made_up_card(**changes), made_up_card(), PROTOCOL)
        assert answer.verdict == "differs"
        assert f"its {name} is not" in answer.reason

    def test_another_reader_is_named(self):
        card, other = made_up_card(), many_scores([0.1])
        with pytest.raises(DataError, match="only one of both cards has known_share"):
            agreement(card, other, PROTOCOL)


def _normal_cdf(values):
    from statistics import NormalDist  # noqa: PLC0415 - another library than ours

    return np.array([NormalDist().cdf(value) for value in values])


class TestScores:
    def test_the_best_robot_and_the_strongest_adversary_count(self):
        card = made_up_card(known=0.2, weaker=0.25)
        assert card.primary["known"].by == "log:smooth"
        assert has_own_primary(card, PROTOCOL)
        changed = replace(card, primary={**card.primary, "known": card.scores[2]})
        assert not has_own_primary(changed, PROTOCOL)

    def test_a_share_without_spread_has_the_error_of_its_interval(self):
        estimate = Estimate(0.0, 0.0, 0.098, n=30, replicates=np.zeros(10))
        assert card_score("known_share", "map", estimate).error == pytest.approx(
            0.025, abs=1e-4
        )
        nothing = card_score("known_share", "map", Estimate(np.nan))
        assert (nothing.value, nothing.error) == (None, None)

    def test_a_card_without_a_score_of_an_axis_is_refused(self):
        with pytest.raises(DataError, match="followed_10s"):
            primary_scores(made_up_card().scores[:3], PROTOCOL)


class TestFront:
    def test_it_is_that_of_a_plain_loop(self):
        rng = stream(0, "test", "front")
        cards = [
            made_up_card(
                missed=float(a), known=float(b), followed=float(c), weaker=0.0, seed=n
            )
            for n, (a, b, c) in enumerate(rng.integers(0, 4, (40, 3)) / 4)
        ]
        values = [[card.primary[axis].value for axis in AXES] for card in cards]

        def beats(a, b):
            return all(x <= y for x, y in zip(a, b, strict=True)) and a != b

        expected = [not any(beats(other, own) for other in values) for own in values]
        assert on_front(cards).tolist() == expected
        assert 0 < sum(expected) < len(cards)

    def test_known_and_followed_both_count(self):
        """Less known at more followed is no progress, and neither is the reverse."""
        cards = [
            made_up_card(known=known, followed=followed, weaker=0.0)
            for known, followed in product((0.1, 0.5), (0.1, 0.5))
        ]
        assert on_front(cards).tolist() == [True, False, False, False]
        assert on_front(cards[1:3]).tolist() == [True, True]

    def test_a_flag_is_held_only_against_flags(self):
        """It gives a robot no positions, so that it would beat all that do."""
        flag = made_up_card(known=0.0, followed=0.0, weaker=0.0, form="flag")
        louder = made_up_card(known=0.1, followed=0.0, weaker=0.0, form="flag")
        assert on_front([flag, louder, made_up_card()]).tolist() == [True, False, True]

    def test_a_card_without_a_rival_of_its_form_is_alone(self):
        flag = made_up_card(weaker=0.0, form="flag")
        cards = [made_up_card(), made_up_card(known=0.4), flag]
        placed = standings(cards)
        assert [place.kind for place in placed] == ["front", "beaten", "alone"]
        assert place_line(flag, placed[2]) == (
            f"{flag.label}: alone with its form of answer, nothing to compare"
        )
        finding = make_board(cards).worlds[0].finding
        assert finding.startswith(
            "1 of 3 entries is on the front. ou:0.4 is alone with its form of answer,"
            " nothing to compare."
        )

    def test_a_card_without_a_primary_number_is_not_on_the_front(self):
        card, unknown = made_up_card(), made_up_card(known=0.2)
        nothing = replace(unknown.primary["known"], value=None)
        unknown = replace(unknown, primary={**unknown.primary, "known": nothing})
        assert on_front([card, unknown]).tolist() == [True, False]

    def test_the_clearest_of_those_who_beat_a_card_is_named(self):
        weak = made_up_card(known=0.5, mechanism="weak")  # [0.48, 0.52]
        near = made_up_card(known=0.49, mechanism="near")
        clear = made_up_card(known=0.47, missed=0.3, mechanism="clear")
        own, first = standings([weak, near])
        assert (own.kind, own.beaten_by, own.is_within) == ("beaten", (near,), True)
        assert (first.kind, first.beats) == ("front", (weak,))
        own, *_ = standings([weak, near, clear])
        assert (own.beaten_by, own.is_within) == ((clear, near), False)
        line = place_line(near, standings([weak, near, clear])[1])
        assert line == f"{near.label}: beaten by clear; beats weak (within intervals)"

    def test_a_card_that_met_fewer_attacks_neither_beats_nor_leads(self):
        further = CardPlugin("new", "4" * 64)
        strong = made_up_card(known=0.1, weaker=0.0)
        weak = made_up_card(attacks=(*strong.attacks, further))
        assert on_front([strong, weak]).tolist() == [False, True]
        assert [place.kind for place in standings([strong, weak])] == ["unmet", "alone"]
        met = replace(strong, attacks=weak.attacks)
        assert on_front([met, weak]).tolist() == [True, False]

    def test_a_control_beats_nobody(self):
        control = made_up_card(
            missed=0.0, known=0.0, followed=0.0, weaker=0.0, mechanism="clean",
            protects=False,
        )  # fmt: skip
        assert on_front([control, made_up_card()]).tolist() == [False, True]
        raw = replace(control, mechanism=replace(control.mechanism, spec="raw"))
        assert on_front([raw, made_up_card()]).tolist() == [True, False]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"protocol_version": 2}, "it is of protocol 2, and this board is of 1"),
        ({"protocol_digest": "a" * 64}, "has other values than ours"),
        ({"recording_digest": "a" * 64}, "its recording has the sha256 aaaaaaaaaaaa"),
        ({"recording": "elsewhere"}, "and the protocol's none"),
    ],
)
def test_cards_that_do_not_belong_together_are_refused(changes, message):
    same_board([made_up_card()], PROTOCOL)
    with pytest.raises(DataError, match=message) as error:
        same_board([made_up_card(), made_up_card(**changes)], PROTOCOL)
    assert "\n" not in str(error.value)


def test_digests_are_cut_behind_their_first_difference():
    digest = PROTOCOL.recordings["plaza"]
    other = digest[:30] + ("0" if digest[30] != "0" else "1") + digest[31:]
    card = made_up_card(recording_digest=other)
    with pytest.raises(DataError, match=f"{other[:34]}.*{digest[:34]}"):
        same_board([card], PROTOCOL)
