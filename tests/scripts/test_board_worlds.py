"""The table of a board over worlds: scores, fronts, and what beats a reference."""

import board_worlds
from helpers.cards import made_up_card

CARDS = (
    made_up_card(missed=0.3, known=0.9, mechanism="raw", protects=False),
    made_up_card(missed=0.4, known=0.5, mechanism="ou:0.4"),
    made_up_card(missed=0.35, known=0.4, mechanism="shaped:0.2"),
    made_up_card(missed=0.1, known=1.0, mechanism="clean", protects=False),
)


def test_an_entry_has_its_scores_its_fronts_and_what_it_beats():
    lines = list(board_worlds.law_table(CARDS, against="ou:0.4"))
    assert lines[0] == "| entry | plaza | on the front | better than ou:0.4 |"
    assert lines[2:] == [
        "| `raw` | 30 / 90 | 1 of 1 | 0 |",
        "| `ou:0.4` | 40 / 50 | 0 of 1 |  |",
        "| `shaped:0.2` | 35 / 40 | 1 of 1 | 1 |",
        "| `clean` | 10 / 100 | control | 0 |",
    ]
