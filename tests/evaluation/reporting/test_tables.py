"""What the tables of a run say: the numbers of its frames, and what is to be doubted."""

import io
import re
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import (
    ATTACKS,
    CHANCE,
    ITEM,
    RATIOS,
    STRONGEST,
    UNITS,
    VERDICT,
    emptied,
    levels,
    make_flags,
    make_linkability,
    make_matched,
    make_run,
    make_summary,
    rows_where,
)
from rich.console import Console

from evaluation.analysis.families import families_in
from evaluation.analysis.keys import Source
from evaluation.analysis.linkability import linked_tasks
from evaluation.reporting import tables
from evaluation.reporting.answer_tables import (
    claims_table,
    contrast_table,
    effect,
    item_tables,
    matched_table,
    paper_table,
    short_tables,
)
from evaluation.reporting.markup import markdown
from evaluation.reporting.result_tables import (
    attack_table,
    cells_table,
    doubt_table,
    exposure_table,
    rank_table,
    sweep_tables,
)
from evaluation.reporting.rows import telling
from isac_track.errors import DataError

HEADLINE = (("fid", (1.0, 1000.0)), ("fixed", (0.7, 1.0)))
STRANGER = [*levels(swept=HEADLINE, others=[]), *[("ou", at) for at in (0.2, 0.4, 0.8)]]
TOLD = ["clean", "raw", "fid 1", "fid 1000", "fixed 0.7", "fixed 1"]


