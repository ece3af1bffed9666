"""The tables of a run: the numbers of its frames, and doubts."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.finished_runs import (
    ATTACKS,
    emptied,
    everything,
    levels,
    make_linkability,
    make_run,
    make_summary,
    rows_where,
    with_links,
)
from helpers.pages import assert_as_approved, tells_rows_apart

from evaluation.estimates.families import families_in
from evaluation.estimates.linkability import task_outcomes
from evaluation.reporting import tables
from evaluation.reporting.answer_tables import effect, paper_table
from evaluation.reporting.markup import markdown
from evaluation.reporting.result_tables import (
    attack_table,
    exposure_table,
    rank_table,
    strength_table,
    sweep_tables,
)
from evaluation.reporting.rows import representative_levels
from isac_track.errors import DataError

HEADLINE = (("fid", (1.0, 1000.0)), ("fixed", (0.7, 1.0)))
STRANGER = [*levels(swept=HEADLINE, others=[]), *[("ou", at) for at in (0.2, 0.4, 0.8)]]
CHOSEN = ["clean", "raw", "fid 1", "fid 1000", "fixed 0.7", "fixed 1"]


def shown(run, out):
    """All that is not on the first screen."""
    tables.write_text(replace(run, out=out))
    return (out / "tables.txt").read_text(encoding="utf-8")


def find_cells(table, *start):
    """The cells of the row with a start, behind that start."""
    (row,) = [
        row
        for row in table.rows
        if tuple(cell.text for cell in row[: len(start)]) == start
    ]
    return row[len(start) :]


def ranks(frame):
    run = make_run(at=[*STRANGER, *levels()], linkability=frame)
    return rank_table(run, task_outcomes(frame)[0])


def test_what_is_shown_of_a_run_is_letter_for_letter_what_was_read_and_approved(
    tmp_path,
):
    run = everything()
    tables.write_tex(run, folder=tmp_path)
    shown_tables = tables.page_tables(run)
    names = [
        name
        for name in shown_tables
        if re.match("matched|cells-h|doubts|flags|contr|verd", name)
    ]
    parts = [
        shown(run, tmp_path),
        *(f"{name}\n{markdown(shown_tables[name])}" for name in names),
    ]
    parts += [
        (tmp_path / f"{name}.tex").read_text("utf-8")
        for name in ("linkability", "verdict")
    ]
    text = "\n".join(parts)
    assert_as_approved(text, Path(__file__).with_name("shown.txt"))
    assert all(map(tells_rows_apart, shown_tables.values()))


class TestTheTextFile:
    def test_notices_and_at_last_failed_cells_are_shown(self, tmp_path):
        row = {
            "spec": "fid:1",
            "kind": "attack",
            "consumer": "mine",
            "knowledge": "blind",
            "policy": "",
        }
        run = make_run(failed=pd.DataFrame([row | {"block": 0, "why": "it broke"}]))
        run.manifest["dataset"]["simulated"] = True
        text = shown(run, tmp_path)
        assert text.startswith("Simulated crowd students03: ")
        last = "failed: mine (blind) at fid:1: it broke; left out everywhere"
        assert text.splitlines()[-1] == last
        run.manifest["dataset"]["notice"] = "a stand-in"
        assert "NOTICE: a stand-in" in shown(run, tmp_path)

    def test_the_sentence_on_patrols_stands_there_once(self, tmp_path):
        patrols = {"patrols": {"lacks": "robots"}}
        run = make_run(verdict=make_run().verdict | patrols)
        text = " ".join(shown(run, tmp_path).split())
        assert text.count("On patrol: Nothing is proposed:") == 1

    def test_an_empty_run_is_shown(self, tmp_path):
        run = make_run(**emptied(make_run()), verdict={})
        assert not re.search("mechanism|Verdict", shown(run, tmp_path))
        assert tables.page_tables(run) == {}


@pytest.mark.parametrize(
    ("at", "controls", "chosen"),
    [
        (levels(rules=("",)), False, CHOSEN),
        (levels(rules=("",)), True, ["offset 0.4", "thin:d_sigma=0.75 4", *CHOSEN]),
        (STRANGER, True, [*CHOSEN, "ou 0.2", "ou 0.8"]),
        ([("raw", np.nan), *[("fid", at) for at in (3.0, 20.0, 50.0)]], True,
         ["raw", "fid 3", "fid 20", "fid 50"]),
    ],
)  # fmt: skip
def test_representative_levels_are_those_of_the_headline_or_all(at, controls, chosen):
    mechanism_levels = [
        (name, None if np.isnan(level) else level) for name, level in at
    ]
    known = families_in(make_summary(at))
    representative = representative_levels(mechanism_levels, known, controls=controls)
    rest = [
        (name, level)
        for name, level in representative
        if "=indep" not in name and "corr" not in name
    ]
    names = [
        f"{name} {'' if level is None else f'{level:g}'}".strip()
        for name, level in rest
    ]
    assert sorted(names) == sorted(chosen)
    assert names[:2] == chosen[:2] or controls


class TestTheSweep:
    def test_each_further_predictor_has_a_table_of_its_own_and_attacks_change_none(
        self,
    ):
        names = ("least_squares", "kalman_cv")
        odd = [*ATTACKS, ("least_squares", "informed"), ("shared", "blind")]
        first, second = sweep_tables(make_summary(predictors=names, attacks=odd))
        plain = sweep_tables(make_summary(predictors=names, attacks=()))
        assert [markdown(first), markdown(second)] == [
            markdown(table) for table in plain
        ]
        assert "predictor least_squares" in first.title
        assert "predictor kalman_cv" in second.title
        assert "MEL, shared (s)" not in markdown(second)
        (without_predictor,) = sweep_tables(make_summary(predictors=()))
        assert "predictor" not in without_predictor.title

    def test_near_levels_are_not_merged_and_missing_values_do_not_stop_it(self):
        frame = make_summary()
        frame["level"] = frame["level"].replace({1000.0: 1.00001})
        frame.loc[frame["metric"] == "mel", "value"] = np.nan
        frame[["ci_low", "ci_high"]] = np.nan
        (table,) = sweep_tables(frame)
        assert [row[2].text for row in table.rows if row[0].text == "fid"] == ["1"] * 4
        assert find_cells(table, "raw", "", "")[-1].full == ""


class TestAfterAttack:
    def test_a_control_that_differs_is_shown_and_equal_adversaries_share_a_row(self):
        frame = make_summary()
        frame.loc[frame["consumer"] == "identity", "value"] += 0.1
        frame.loc[frame["consumer"] == "savgol", ["value", "ci_low", "ci_high"]] = 0.5
        last = frame[rows_where(frame, consumer="radial_rts", knowledge="informed")]
        table = attack_table(pd.concat([frame, last.assign(knowledge="oracle")]))
        attacks = {(row[3].text, row[4].text) for row in table.rows}
        assert {
            ("identity", "blind"),
            ("radial_rts", "informed, oracle"),
            ("savgol", "any"),
        } <= attacks

    def test_without_attacks_nothing_is_shown_and_missing_values_do_not_stop_it(self):
        unattacked = make_summary(attacks=())
        assert not exposure_table(unattacked).rows
        assert not attack_table(unattacked).rows
        frame = make_summary()
        frame.loc[frame["knowledge"] != "", ["value", "ci_low", "ci_high"]] = np.nan
        part = frame[(frame["knowledge"] == "") | (frame["mechanism"] == "fid")]
        for rows in (frame, part):
            cells = find_cells(exposure_table(rows), "raw", "", "")[1:]
            assert {cell.full for cell in cells} == {""}


class TestLinkage:
    def test_missing_cells_and_values_do_not_stop_it_and_long_names_keep_their_settings(
        self,
    ):
        name = "some_package.attacks.clever:TheVeryBest,window_s=2.5"
        frame = make_linkability(tasks={"rerelease": {"shape": 0.4, name: 0.3}})
        shape = frame["consumer"] == "rerelease/shape"
        frame = frame[~(shape & (frame["mechanism"] == "raw"))]
        frame.loc[shape & (frame["mechanism"] == "clean"), "rank1"] = np.nan
        frame.loc[frame["mechanism"] == "fid", ["ci_low", "ci_high"]] = np.nan
        table = ranks(frame)
        assert [cell.full for cell in find_cells(table, "shape")[:2]] == ["", ""]
        assert find_cells(table, "shape")[2].low == ""
        assert re.fullmatch(
            r"some_package\S*\.\.\.\S*window_s=2\.5", table.rows[1][0].text
        )

    def test_read_from_its_file_the_frame_says_the_same(self, tmp_path):
        frame = make_linkability()
        frame.to_csv(tmp_path / "linkability.csv", index=False)
        read = pd.read_csv(tmp_path / "linkability.csv")
        from_file = shown(make_run(linkability=read), tmp_path)
        assert from_file == shown(make_run(linkability=frame), tmp_path)


class TestAnswers:
    def test_another_recording_is_compared_but_not_judged(self):
        table = paper_table(make_run(dataset="plaza"))
        assert table.notes == [
            "Missed rates rest on 2,000 scenes, the others on 500.",
            "The paper used students03; ours are of plaza, so they need not agree.",
        ]
        assert table.columns[-1].head == "paper's own error"

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
        row = {
            "unit": unit,
            "effect": value,
            "ci_low": value - 0.001,
            "ci_high": value + 0.001,
        }
        assert effect(row, signed=True).full == text


def test_every_kind_of_result_has_its_file_in_latex_and_every_attack_its_tabular(
    tmp_path,
):
    tables.write_tex(make_run(), folder=tmp_path)
    files = {path.stem: path.read_text("utf-8") for path in tmp_path.iterdir()}
    assert files.keys() == {"sweep", "attacks", "paper", "linkability", "verdict"}
    assert (
        r"fid & linear & 1 & missed (\%) & 30.5 & 26.0 {\scriptsize [20.5"
        in files["paper"]
    )
    text = files["attacks"]
    assert text.count(r"\begin{tabular}") == 1 + len(ATTACKS)
    for attack, knowledge in ATTACKS:
        assert f"% After {attack} ({knowledge})".replace("_", r"\_") in text
    rows = [
        line
        for line in text.splitlines()
        if line.startswith(("raw &", "fid &", "fixed &"))
    ]
    assert len(rows) == (1 + len(ATTACKS)) * (1 + 2 * 5)


BLOCK = "Before.\n<!-- table: sweep students03-paper-3 -->\nold\n<!-- end -->\nAfter.\n"


class TestTheDocs:
    @pytest.fixture
    def root(self, tmp_path):
        (tmp_path / "docs").mkdir()
        (tmp_path / "README.md").write_text(BLOCK, encoding="utf-8")
        (tmp_path / "docs" / "other.md").write_text("Nothing.\n", encoding="utf-8")
        return tmp_path

    def test_the_summary_and_the_blocks_are_written_and_written_again_the_same(
        self, root
    ):
        run = make_run()
        path = root / "docs" / "results" / "students03-paper-3.csv"
        strongest = path.with_stem("students03-paper-3-strongest")
        assert tables.write_docs(run, root=root) == [
            path,
            strongest,
            root / "README.md",
        ]
        text = (root / "README.md").read_text(encoding="utf-8")
        expected = markdown(tables.DOCS["sweep"](tables.published(run)))
        assert text == BLOCK.replace("old\n", expected)
        assert (root / "docs" / "other.md").read_text(encoding="utf-8") == "Nothing.\n"
        assert tables.write_docs(run, root=root) == [path, strongest]
        assert tables.filled(text, results=path.parent) == text

    def test_every_table_is_the_same_from_the_file(self, tmp_path):
        frame = make_summary(levels())
        frame.to_csv(tmp_path / "run.csv", index=False)
        read = pd.read_csv(tmp_path / "run.csv")
        for make in tables.DOCS.values():
            assert markdown(make(read)) == markdown(make(frame))

    @pytest.mark.parametrize(
        "mark", ["sweep nowhere-paper-0", "nothing students03-paper-3"]
    )
    def test_what_is_not_there_is_named(self, root, mark):
        (root / "README.md").write_text(
            f"<!-- table: {mark} -->\n<!-- end -->\n", encoding="utf-8"
        )
        with pytest.raises(DataError, match=mark.split()[0]):
            tables.write_docs(make_run(), root=root)

    def test_a_run_of_other_settings_is_none_to_show(self, root):
        run = make_run()
        run.manifest["settings"]["stages"]["privacy.epsilon_m"] = 0.4
        with pytest.raises(DataError, match=r"this one has privacy.epsilon_m=0.4"):
            tables.write_docs(run, root=root)
        assert not (root / "docs" / "results").exists()

    def test_outside_the_repository_nothing_is_written(self, tmp_path):
        with pytest.raises(DataError, match="no README"):
            tables.write_docs(make_run(), root=tmp_path)
        assert not list(tmp_path.iterdir())


def test_what_laplace_promises_stands_where_its_level_does():
    frame = make_summary(predictors=()).assign(family="laplace", level=1.5)
    (table,) = sweep_tables(frame)
    assert list(table.notes[1:]) == [
        "laplace 1.5: epsilon 1.15 1/m a report, 423 1/m over 366."
    ]


def test_what_scores_tell_stands_beside_ranks_with_its_ends_turned_round():
    run = with_links(make_run())
    linked = run.summary[run.summary["metric"] == "rank1"]
    lost = linked.assign(
        metric="cllr_min", value=0.3, ci_low=0.1, ci_high=0.4, unit="bit"
    )
    table = strength_table(replace(run, summary=pd.concat([run.summary, lost])))
    heads = [column.name for column in table.columns]
    assert heads[-4:] == ["rank 1", "rank 1 of 100", "chance", "1 - Cllr_min"]
    assert {row[-1].full for row in table.rows} == {"0.700 [0.600, 0.900]"}
    linked = {task for task in run.strongest if task}
    assert {row[0].text for row in table.rows} == linked
    assert not any(row[-3].full for row in table.rows)  # fewer than 100 candidates
