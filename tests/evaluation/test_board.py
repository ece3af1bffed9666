"""The board: its page, new attacks on it, new mechanisms, and cards that do not fit."""

import re
import sys
from dataclasses import replace
from functools import partial

import pytest
from helpers.cards import SMALL, made_up_card, score, small_card

from evaluation import board as command
from evaluation.api import board as api_board
from evaluation.api import card_checks
from evaluation.api.board import (
    AttackedCard,
    attack_cards,
    join_mechanisms,
    write_board,
)
from evaluation.api.card_checks import load_cards, verify_card
from evaluation.api.card_entries import Seed, cross_entries
from evaluation.api.card_maker import CardMaker
from evaluation.estimates.cards import primary_scores
from evaluation.plan.protocol import read_protocol
from evaluation.reporting.board_page import make_board, render
from evaluation.reporting.cards import attack_line
from evaluation.store.cards import CardPlugin, card_text, read_card, write_card
from isac_track.errors import DataError, SettingsError

DIGITS = "attacks.reconstruction.low_digits:LowDigits"
WATERMARK = "helpers.watermarks:Watermark:0.8"
ATTACK = """
from dataclasses import dataclass
from typing import ClassVar

from isac_track.types import Reconstruction


@dataclass(frozen=True)
class Still:
    requires: ClassVar[frozenset] = frozenset()
    uses: ClassVar[frozenset] = frozenset()

    def fit(self, context):
        return lambda release: Reconstruction(release.xy, None)
"""


