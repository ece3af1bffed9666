"""The verdict in worlds in which the truth is planted, and as a file and in words."""

import json
from collections import Counter

import numpy as np
import pytest
from helpers.pages import tells_rows_apart
from helpers.planted_worlds import KINDS, TASK, World, run, said_of, simulated

from evaluation.reporting.answer_tables import item_tables
from evaluation.verdict import rules
from evaluation.verdict.sections import to_bytes


@pytest.fixture(scope="module")
def planted():
    return {
        kind: run(World(kind, n_people=3000), seed=0)
        for kind in KINDS
        if kind != "empty"
    }


@pytest.fixture(scope="module")
def said():
    return run(World("fooled", n_people=400), seed=3)


@pytest.fixture(scope="module")
def strangers():
    found, levels = simulated(
        World("valid", stranger=True), rng=np.random.default_rng(13)
    )
    return said_of(found, {TASK: levels})


def items_of(said, section):
    return [one for one in said["items"] if one["section"] == section]


class TestPlantedTruths:
    """What the verdict says where the truth is known; 3,000 people, so that it can be seen."""

    @pytest.mark.parametrize(
        ("kind", "section", "must", "may"),
        [
            ("valid", "validity", {"tracks"}, {"between"}),
            ("valid", "within", {"tracks"}, set()),
            ("fooled", "validity", {"does not track"}, set()),
            ("fooled", "within", {"does not track"}, set()),
            ("flat", "validity", {"not testable"}, set()),
            ("flat", "within", {"does not track"}, set()),
            # The advantage of FID was planted as well.
            ("valid", "claim", {"holds"}, {"between"}),
            ("fooled", "claim", {"holds"}, {"between"}),
            ("valid", "inflation", {"inflated"}, set()),
        ],
    )
    def test_is_found(self, planted, kind, section, must, may):
        decisions = {one["decision"] for one in items_of(planted[kind], section)}
        assert must <= decisions <= must | may

    def test_what_speaks_against_is_named_and_measured(self, planted):
        worst = items_of(planted["fooled"], "validity")[0]
        # 0.75 - (0.75 - 1.2 * 0.4 * 0.8) = 0.38 for correlated; offset is so by
        # construction, and no evidence
        assert worst["spread_low"] < 0.38 < worst["spread_high"]
        assert worst["evidence"] == ["shown"]
        assert "correlated 0.75 lets" in worst["sentence"]
        for one in items_of(planted["valid"], "inflation"):
            assert one["effect"] == pytest.approx(1.5, abs=0.02)

    @pytest.mark.slow
    def test_where_nothing_has_an_effect_nothing_is_decided(self):
        """5 % by the rules; at 9 % of 200 it is no longer chance."""
        wrong = 0
        for seed in range(200):
            said = run(World("empty", n_people=80), seed=seed)
            wrong += any(one["sign"] for one in said["items"])
        assert wrong <= 18


class TestVerdict:
    def test_every_item_is_whole_and_plain_under_either_rule(self, said):
        names = [one["id"] for one in said["items"]]
        assert len(names) == len(set(names))
        assert {
            "validity/linear/plr/rerelease",
            "claim/independent/missed/as-shared/mel",
        } < {*names}
        for one in said["items"]:
            assert (
                one["ci_low"] <= one["effect"] <= one["ci_high"]
                or one["section"] == "claim"
            )
            assert one["n"] == 200
            assert one["sentence"].endswith(".")
            assert bool(one["why"]) == (not one["sign"])
            assert one["sign"] == rules.SIGN[one["decision"]]
        assert json.loads(to_bytes(said)) == json.loads(json.dumps(said))
        found = Counter((one["section"], one["adding"]) for one in said["items"])
        for section in rules.SECTIONS:
            assert found[section, "linear"] == found[section, "independent"] > 0

    def test_the_tables_hold_every_item_and_say_which_one_a_row_is(self, strangers):
        tables = item_tables(strangers["items"])
        assert sum(len(one.rows) for one in tables.values()) == len(strangers["items"])
        assert all(map(tells_rows_apart, tables.values()))

    def test_a_mechanism_of_somebody_elses_is_judged_like_fid(self, strangers):
        items = [one for one in strangers["items"] if one.get("mechanism") == "mine:Ou"]
        assert {one["section"] for one in items} == {"claim"}
        names = {one["id"] for one in items}
        ids = {one["id"] for one in items_of(strangers, "claim")}
        assert names == {f"{one}/mine:Ou" for one in ids - names}
        assert all("under mine:Ou" in one["sentence"] for one in items if one["sign"])
        inflated = [
            one["id"] for one in strangers["items"] if one["id"].endswith("mine:Ou/plr")
        ]
        assert inflated == [
            f"inflation/{rule}/mine:Ou/plr" for rule in ("linear", "independent")
        ]
        assert {one["levels"] for one in items_of(strangers, "within")} == {
            1 + 4 + 3 + 4
        }
        for one in items_of(strangers, "validity"):
            assert "mine:Ou" in {gap["mechanism"] for gap in one["contrasts"]}

    def test_a_run_without_linkage_or_attack_says_so(self):
        found, _ = simulated(World("valid"), rng=np.random.default_rng(12))
        said = said_of(
            {key: one for key, one in found.items() if not key.knowledge}, {}
        )
        assert {one["section"] for one in said["items"]} == {"claim"}
        empty = said_of({}, {})
        assert empty["items"] == []
