"""Cards made, made again, verified, and refused: `python -m evaluation.card`."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import pytest
from helpers.cards import SMALL, made_up_card, small_card, small_maker

from evaluation import card as command
from evaluation.api import card_checks, card_entries
from evaluation.api.card_checks import verify_card
from evaluation.api.card_entries import Seed, cross_entries
from evaluation.api.card_maker import CardMaker, make_cards
from evaluation.store.cards import card_text, read_card, write_card
from isac_track.errors import DataError, SettingsError
from isac_track.plugins import parse_all

STRANGER = """
from dataclasses import dataclass

from isac_track.types import derived


@dataclass(frozen=True)
class Coarse:
    grid_m: float = 0.5

    def share(self, sensed, rng):
        from isac_track.sharing import Raw
        release = Raw().share(sensed, rng)
        return derived(release, xy=self.grid_m * (release.xy / self.grid_m).round())
"""


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """A mechanism in a file of its own."""
    (tmp_path / "stranger_coarse.py").write_text(STRANGER, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield "stranger_coarse:Coarse:0.5"
    sys.modules.pop("stranger_coarse", None)


def entries(mechanism="ou:0.4", policy="everything"):
    return cross_entries(["plaza"], ["radial"], [mechanism], [policy])


class TestMaking:
    def test_a_card_names_all_that_it_rests_on(self):
        card = small_card()
        assert card.recording_digest == SMALL.recordings["plaza"]
        assert card.level == 0.4
        assert [item.adversary for item in card.attacks] == ["informed"]
        assert card.environment.keys() == {"isac_track", "python", "numpy", "machine"}
        readers = {score.by for score in card.scores}
        assert {f"log:{name}" for name in SMALL.log} < readers
        assert all(score.n > 0 for score in card.scores)

    def test_a_second_making_keeps_the_file_and_its_bytes(self, tmp_path, monkeypatch):
        def card_again(*_, **__):
            raise AssertionError("it was made before")

        ((_, path),) = make_cards(small_maker(), entries(), folder=tmp_path)
        first = path.read_bytes()
        assert first == card_text(small_card()).encode()
        with monkeypatch.context() as patch:
            patch.setattr(CardMaker, "card", card_again)
            [*make_cards(small_maker(), entries(), folder=tmp_path)]
        assert path.read_bytes() == first
        path.write_bytes(first[:100])  # as a full disk leaves it
        [*make_cards(small_maker(), entries(), folder=tmp_path)]
        assert path.read_bytes() == first

    def test_policies_beside_change_no_number(self, tmp_path):
        both = entries() + entries(policy="ahead:1.2")
        cards = {
            card.policy.spec: card
            for card, _ in make_cards(
                CardMaker(Seed(0), (), SMALL), both, folder=tmp_path
            )
        }
        assert cards["everything"] == small_card()
        assert (
            cards["ahead:1.2"].primary["known"].value
            < cards["everything"].primary["known"].value
        )

    def test_a_stranger_needs_no_change_of_our_tree(self, stranger):
        card = CardMaker(Seed(0), (), SMALL).card(*entries(stranger))
        assert card.mechanism.spec == stranger
        assert verify_card(card, protocol=SMALL).verdict == "equal"

    def test_a_mechanism_that_leaves_samples_out_is_refused(self):
        with pytest.raises(SettingsError, match="give --policy instead"):
            small_maker().check(entries("window:2"))

    def test_the_protocol_names_enough_for_a_board(self):
        named = card_entries.protocol_entries(["plaza"], ["radial"], protocol=SMALL)
        assert len({(e.mechanism.spec, e.policy.spec) for e in named}) == len(named)
        assert len(named) >= 20
        small_maker().check(named)


class TestVerifying:
    def test_the_same_seed_gives_the_same_bits(self):
        assert verify_card(small_card(), protocol=SMALL).verdict == "equal"

    def test_another_seed_agrees(self):
        answer = verify_card(small_card(), seed=Seed(1), protocol=SMALL)
        assert answer.verdict == "agrees"
        assert "another seed" in answer.reason

    @pytest.mark.parametrize("number", [0, 9])
    def test_a_planted_number_is_refused(self, number):
        card = small_card()
        scores = [*card.scores]
        value = scores[number].value
        scores[number] = replace(scores[number], value=value + 1e-9)
        planted = replace(card, scores=tuple(scores))
        answer = verify_card(planted, protocol=SMALL)
        assert answer.verdict == "differs"
        assert not answer.is_confirmed

    def test_another_source_of_a_strangers_plugin_is_refused(self, stranger, tmp_path):
        card = CardMaker(Seed(0), (), SMALL).card(*entries(stranger))
        path = tmp_path / "stranger_coarse.py"
        path.write_text(f"{STRANGER}\n# changed\n", encoding="utf-8")
        with pytest.raises(SettingsError, match="its source has another digest"):
            verify_card(card, protocol=SMALL)

    def test_a_secret_seed_is_bound_but_not_shown(self, tmp_path):
        path = tmp_path / "seed.txt"
        path.write_text("0123456789abcdef0123456789abcdef\n", encoding="utf-8")
        seed = card_entries.read_secret_seed(path)
        card = CardMaker(seed, (), SMALL).card(*entries("raw"))
        assert card.seed is None
        assert str(seed.value) not in card_text(card)
        with pytest.raises(SettingsError, match="--secret-seed FILE"):
            verify_card(card, protocol=SMALL)
        assert verify_card(card, seed=seed, protocol=SMALL).verdict == "equal"

    @pytest.mark.parametrize("text", ["12", "xyz", "0123456789ABCDEF" * 2])
    def test_a_seed_that_can_be_guessed_is_refused(self, text, tmp_path):
        path = tmp_path / "seed.txt"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(DataError, match="32 to 128 lower-case hexadecimal digits"):
            card_entries.read_secret_seed(path)


def test_an_attack_joins_a_card_without_changing_its_numbers():
    maker = CardMaker(Seed(0), parse_all("attacks", ["kalman_rts"]), SMALL)
    card = maker.with_new_attacks(small_card(), *entries())
    whole = maker.card(*entries())
    assert card.scores[: len(small_card().scores)] == small_card().scores
    assert {item.by: item for item in card.scores if item.metric == "known_share"} == {
        item.by: item for item in whole.scores if item.metric == "known_share"
    }


class TestCommand:
    def test_a_changed_card_ends_with_code_1(self, tmp_path, capsys, monkeypatch):
        monkeypatch.setattr(card_checks, "read_protocol", lambda: SMALL)
        path = write_card(small_card(), tmp_path)
        assert command.main(["--verify", str(path)]) == 0
        assert "equal: all numbers are equal bit for bit" in capsys.readouterr().out
        content = json.loads(path.read_text(encoding="utf-8"))
        content["scores"][5]["value"] -= 0.1
        path.write_text(json.dumps(content), encoding="utf-8")
        assert command.main(["--verify", str(path)]) == 1
        assert "NOT CONFIRMED" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--verify", "none.json"], "none.json is missing"),
            (["--verify", "none.json", "--attack", "dtw"], "the card's own attack"),
            (["--dataset", "students3"], "did you mean students03"),
            (["--law", "flat"], "--law 'flat' is not in protocol 1"),
            (["--mechanism", "ou:0.4", "--attack", "dtw"], "a linker runs in"),
            (["--seed", "1", "--secret-seed", "x"], "give either"),
            (["--seed", "-1"], "must not be negative"),
            (["nowhere"], "nowhere holds no run"),
            (["nowhere", "--law", "radial"], "OUT has its own law"),
        ],
    )
    def test_wrong_usage_is_answered_in_a_line(self, words, message, capsys):
        assert command.main(words) == 2
        shown = capsys.readouterr().err
        assert shown.count("\n") == 1
        assert re.search(re.escape(message), shown)

    def test_a_run_of_another_recording_is_refused(self, tmp_path, monkeypatch):
        run = {
            "settings": {"stages": {"sensing.law": "radial"}, "seed": 3,
                         "mechanisms": ["raw", "fid:1"], "policies": ["state"]},
            "dataset": {"name": "mine", "sha256": "0" * 64},
        }  # fmt: skip
        monkeypatch.setattr(card_entries, "read_manifest", lambda _: run)
        with pytest.raises(DataError, match="'mine' is not in protocol 1"):
            card_entries.run_entries(tmp_path, protocol=SMALL)
        run["dataset"]["sha256"] = SMALL.recordings["zara01"]
        found, seed = card_entries.run_entries(tmp_path, protocol=SMALL)
        assert [(e.recording, e.mechanism.spec, e.policy.spec) for e in found] == [
            ("zara01", "raw", "state"),
            ("zara01", "fid:1", "state"),
        ]
        assert seed == 3


@pytest.mark.slow
def test_a_card_of_the_real_protocol_is_verified_by_another_process(tmp_path):
    words = ["--mechanism", "ou:0.4", "--out", str(tmp_path)]
    run = [sys.executable, "-m", "evaluation.card"]
    subprocess.run([*run, *words], check=True)
    (path,) = tmp_path.glob("*.json")
    assert read_card(path).recording == "plaza"
    again = subprocess.run(
        [*run, "--verify", str(path)], check=True, capture_output=True, text=True
    )
    assert "equal" in again.stdout


def test_made_up_cards_are_valid(tmp_path):
    card = made_up_card()
    assert read_card(write_card(card, tmp_path)) == card