def small_board():
    """Cards of one world: raw, a policy, and a mechanism that hides the place."""
    return [small_card("raw"), small_card("raw", "ahead:1.2"), small_card(WATERMARK)]


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """An attack in a file of its own."""
    (tmp_path / "stranger_still.py").write_text(ATTACK, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "stranger_still:Still"
    sys.modules.pop("stranger_still", None)


class TestPage:
    CARDS = (
        made_up_card(missed=0.3, known=0.9, weaker=0.8, mechanism="raw", protects=False),
        made_up_card(missed=0.4, known=0.5, mechanism="ou:0.4"),
        made_up_card(missed=0.5, known=0.6, mechanism="fid:1"),
        made_up_card(missed=0.1, known=1.0, mechanism="clean", protects=False),
        made_up_card(known=0.3, seed=1),
    )  # fmt: skip

    def test_each_entry_has_its_place(self):
        worlds = make_board(self.CARDS).worlds
        assert [len(world.entries) for world in worlds] == [4, 1]
        rows = {row[0].text: row[3].text for row in worlds[0].table.rows}
        assert rows == {
            "raw": "front",
            "ou:0.4": "front",
            "fid:1": "beaten by ou:0.4",
            "clean": "control",
        }
        marks = {
            name.partition(":  ")[0]: look.hollow
            for look, _, name in worlds[0].figure.panels[0][1].marks
        }
        hollow = {
            name.partition(",")[0] for name, is_hollow in marks.items() if is_hollow
        }
        assert hollow == {"fid:1", "clean"}

    def test_a_world_of_a_single_entry_compares_nothing(self):
        first, second = make_board(self.CARDS).worlds
        assert first.finding.startswith("2 of 4 entries are on the front.")
        assert second.finding.startswith(
            "ou:0.4 is alone in this world, nothing to compare. The strongest"
        )
        assert second.table.rows[0][3].text == "alone"
        pair = (self.CARDS[1], self.CARDS[2])
        finding = make_board(pair).worlds[0].finding
        assert finding.startswith("1 of 2 entries is on the front.")

    def test_an_entry_that_has_not_met_an_attack_is_marked(self):
        raw, ou, fid, *_ = self.CARDS
        further = CardPlugin("my.module:Mine", "4" * 64, adversary="informed")
        met = [replace(card, attacks=(*card.attacks, further)) for card in (ou, fid)]
        table = make_board([raw, *met]).worlds[0].table
        rows = {row[0].text: row[3].text for row in table.rows}
        assert rows["raw"] == "has not met Mine"
        assert rows["ou:0.4"] == "front"
        (note,) = table.notes
        assert note == (
            "1 entry of 3 has not met Mine, and stays off the front. This fills the"
            " gap: python -m evaluation.board --attack my.module:Mine CARDS"
        )

    def test_a_look_does_not_depend_on_other_entries(self):
        stranger = made_up_card(mechanism="a_first:Mine")

        def look(cards, name):
            return make_board(cards).worlds[0].figure.key[name]

        ou, ahead = self.CARDS[1], made_up_card(mechanism="raw", policy="ahead:1.2")
        for name in ("ou", "raw, ahead"):
            assert look([ou, ahead], name) == look([stranger, ahead, ou], name)

    def test_everybody_followed_is_said_only_where_it_is_so(self):
        noises = [
            made_up_card(followed=0.9),
            made_up_card(mechanism="fid:1", followed=0.8),
        ]
        said = "Every noise alone leaves 80 % or more"
        assert said in make_board(noises).worlds[0].finding
        assert "Every noise" not in make_board(self.CARDS).worlds[0].finding

    def test_links_lead_somewhere_and_nothing_is_fetched(self, tmp_path):
        page = write_board(self.CARDS, tmp_path / "board")
        text = page.read_text(encoding="utf-8")
        names = set(re.findall(r' id="([^"]+)"', text))
        targets = set(re.findall(r'href="#([^"]+)"', text))
        assert targets <= names
        assert len(targets) == 2 + len(self.CARDS)
        for name in re.findall(r'href="(cards/[^"]+)"', text):
            assert read_card(page.parent / name) in self.CARDS
        assert not re.findall(r'(?:src|href)="(?:https?:)?//', text)
        figures = sorted(item.name for item in page.parent.glob("*.svg"))
        assert len(figures) == 2
        tables = (page.parent / "board.md").read_text(encoding="utf-8")
        assert tables.count("| everything |") == len(self.CARDS)

    def test_the_strongest_reader_of_an_entry_comes_first(self):
        entry = make_board(self.CARDS[:1]).worlds[0].entries[0]
        assert entry.sentence.startswith("ou_rts knows most: 90.0 %")
        assert [row[0].text for row in entry.table.rows[:2]] == ["ou_rts", "log:smooth"]

    def test_a_name_cannot_write_html(self):
        card = made_up_card(mechanism='my:Mine:"><script>alert(1)</script>')
        assert "<script>alert" not in render(make_board([card]))

    def test_a_message_in_the_digits_is_said(self):
        card = small_card(WATERMARK)
        text = render(make_board([card]))
        assert "hide a message" in text
        assert "the release hides a message" in text

    def test_an_empty_board_is_refused(self, tmp_path):
        with pytest.raises(DataError, match="needs a card"):
            write_board([], tmp_path)


class TestAttack:
    def test_a_new_attack_meets_every_card_and_says_what_it_breaks(self, tmp_path):
        cards = small_board()
        met = list(attack_cards(cards, [DIGITS], folder=tmp_path, protocol=SMALL))
        broken = [item for item in met if item.verdict == "broken"]
        assert [item.after.mechanism.spec for item in broken] == [WATERMARK]
        for item in met:
            assert item.after.attacks[-1].spec == DIGITS
            assert item.after.scores[: len(item.before.scores)] == item.before.scores
            assert [score.by for score in item.new_scores] == [DIGITS]
        assert broken[0].after.primary["known"].by == DIGITS

    def test_a_rise_within_the_interval_breaks_nothing(self):
        def met(known):
            new = score(known, by="new")
            scores = (*before.scores, new)
            return AttackedCard(
                before,
                replace(
                    before,
                    scores=scores,
                    primary=primary_scores(scores, read_protocol()),
                    attacks=(*before.attacks, CardPlugin("new", "4" * 64)),
                ),
            )

        before = made_up_card(known=0.3)  # [0.28, 0.32]
        words = {0.29: "stands", 0.31: "slightly more known", 0.33: "broken"}
        assert {known: met(known).verdict for known in words} == words
        item = met(0.29)
        line = attack_line(
            before, item.after, verdict=item.verdict, own=item.new_scores
        )
        assert line.endswith(
            "stands at 30.0 % [28.0, 32.0] known by ou_rts;"
            " new knows 29.0 % [27.0, 31.0]"
        )

    def test_an_interrupted_attack_continues(self, tmp_path, monkeypatch):
        cards = small_board()
        met = attack_cards(cards, [DIGITS], folder=tmp_path, protocol=SMALL)
        first = next(met)
        (path,) = tmp_path.glob("*.json")
        assert read_card(path) == first.after
        computed = []
        attacked = CardMaker.with_new_attacks

        def counted(self, card, entry):
            computed.append(card.file_name)
            return attacked(self, card, entry)

        monkeypatch.setattr(CardMaker, "with_new_attacks", counted)
        again = list(attack_cards(cards, [DIGITS], folder=tmp_path, protocol=SMALL))
        assert again[0].after == first.after
        assert again[0].before == first.before
        assert len(again) == 3
        assert first.after.file_name not in computed
        assert len(computed) == 2

    def test_cards_that_have_met_an_attack_show_the_same_again(self, tmp_path):
        """As if the board's own folder were attacked, and interrupted at its end."""
        cards = small_board()
        met = list(attack_cards(cards, [DIGITS], folder=tmp_path, protocol=SMALL))
        cards = [item.after for item in met]
        again = list(attack_cards(cards, [DIGITS], folder=tmp_path, protocol=SMALL))
        assert [item.verdict for item in again] == [item.verdict for item in met]
        assert [item.before for item in again] == [item.before for item in met]

    def test_a_card_with_other_numbers_is_not_taken_for_the_new_one(self, tmp_path):
        (item,) = attack_cards(
            [small_card("raw")], [DIGITS], folder=tmp_path, protocol=SMALL
        )
        changed = replace(item.after.scores[0], value=0.123)
        write_card(
            replace(item.after, scores=(changed, *item.after.scores[1:])), tmp_path
        )
        (again,) = attack_cards(
            [small_card("raw")], [DIGITS], folder=tmp_path, protocol=SMALL
        )
        assert again.after == item.after

    def test_a_card_that_met_a_new_attack_is_verified(self, stranger, tmp_path):
        (item,) = attack_cards(
            [small_card("raw")], [stranger], folder=tmp_path, protocol=SMALL
        )
        assert verify_card(item.after, protocol=SMALL).verdict == "equal"

    def test_a_card_of_other_code_is_computed_anew(self, tmp_path):
        other = replace(small_card("raw"), code_digest="0" * 64)
        changed = replace(
            other.scores[0], value=0.123, ci_low=None, ci_high=None, error=None
        )
        other = replace(other, scores=(changed, *other.scores[1:]))
        (item,) = attack_cards([other], [DIGITS], folder=tmp_path, protocol=SMALL)
        assert item.after.scores[0] == small_card("raw").scores[0]
        assert item.after.code_digest == small_card("raw").code_digest

    def test_a_linker_is_refused(self, tmp_path):
        with pytest.raises(SettingsError, match="a linker runs in"):
            list(
                attack_cards(
                    [small_card("raw")], ["dtw"], folder=tmp_path, protocol=SMALL
                )
            )


class TestMechanism:
    def test_a_new_mechanism_meets_every_attack_of_the_board(self, stranger, tmp_path):
        (item,) = attack_cards(
            [small_card("raw")], [stranger], folder=tmp_path, protocol=SMALL
        )
        (card,) = join_mechanisms(
            [item.after], ["ou:0.4"], ["everything"], folder=tmp_path, protocol=SMALL
        )
        assert read_card(tmp_path / card.file_name) == card
        assert [attack.spec for attack in card.attacks] == ["ou_rts", stranger]
        own = [score for score in card.scores if score.by != stranger]
        assert tuple(own) == small_card("ou:0.4").scores

    def test_a_secret_world_needs_its_seed(self, tmp_path):
        seed = Seed(2**120, is_secret=True)
        card = replace(
            small_card("raw"), seed=None, seed_commitment=seed.commitment(SMALL)
        )
        join = partial(join_mechanisms, folder=tmp_path, protocol=SMALL)
        with pytest.raises(SettingsError, match="give the file of its seed"):
            list(join([card], ["ou:0.4"], ["everything"]))
        (new,) = join([card], ["raw"], ["everything"], seeds=[seed])
        assert new.seed_commitment == card.seed_commitment
        (entry,) = cross_entries(["plaza"], ["radial"], ["raw"], ["everything"])
        assert new == CardMaker(seed, (), SMALL).card(entry)


class TestCommand:
    @pytest.fixture
    def folder(self, tmp_path, monkeypatch):
        for module in (api_board, card_checks):
            monkeypatch.setattr(module, "read_protocol", lambda: SMALL)
        for card in (small_card("raw"), small_card(WATERMARK)):
            write_card(card, tmp_path / "cards")
        return tmp_path / "cards"

    def test_an_attack_by_one_command(self, folder, tmp_path, capsys):
        out = tmp_path / "board"
        words = ["--attack", DIGITS, str(folder), "--out", str(out)]
        assert command.main(words) == 0
        captured = capsys.readouterr()
        assert "Broken: 1 of 2 entries. Slightly more known" in captured.out
        assert "stands at 9" in captured.out
        assert captured.err.startswith("1 of 2 cards, 0:0")
        assert len(load_cards([out / "cards"], protocol=SMALL)) == 2
        assert (out / "index.html").is_file()

    def test_a_mechanism_by_one_command(self, folder, tmp_path, capsys):
        out = tmp_path / "board"
        words = ["--mechanism", "ou:0.4", str(folder), "--out", str(out)]
        assert command.main(words) == 0
        shown = capsys.readouterr().out
        assert "ou:0.4, everything, plaza" in shown
        assert re.search("seed 0: (on the front|beaten by .+); beats ", shown)
        assert len(load_cards([out / "cards"], protocol=SMALL)) == 3

    def test_two_cards_of_an_entry_are_refused(self, folder, tmp_path, capsys):
        copy = tmp_path / "copy.json"
        copy.write_text(card_text(small_card("raw")), encoding="utf-8")
        assert command.main([str(folder), str(copy)]) == 2
        assert "are both of raw, everything, plaza" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"protocol_version": 2}, "it is of protocol 2, and this board is of 1"),
            ({"recording_digest": "a" * 64}, "its recording has the sha256 aaaaaaaa"),
        ],
    )
    def test_cards_that_do_not_fit_are_refused_in_a_line(
        self, changes, message, folder, capsys
    ):
        write_card(replace(small_card("ou:0.4"), **changes), folder)
        assert command.main([str(folder)]) == 2
        shown = capsys.readouterr().err
        assert message in shown
        assert shown.count("\n") == 1

    def test_a_changed_primary_score_is_refused(self, folder, capsys):
        card = small_card("ou:0.4")
        known = replace(card.primary["known"], value=0.01)
        write_card(replace(card, primary={**card.primary, "known": known}), folder)
        assert command.main([str(folder)]) == 2
        assert "the card was changed" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["none"], "none is missing"),
            (["none", "--policy", "state"], "--policy goes with --mechanism"),
            (["none", "--attack", "a", "--mechanism", "b"], "first the one"),
        ],
    )
    def test_wrong_usage_is_answered_in_a_line(self, words, message, capsys):
        assert command.main(words) == 2
        assert message in capsys.readouterr().err


def test_the_small_protocol_is_the_real_one_on_less_time():
    assert SMALL.version == read_protocol().version
