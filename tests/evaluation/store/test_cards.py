"""Files of cards: written and read, and refused in a line if they are none."""

import json
from dataclasses import asdict

import jsonschema
import pytest
from helpers.cards import made_up_card

from evaluation.store.cards import (
    card_schema,
    card_text,
    read_card,
    schema_faults,
    write_card,
)
from isac_track.errors import DataError


def changed(**entries):
    return json.loads(card_text(made_up_card())) | entries


BROKEN = {
    "no scores": ({"scores": None}, "card.scores must be of type array"),
    "a text as a value": (
        {"scores": [{**asdict(made_up_card().scores[0]), "value": "much"}]},
        r"card.scores\[0\].value must be of type number or null",
    ),
    "a short digest": ({"code_digest": "12"}, "card.code_digest must match"),
    "an unknown law": ({"law": "none"}, 'card.law must be "radial" or "isotropic"'),
    "a negative seed": ({"seed": -1}, "card.seed is out of range"),
    "true as a number": ({"level": True}, "card.level must be of type number or null"),
    "an entry of its own": ({"extra": 1}, 'card has an unknown entry "extra"'),
}


def test_a_card_is_the_same_after_writing_and_reading(tmp_path):
    card = made_up_card()
    path = write_card(card, tmp_path / "new")
    assert read_card(path) == card
    assert path.read_text(encoding="utf-8") == card_text(card)


def test_names_of_files_differ_where_entries_do():
    cards = [
        made_up_card(mechanism=mechanism, policy=policy, seed=seed)
        for mechanism in ("fid:1", "fid-1", "fid:1,adding=independent")
        for policy in ("everything", "ahead:1.2")
        for seed in (0, 1)
    ]
    assert len({card.file_name for card in cards}) == len(cards)
    assert all("/" not in card.file_name for card in cards)


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_card_is_refused_in_a_line(name, tmp_path):
    entries, message = BROKEN[name]
    path = tmp_path / "card.json"
    path.write_text(json.dumps(changed(**entries)), encoding="utf-8")
    with pytest.raises(DataError, match=message) as error:
        read_card(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("entries", [{}, *(entries for entries, _ in BROKEN.values())])
def test_our_check_agrees_with_jsonschema(entries):
    content = changed(**entries)
    validator = jsonschema.Draft202012Validator(card_schema())
    assert validator.is_valid(content) == (not [*schema_faults(content, card_schema())])


def test_a_missing_entry_is_named():
    content = changed()
    del content["policy"]
    assert [*schema_faults(content, card_schema())] == ["card has no policy"]


def test_a_number_that_is_read_as_infinite_is_refused(tmp_path):
    path = tmp_path / "card.json"
    text = json.dumps(changed())
    number = json.dumps(changed()["scores"][0]["value"])
    path.write_text(text.replace(f'"value": {number}', '"value": 1e999', 1))
    with pytest.raises(
        DataError, match=r"scores\[0\]\.value is out of range: Infinity"
    ):
        read_card(path)


@pytest.mark.parametrize("text", ["", "[", '{"level": NaN}', "[" * 5000])
def test_a_file_that_is_no_json_is_refused(text, tmp_path):
    path = tmp_path / "card.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match="cannot be read as a card"):
        read_card(path)
