"""The cards that stand in the repository: anybody can compute them again."""

from pathlib import Path

import pytest

from evaluation.api.card_checks import load_cards, verify_card
from evaluation.api.card_entries import card_entry, read_secret_seed
from evaluation.plan.protocol import read_protocol
from evaluation.store.cards import card_text, read_card

FOLDER = Path(__file__).parents[2] / "docs" / "results" / "cards"
PUBLIC = sorted(FOLDER.rglob("*.json"))


@pytest.mark.parametrize("path", PUBLIC, ids=lambda path: path.stem)
def test_a_public_card_is_of_the_protocol_as_it_is(path):
    card, protocol = read_card(path), read_protocol()
    assert card_text(card).encode() == path.read_bytes()
    assert path.name == card.file_name
    assert path.stat().st_size < 30_000
    assert card.protocol_digest == protocol.digest
    assert card.recording_digest == protocol.recordings[card.recording]
    assert {*protocol.attacks} <= {attack.spec for attack in card.attacks}
    assert card_entry(card).mechanism.spec == card.mechanism.spec


def test_public_cards_make_a_board():
    cards = load_cards([FOLDER]).values()
    assert {card.recording for card in cards} == {"plaza"}
    assert {"raw", "ou:0.4", "shaped:0.2"} <= {card.mechanism.spec for card in cards}


def test_the_published_seed_is_that_of_the_cards_made_in_secret():
    seed = read_secret_seed(FOLDER / "final" / "seed.txt")
    cards = [read_card(path) for path in (FOLDER / "final").glob("*.json")]
    assert {card.seed_commitment for card in cards} == {
        seed.commitment(read_protocol())
    }
    assert all(card.seed is None for card in cards)


@pytest.mark.slow  # 20 s
def test_a_public_card_is_confirmed():
    (path,) = FOLDER.glob("plaza-radial-ou-0.4-*.json")
    assert verify_card(read_card(path)).is_confirmed