def shown(run, *, width=200):
    raw = io.StringIO()
    tables.show(run, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


def heads(table):
    return [column.head for column in table.columns]


def row_of(table, *start):
    """The cells of the row that starts so, behind what it starts with."""
    (row,) = [row for row in table.rows if tuple(cell.text for cell in row[: len(start)]) == start]
    return row[len(start) :]


def texts(table):
    return [[cell.full for cell in row] for row in table.rows]


def ranks(frame=None, people=MappingProxyType({})):
    frame = make_linkability() if frame is None else frame
    run = make_run(at=[*STRANGER, *levels()], linkability=frame)
    run.manifest["linkage"]["tasks"] = people
    return rank_table(run, linked_tasks(frame)[0])


def with_interval(row, *, name="value", scale=100, digits=1):
    """A number as a table shows it."""
    value, low, high = (f"{scale * row[one]:.{digits}f}" for one in (name, "ci_low", "ci_high"))
    return f"{value} [{low}, {high}]"


class TestTheTerminal:
    def test_it_says_what_was_run_and_shows_every_table(self):
        text = shown(make_run())
        assert text.splitlines()[0] == "students03: 106 of 428 tracks used, 500 scenes, seed 3"
        order = [
            "All levels as shared, predictor least_squares", "After attack: PLR", "After attack, ",
            "rerelease: one walk", "The paper's numbers", "The paper's claims", "split is left out",
            "Verdict", "- The first sentence.", "Do the descriptors tell",
        ]  # fmt: skip
        places = [text.index(words) for words in order]
        assert places == sorted(places)
        assert "too few [red]people[/red]" in text
        assert "NOTICE" not in text
        assert "flag" not in text
        assert max(map(len, shown(make_run(), width=60).splitlines())) <= 60

    def test_notices_flags_slow_attacks_and_at_last_failed_cells_are_told(self):
        row = {"spec": "fid:1", "kind": "attack", "consumer": "mine", "knowledge": "blind"}
        failed = pd.DataFrame([row | {"block": 0, "why": "it broke"}])
        run = make_run(flags=make_flags(), failed=failed)
        run.manifest["dataset"]["simulated"] = True
        run.manifest["cells"] = [{"consumer": "kalman_rts", "slow": True}, {}]
        text = shown(run)
        assert "NOTICE: the tracks are simulated" in text
        assert "flag: radial_rts (informed) is beaten by radial_rts (blind) at 1 of 47 lev" in text
        assert "kalman_rts saw only the first release" in text
        last = "failed: mine (blind) at fid:1: it broke; left out everywhere"
        assert text.splitlines()[-1] == last
        run.manifest["dataset"]["notice"] = "a stand-in"
        assert "NOTICE: a stand-in" in shown(run)

    def test_an_empty_run_is_shown(self):
        run = make_run(**emptied(make_run()), verdict={})
        assert not re.search("mechanism|Verdict", shown(run))
        assert tables.page_tables(run) == {}


@pytest.mark.parametrize(
    ("at", "controls", "told"),
    [
        (levels(rules=("",)), False, TOLD),
        (levels(rules=("",)), True, ["offset 0.4", "thin:d_sigma=0.75 4", *TOLD]),
        (STRANGER, True, [*TOLD, "ou 0.2", "ou 0.8"]),
        ([("raw", np.nan), *[("fid", at) for at in (3.0, 20.0, 50.0)]], True,
         ["raw", "fid 3", "fid 20", "fid 50"]),
    ],
)  # fmt: skip
def test_levels_that_tell_are_those_of_the_headline_or_all(at, controls, told):
    wheres = [(name, None if np.isnan(level) else level) for name, level in at]
    found = telling(wheres, families_in(make_summary(at)), controls=controls)
    rest = [(name, level) for name, level in found if "=indep" not in name and "corr" not in name]
    names = [f"{name} {'' if level is None else f'{level:g}'}".strip() for name, level in rest]
    assert sorted(names) == sorted(told)
    assert names[:2] == told[:2] or controls


class TestTheSweep:
    def test_it_shows_the_numbers_of_the_frame_with_intervals(self):
        frame = make_summary()
        (table,) = sweep_tables(frame)
        raw = frame[rows_where(frame, mechanism="raw", knowledge="")].set_index("metric")
        for cell, metric in zip(row_of(table, "raw", "", ""), list(UNITS)[:6], strict=True):
            scale, digits = (100, 1) if UNITS[metric] == "fraction" else (1, 3 - (metric[0] == "d"))
            assert cell.full == with_interval(raw.loc[metric], scale=scale, digits=digits)
        assert heads(table)[-3:] == ["PLR, shared (%)", "AEL, shared (s)", "MEL, shared (s)"]
        assert len(table.rows) == len(levels())

    def test_a_strangers_mechanism_is_a_row_like_any_other(self):
        (table,) = sweep_tables(make_summary(STRANGER))
        assert [row[2].text for row in table.rows if row[0].text == "ou"] == ["0.2", "0.4", "0.8"]
        assert row_of(table, "fid", "independent", "1000")
        assert row_of(table, "ou", "", "0.2")

    def test_each_further_predictor_has_a_table_of_its_own_and_attacks_change_none(self):
        names = ("least_squares", "kalman_cv")
        odd = [*ATTACKS, ("least_squares", "informed"), ("shared", "blind")]
        first, second = sweep_tables(make_summary(predictors=names, attacks=odd))
        plain = sweep_tables(make_summary(predictors=names, attacks=()))
        assert [texts(first), texts(second)] == [texts(one) for one in plain]
        assert "predictor least_squares" in first.title
        assert "predictor kalman_cv" in second.title
        assert "MEL, shared (s)" not in heads(second)
        (alone,) = sweep_tables(make_summary(predictors=()))
        assert "predictor" not in alone.title

    def test_near_levels_are_not_merged_and_missing_values_do_not_stop_it(self):
        frame = make_summary()
        frame["level"] = frame["level"].replace({1000.0: 1.00001})
        frame.loc[frame["metric"] == "mel", "value"] = np.nan
        frame[["ci_low", "ci_high"]] = np.nan
        (table,) = sweep_tables(frame)
        assert [row[2].text for row in table.rows if row[0].text == "fid"] == ["1"] * 4
        assert row_of(table, "raw", "", "")[-1].full == ""


class TestAfterAttack:
    def test_plr_is_that_of_who_knows_most_short_of_the_oracle(self):
        frame = make_summary()
        table = exposure_table(frame)
        known = [ATTACKS[n] for n in (0, 2, 4, 6, 9, 10)]
        assert heads(table)[3:] == ["shared", *(f"{name} ({knows})" for name, knows in known)]
        plr = frame[rows_where(frame, mechanism="raw", metric="plr")]
        plr = plr.set_index(["consumer", "knowledge"])
        for cell, key in zip(row_of(table, "raw", "", ""), [("shared", ""), *known], strict=True):
            assert cell.full == with_interval(plr.loc[key])
        assert len(table.rows) == len(levels())
        assert "The oracle is a reference" in " ".join(table.notes)
        assert not exposure_table(make_summary(attacks=ATTACKS[:3])).notes

    def test_every_attack_and_adversary_is_shown_at_the_levels_that_tell(self):
        frame = make_summary()
        table = attack_table(frame)
        where = {tuple(cell.text for cell in row[:3]) for row in table.rows}
        assert len(where) == 2 + 2 * 4 + 4
        of = {(row[3].text, row[4].text) for row in table.rows}
        assert of == {("as shared", ""), *ATTACKS[1:]}  # the control says what was shared
        raw = frame[rows_where(frame, mechanism="raw", consumer="averaging")].set_index("metric")
        digits = dict(zip([*list(UNITS)[3:], *RATIOS], (1, 3, 3, 3, 2, 2), strict=True))
        cells = row_of(table, "raw", "", "", "averaging", "oracle")
        for cell, (metric, places) in zip(cells, digits.items(), strict=True):
            value = raw.loc[metric, "value"] * (100 if metric == "plr" else 1)
            assert cell.text == f"{value:.{places}f}"

    def test_a_control_that_differs_is_shown_and_equal_adversaries_share_a_row(self):
        frame = make_summary()
        frame.loc[frame["consumer"] == "identity", "value"] += 0.1
        frame.loc[frame["consumer"] == "savgol", ["value", "ci_low", "ci_high"]] = 0.5
        last = frame[rows_where(frame, consumer="radial_rts", knowledge="informed")]
        table = attack_table(pd.concat([frame, last.assign(knowledge="oracle")]))
        of = {(row[3].text, row[4].text) for row in table.rows}
        assert {("identity", "blind"), ("radial_rts", "informed, oracle"), ("savgol", "any")} <= of

    def test_without_attacks_nothing_is_shown_and_missing_values_do_not_stop_it(self):
        alone = make_summary(attacks=())
        assert not exposure_table(alone).rows
        assert not attack_table(alone).rows
        frame = make_summary()
        frame.loc[frame["knowledge"] != "", ["value", "ci_low", "ci_high"]] = np.nan
        part = frame[(frame["knowledge"] == "") | (frame["mechanism"] == "fid")]
        for one in (frame, part):
            assert {c.full for c in row_of(exposure_table(one), "raw", "", "")[1:]} == {""}


class TestLinkage:
    def test_a_row_is_who_knows_most_of_an_attack_at_the_levels_that_tell(self):
        frame = make_linkability(tasks={"rerelease": {"shape": 0.4, "dtw": 0.3, "a@b": 0.2}})
        frame = frame[(frame["knowledge"] == "oracle") | ~frame["consumer"].str.contains("@")]
        table = ranks(frame)
        assert [row[0].text for row in table.rows] == ["shape", "dtw", "a@b (oracle)", "chance"]
        of = frame[rows_where(frame, consumer="rerelease/dtw", knowledge="informed", cohort="all")]
        raw = of[of["mechanism"] == "raw"].iloc[0]
        assert row_of(table, "dtw")[1].full == with_interval(raw, name="rank1")
        assert row_of(table, "chance")[1].full == f"{100 * CHANCE:.1f}"
        assert [column.name for column in table.columns[1:]] == [*TOLD, *TOLD[2:]]
        rules = ["", "", *["linear"] * 4, *["independent"] * 4]
        assert [column.above for column in table.columns[1:]] == rules
        stranger = ranks(make_linkability(STRANGER))
        assert [column.name for column in stranger.columns[-2:]] == ["ou 0.2", "ou 0.8"]

    def test_it_says_what_the_task_is(self):
        frame = make_linkability(tasks=("handover-2s",))
        frame = frame.assign(gallery_min=21, gallery_mean=37.66, gallery_max=52, n_mated=201)
        table = ranks(frame, {"handover-2s": {"people": 275}})
        assert table.title.startswith("handover-2s: all pseudonyms rotate after 2 s")
        assert table.notes[0] == (
            "275 people; 201 of 276 releases have a mate among 21 to 52 (mean 37.7) candidates. "
            "The adversary is informed where none is named."
        )
        assert ranks().notes[0].startswith("all 276 releases have a mate among 138 candidates.")

    def test_what_does_not_link_is_marked_and_the_marks_are_explained(self):
        frame = make_linkability()
        informed = rows_where(frame, consumer="rerelease/shape", knowledge="informed")
        fid = rows_where(frame, mechanism="fid", level=1.0)
        frame.loc[informed & fid, "outcome"] = "no link detected"
        frame.loc[informed & (frame["mechanism"] == "raw"), "outcome"] = "attack too weak"
        frame.loc[frame["mechanism"] == "clean", "invalid"] = "duration"
        table = ranks(frame)
        assert [cell.mark for cell in row_of(table, "shape")][:4] == ["!", "?", "~", ""]
        assert table.legend == (
            "~ no link detected; ? attack too weak: it fails on clean too; "
            "! a shortcut leaks: no measure of the attack"
        )
        # A less knowing adversary is not shown, nor is what it fails at.
        blind = make_linkability()
        blind.loc[blind["knowledge"] == "blind", "outcome"] = "no link detected"
        assert ranks(blind).legend == ""

    def test_audits_that_leak_and_controls_are_counted_once_where_they_cannot_differ(self):
        frame = make_linkability()
        assert ranks(frame).notes[2] == (
            "controls: 0 of 33 beat chance at 5 % (1.7 expected); audits that leak: none"
        )
        duration = frame["consumer"] == "rerelease/control-duration"
        noise = (frame["consumer"] == "rerelease/control-noise_level") & frame["level"].notna()
        random = (frame["consumer"] == "rerelease/control-random") & (frame["level"] == 0.7)
        for of, p_value in ((duration, 0.03), (noise, 0.05), (random, 0.01)):
            frame.loc[of, "p_value"] = p_value
        frame.loc[frame["mechanism"] == "fixed", "invalid"] = "duration, noise_level"
        assert ranks(frame).notes[2] == (
            "controls: 17 of 33 beat chance at 5 % (1.7 expected; duration 1 of 1; noise_level "
            "14 of 16); audits that leak: duration at 3 of 16 levels, noise_level at 3 of 16 levels"
        )

    def test_without_the_confounders_the_best_attack_is_shown_with_its_chance(self):
        frame = make_linkability()
        at = rows_where(frame, consumer="rerelease/shape@radial_rts", knowledge="informed")
        at &= rows_where(frame, mechanism="fid", level=1.0)
        frame.loc[at, "rank1"] = frame.loc[at, "cohort"].map(
            {"all": 0.5, "without_groups": 0.6, "without_frozen": 0.49}
        )
        assert (
            "fid 1, shape@radial_rts: 50.0 (chance 0.7); without walking groups 60.0 (2.1), without"
            " frozen annotations 49.0 (0.7)"
        ) in ranks(frame).notes
        alone = ranks(make_linkability([("clean", np.nan), ("raw", np.nan)]))
        assert any(note.startswith("clean, shape@radial_rts: ") for note in alone.notes)
        assert "walking" not in " ".join(ranks(make_linkability(cohorts={})).notes)

    def test_missing_cells_and_values_do_not_stop_it_and_long_names_keep_their_settings(self):
        name = "some_package.attacks.clever:TheVeryBest,window_s=2.5"
        frame = make_linkability(tasks={"rerelease": {"shape": 0.4, name: 0.3}})
        shape = frame["consumer"] == "rerelease/shape"
        frame = frame[~(shape & (frame["mechanism"] == "raw"))]
        frame.loc[shape & (frame["mechanism"] == "clean"), "rank1"] = np.nan
        frame.loc[frame["mechanism"] == "fid", ["ci_low", "ci_high"]] = np.nan
        table = ranks(frame)
        assert [cell.full for cell in row_of(table, "shape")[:2]] == ["", ""]
        assert row_of(table, "shape")[2].low == ""
        assert re.fullmatch(r"some_package\S*\.\.\.\S*window_s=2\.5", table.rows[1][0].text)

    def test_read_from_its_file_the_frame_says_the_same(self, tmp_path):
        frame = make_linkability()
        frame.to_csv(tmp_path / "linkability.csv", index=False)
        read = pd.read_csv(tmp_path / "linkability.csv")
        assert shown(make_run(linkability=read)) == shown(make_run(linkability=frame))

    def test_every_cell_has_a_row_and_those_that_measure_nothing_are_listed(self):
        run = make_run()
        table = cells_table(run, run.tasks[0])
        assert len(table.rows) == 6 * (2 + 2 * 4 + 4)
        row = row_of(table, "raw", "", "", "shape", "blind")
        assert [cell.text for cell in row[1:]] == ["0.7", "links", "", "138", "175"]
        frame = make_linkability(cohorts={})
        frame = frame[frame["knowledge"] != ""].iloc[:4].reset_index(drop=True)
        frame.loc[0, "invalid"] = "noise_level"
        frame.loc[1:2, "outcome"] = ["attack too weak", "no link detected"]
        assert [row[-1].text for row in doubt_table(make_run(linkability=frame)).rows] == [
            "invalid: noise_level tells people apart",
            "attack too weak: it fails on clean too",
        ]


class TestAnswers:
    @pytest.mark.parametrize(
        ("start", "cells"),
        [
            (("fid", "linear", "1", "missed (%)"),
             ["30.5", "26.0 [20.5, 32.2]", "-4.5", "yes", "no (4.0)"]),
            (("raw", "", "", "AEL (s)"),
             ["2.930", "3.500 [3.200, 3.800]", "+0.570", "no", "yes (0.879)"]),
            (("fixed", "independent", "1", "MEL (s)"),
             ["0.250", "0.310", "+0.060", "", "no (0.050)"]),
        ],
    )  # fmt: skip
    def test_the_paper_has_bias_interval_and_tolerance(self, start, cells):
        assert [cell.full for cell in row_of(paper_table(make_run()), *start)] == cells

    def test_another_recording_is_compared_but_not_judged(self):
        table = paper_table(make_run(dataset="plaza"))
        told = "The paper used students03; ours are of plaza, so they need not agree."
        assert table.notes == [told]
        assert heads(table)[-1] == "ours - paper"

    def test_claims_show_answer_effect_and_interval(self):
        assert [row[2:4] for row in texts(claims_table(make_run()))] == [
            ["holds", "-8.8 [-12.2, -5.5] points"],
            ["does not hold", "0.012 [0.001, 0.020] s"],
            ["undecided", "368.8 points"],
        ]

    def test_of_matched_points_the_middle_one_of_the_strongest_attack_is_shown(self):
        row = matched_table(make_run(strongest={})).rows[0]
        assert [cell.full for cell in row[-4:]] == [
            "8.0", "20.0 [10.0, 30.0]", "40.0 [30.0, 50.0]", "-8.0 [-9.0, -7.0]"
        ]  # fmt: skip
        frame = make_matched()
        others = [
            frame[frame["metric"] == "plr"].assign(consumer=name, knowledge=knows, metric="rank1")
            for name in ("rerelease/shape", "rerelease/shape@radial_rts")
            for knows in ("blind", "informed", "oracle")
        ]
        table = matched_table(make_run(matched=pd.concat(others), strongest=STRONGEST))
        assert {(row[3].text, row[4].text) for row in table.rows} == {
            ("rerelease/shape@radial_rts", "informed")
        }

    def test_in_short_a_section_of_the_verdict_is_a_table_of_decisions(self):
        validity, inflation = short_tables(VERDICT)
        assert texts(validity) == [["linear", "PLR", "does not"]]
        assert heads(validity)[2:] == ["rerelease"]
        assert texts(inflation) == [["linear", "fid", "3.3"], ["linear", "fixed", "?"]]
        one = ITEM | {"section": "claim", "of": "as-shared", "criterion": "missed"}
        two = one | {"criterion": "missed_at_equal_false_alarms", "decision": "holds"}
        (claim,) = short_tables({"items": [one | {"decision": "reversed"}, two]})
        assert heads(claim)[2:] == ["linear", "linear and alarms"]
        assert texts(claim) == [["as shared", "PLR", "higher", "lower"]]

    def test_every_item_has_a_row_in_the_table_of_its_section_and_names_its_contrasts(self):
        found = item_tables(VERDICT["items"])
        assert list(found) == ["validity", "inflation"]
        (row,) = found["validity"].rows
        assert row[0].signed == "✗ does not track"
        assert row[2].full == "-48.1 [-54.8, -41.7] points"
        inflated, undecided = found["inflation"].rows
        assert inflated[2].full == "3.29 [3.17, 3.44] times"
        assert undecided[1].text.endswith("Undecided: too few people.")
        assert undecided[2].full == ""
        rows = contrast_table(VERDICT["items"]).rows
        assert [(row[4].text, row[5].text, row[6].signed) for row in rows] == [
            ("correlated", "0.5", "✗ differs"),
            ("fid", "", "✓ equal"),
        ]

    @pytest.mark.parametrize(
        ("unit", "value", "text"),
        [
            ("fraction", 0.0554, "+5.5 [+5.4, +5.6] points"),
            ("s", 0.0554, "+0.055 [+0.054, +0.056] s"),
            ("correlation", 0.136, "+0.14 [+0.14, +0.14]"),
            ("ratio", 4.537, "4.54 [4.54, 4.54] times"),
        ],
    )
    def test_an_effect_has_the_digits_that_its_unit_needs(self, unit, value, text):
        row = {"unit": unit, "effect": value, "ci_low": value - 0.001, "ci_high": value + 0.001}
        assert effect(row, signed=True).full == text


def test_every_kind_of_result_has_its_file_in_latex(tmp_path):
    tables.write_tex(make_run(), folder=tmp_path / "tables")
    files = {path.name: path.read_text("utf-8") for path in (tmp_path / "tables").iterdir()}
    told = {
        "sweep.tex": r"fid & independent & 1 & ",
        "attacks.tex": r"\begin{tabular}",
        "paper.tex": r"fid & linear & 1 & missed (\%) & 30.5 & 26.0 {\scriptsize [20.5, 32.2]}",
        "linkability.tex": "\nchance & ",
        "verdict.tex": "linear & PLR & does not",
    }
    assert set(files) == set(told)
    assert all(text in files[name] for name, text in told.items())
    # Attacks have a tabular each with all levels.
    text = files["attacks.tex"]
    assert text.count(r"\begin{tabular}") == 1 + len(ATTACKS)
    for attack, knowledge in ATTACKS:
        assert f"% After {attack} ({knowledge})".replace("_", r"\_") in text
    rows = [line for line in text.splitlines() if line.startswith(("raw &", "fid &", "fixed &"))]
    assert len(rows) == (1 + len(ATTACKS)) * (1 + 2 * 5)
    assert attack_table(make_summary(), only=Source(*ATTACKS[7])).title.startswith("After kalman")
    assert r" & linear & linear & " in files["linkability.tex"]
    assert r"% rerelease: one walk sensed and shared twice" in files["linkability.tex"]


BLOCK = "Before.\n<!-- table: sweep students03-paper-3 -->\nold\n<!-- end -->\nAfter.\n"


class TestTheDocs:
    @pytest.fixture
    def root(self, tmp_path):
        (tmp_path / "docs").mkdir()
        (tmp_path / "README.md").write_text(BLOCK, encoding="utf-8")
        (tmp_path / "docs" / "other.md").write_text("Nothing.\n", encoding="utf-8")
        return tmp_path

    def test_the_summary_and_the_blocks_are_written_and_written_again_the_same(self, root):
        run = make_run()
        path = root / "docs" / "results" / "students03-paper-3.csv"
        assert tables.write_docs(run, root=root) == [path, root / "README.md"]
        text = (root / "README.md").read_text(encoding="utf-8")
        expected = markdown(tables.DOCS["sweep"](tables.published(run)))
        assert text == BLOCK.replace("old\n", expected)
        assert (root / "docs" / "other.md").read_text(encoding="utf-8") == "Nothing.\n"
        assert tables.write_docs(run, root=root) == [path]
        assert tables.filled(text, results=path.parent) == text

    def test_every_table_is_the_same_from_the_file(self, tmp_path):
        frame = make_summary(levels())
        frame.to_csv(tmp_path / "run.csv", index=False)
        read = pd.read_csv(tmp_path / "run.csv")
        for make in tables.DOCS.values():
            assert markdown(make(read)) == markdown(make(frame))

    @pytest.mark.parametrize("mark", ["sweep nowhere-paper-0", "nothing students03-paper-3"])
    def test_what_is_not_there_is_named(self, root, mark):
        (root / "README.md").write_text(f"<!-- table: {mark} -->\n<!-- end -->\n", encoding="utf-8")
        with pytest.raises(DataError, match=mark.split()[0]):
            tables.write_docs(make_run(), root=root)

    def test_outside_the_repository_nothing_is_written(self, tmp_path):
        with pytest.raises(DataError, match="no README"):
            tables.write_docs(make_run(), root=tmp_path)
        assert not list(tmp_path.iterdir())
