"""The page: what it says, that it asks nothing of anybody, and that odd names do no harm."""

import copy
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from evaluation.analysis import linkability, matching, paper, summary
from evaluation.analysis import weak_attacks as flags
from evaluation.analysis.keys import Source
from evaluation.cells import sample_tracks as page_gallery
from evaluation.experiment.plan import plan
from evaluation.experiment.settings import Settings
from evaluation.reporting import page, page_cells, page_svg, page_tables, page_words
from evaluation.reporting.figures import draw as figures
from evaluation.reporting.figures import heat as page_heat
from evaluation.reporting.figures import page_figures
from evaluation.reporting.figures import style as figure_style
from evaluation.results import Results
from evaluation.runs.failures import COLUMNS as FAILED_COLUMNS
from isac_track import plugins as registry
from isac_track.config import StageSettings
from isac_track.errors import DataError

SUFFIXES = ("", ":adding=independent")
LEVELS = [
    ("clean", np.nan),
    ("raw", np.nan),
    *(
        (f"{name}{suffix}", level)
        for suffix in SUFFIXES
        for name, levels in (("fid", (1.0, 1000.0)), ("fixed", (0.4, 0.7, 1.0)))
        for level in levels
    ),
    ("offset", 0.4),
    ("correlated", 0.5),
    ("correlated:adding=independent", 0.5),
    ("thin:d_sigma=0.75", 4.0),
]
UNITS = {"plr": "fraction", "ael": "s", "mel": "s", "rmse": "m"}
SHARES = {
    "raw": 0.52, "fid": 0.2, "fixed": 0.2, "offset": 0.0, "correlated": 0.25, "thin": 0.19,
    "clean": 1.0,
}  # fmt: skip


def make_summary(dataset="students03"):
    rows = []
    for place, (mechanism, level) in enumerate(LEVELS[1:]):
        plr = SHARES[mechanism.partition(":")[0]] - 0.005 * place * (not np.isnan(level))
        plr = max(plr, 0.0)
        cells = [
            ("shared", "", "plr", plr),
            ("shared", "", "ael", 2 * plr),
            ("shared", "", "mel", 5 * plr),
            ("shared", "", "rmse", 1.0),
            ("radial_rts", "informed", "plr", 0.9),
            ("radial_rts", "oracle", "plr", 0.99),
            ("kalman_rts", "informed", "plr", 0.8),
            ("least_squares", "", "missed_conflict_rate", 0.1 + 0.02 * place),
            ("least_squares", "", "false_alarm_rate", 0.15),
        ]
        for consumer, knowledge, metric, value in cells:
            numbers = [value, 0.9 * value, 1.1 * value, 55]
            unit = UNITS.get(metric, "fraction")
            rows.append([dataset, mechanism, level, consumer, knowledge, metric, *numbers, unit])
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def make_linkability(dataset="students03"):
    strength = {"shape": 0.4, "shape@radial_rts": 0.6}
    rows = []
    for place, (mechanism, level) in enumerate(LEVELS):
        for attack, rank1 in strength.items():
            for knowledge in ("blind", "informed", "oracle"):
                better = {"blind": 0.9, "informed": 1.0, "oracle": 1.1}[knowledge]
                value = rank1 * better - 0.01 * place
                rows.append(
                    {
                        "dataset": dataset, "mechanism": mechanism, "level": level,
                        "consumer": f"rerelease/{attack}", "knowledge": knowledge, "cohort": "all",
                        "outcome": "links", "invalid": "", "rank1": value,
                        "ci_low": value - 0.05, "ci_high": value + 0.05, "chance": 0.007,
                        "gallery_mean": 138, "n_clusters": 175,
                    }
                )  # fmt: skip
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def make_curves(dataset="students03"):
    rows = [
        [dataset, mechanism, level, "least_squares", score, x, 1.0 - x]
        for mechanism, level in LEVELS[1:]
        for score in ("separation", "probability")
        for x in (0.0, 0.5, 1.0)
    ]
    return pd.DataFrame(
        rows,
        columns=[
            "dataset", "mechanism", "level", "consumer", "score", "false_alarm_rate",
            "missed_conflict_rate",
        ],
    )  # fmt: skip


def make_matched(dataset="students03"):
    rows = [
        {
            "dataset": dataset, "criterion": "missed", "adding": "linear",
            "predictor": "least_squares", "consumer": "shared", "metric": "plr", "at": at,
            "missed_conflict_rate": 0.1 + at, "fid": 0.3, "fid_low": 0.2, "fid_high": 0.4,
            "fixed": 0.35, "fixed_low": 0.3, "fixed_high": 0.4, "difference": -at,
            "ci_low": -at - 0.01, "ci_high": -at + 0.01, "defined": 1.0, "n": 55,
        }
        for at in (0.03, 0.01, 0.02)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=matching.COLUMNS)


ITEM = {
    "id": "validity/linear/plr/rerelease", "section": "validity", "adding": "linear",
    "descriptor": "plr", "task": "rerelease", "subject": "shape (informed)", "criterion": "",
    "decision": "does not track", "sign": -1, "effect": -0.481, "ci_low": -0.548,
    "ci_high": -0.417, "unit": "fraction", "n": 175, "p_value": 1e-9, "p_adjusted": 1e-8,
    "sentence": "At equal PLR people are linked less.", "why_undecided": "",
    "contrasts": [
        {"mechanism": "correlated", "level": 0.5, "effect": -0.48, "ci_low": -0.55,
         "ci_high": -0.42, "reading": "differs"},
        {"mechanism": "fid", "level": None, "effect": 0.01, "ci_low": -0.01, "ci_high": 0.04,
         "reading": "equal"},
    ],
}  # fmt: skip
VERDICT = {
    "dataset": "students03", "simulated": False, "seed": 0, "preset": "paper", "scenes": 500,
    "answer": ["The first sentence.", "The second one.", "And the third."],
    "rules": {"confidence": 0.95, "text": "How it is decided."},
    "counts": {"validity": {"does not track": 1}, "inflation": {"inflated": 1, "undecided": 1}},
    "items": [
        ITEM,
        ITEM | {"id": "b", "section": "inflation", "task": "", "decision": "inflated",
                "effect": 3.29, "ci_low": 3.17, "ci_high": 3.44, "unit": "ratio", "contrasts": []},
        ITEM | {"id": "c", "section": "inflation", "task": "", "decision": "undecided",
                "effect": None, "ci_low": None, "ci_high": None, "n": None, "unit": "ratio",
                "why_undecided": "too few people", "contrasts": None},
    ],
}  # fmt: skip
MANIFEST = {
    "settings": {
        "preset": "paper", "scenes": 500, "seed": 3, "mechanisms": ["raw", "fid:1"],
        "predictors": ["least_squares"], "attacks": [], "tasks": ["rerelease"],
        "stages": StageSettings().flat(),
    },
    "dataset": {
        "name": "students03", "sha256": "d9fd", "simulated": False, "notice": None, "tracks": 428,
        "tracks_used": 106,
    },
    "environment": {
        "isac_track": "0.1.0", "python": "3.11.7", "machine": "Linux x86_64",
        "libraries": {"numpy": "2.4.6"}, "git_commit": "abc123",
        "command": ["/somewhere/matrix.py", "--out", "a run"],
    },
    "linkage": {
        "skipped": {"split": "too few people"},
        "tasks": {"rerelease": {"about": "one walk twice", "people": 276,
                                "candidates": {"half 1": 138, "half 2": 137}}},
    },
    "wall_time_s": 97.8,
}  # fmt: skip


def make_results(out, dataset="students03", **changes):
    manifest = copy.deepcopy(MANIFEST)
    manifest["dataset"]["name"] = dataset
    paper_rows = [["fid", 1.0, "plr", 0.184, 0.187, 0.184, 0.191, True]]
    claim_rows = [["linear", "PLR falls", "does not hold", -0.1, -0.2, -0.05, "fraction", "why"]]
    frames = {
        "out": out,
        "manifest": manifest,
        "summary": make_summary(dataset),
        "paper_table": pd.DataFrame(paper_rows, columns=paper.PAPER_COLUMNS),
        "claims": pd.DataFrame(claim_rows, columns=paper.CLAIM_COLUMNS),
        "matched": make_matched(dataset),
        "decisions": pd.DataFrame(
            columns=["dataset", "mechanism", "level", "consumer", "score"], dtype=float
        ),
        "curves": make_curves(dataset),
        "flags": pd.DataFrame(columns=flags.COLUMNS),
        "linkability": make_linkability(dataset),
        "verdict": VERDICT,
        "failed": pd.DataFrame(columns=list(FAILED_COLUMNS)),
    }
    return Results(**(frames | changes))


def draw(results):
    return figures.draw_all(
        results.summary,
        results.matched,
        folder=results.out / "figures",
        dataset=results.manifest["dataset"]["name"],
        linkability=results.linkability,
        curves=results.curves,
        gallery=page_gallery.read_gallery(results.out),
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    results = make_results(tmp_path_factory.mktemp("run"))
    path = page.write(results, drawn=draw(results), verdict=VERDICT)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def task():
    (found,) = page_figures.tasks_of(make_linkability(), dataset="students03")
    return found


class Tags(HTMLParser):
    """Every tag of a page with its attributes, and the text that stands in it."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.text = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)

    def of(self, name):
        return [attributes for tag, attributes in self.found if tag == name]


class TestTheFile:
    def test_it_begins_as_a_page_and_says_what_it_is(self, made):
        assert made.startswith("<!doctype html>")
        assert "<title>students03:" in made
        tags = Tags(made)
        assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in tags.of(
            "meta"
        )

    def test_it_refers_to_nothing_but_itself(self, made):
        for tag, attributes in Tags(made).found:
            for name in ("href", "src", "xlink:href", "action", "data", "srcset"):
                if name in attributes:
                    assert attributes[name].startswith(("#", "data:")), (tag, attributes)
        css = "".join(re.findall(r"<style>(.*?)</style>", made, re.DOTALL))
        assert "url(" not in css
        assert "@import" not in css
        outside = re.findall(r"https?://[^\s\"<]+", made)
        assert set(outside) <= {"http://www.w3.org/2000/svg"}

    def test_every_id_is_there_once_and_every_reference_leads_somewhere(self, made):
        tags = Tags(made)
        ids = [attributes["id"] for _, attributes in tags.found if "id" in attributes]
        assert len(ids) == len(set(ids))
        wanted = {a["href"][1:] for _, a in tags.found if a.get("href", "").startswith("#")}
        wanted |= set(re.findall(r"url\(#([^)]+)\)", made))
        for _, attributes in tags.found:
            wanted |= set(attributes.get("aria-labelledby", "").split())
        assert wanted <= set(ids)

    def test_every_figure_has_a_title_and_words_with_numbers(self, made):
        tags = Tags(made)
        svgs = tags.of("svg")
        assert len(svgs) == 9
        assert all(svg["role"] == "img" and svg["viewbox"] for svg in svgs)
        told = re.findall(r"<title id=.*?>(.*?)</title><desc id=.*?>(.*?)</desc>", made)
        assert len(told) == len(svgs)
        assert all(title for title, _ in told)
        assert all(re.search(r"\d", words) for _, words in told)

    def test_every_head_of_a_table_can_be_pressed_and_says_what_it_is_head_of(self, made):
        tags = Tags(made)
        heads = tags.of("th")
        assert heads
        assert all(head["scope"] == "col" for head in heads)
        assert sum(one.get("class") == "sort" for one in tags.of("button")) == len(heads)
        assert len(tags.of("caption")) == len(tags.of("table"))

    def test_made_twice_it_is_the_same(self, made, tmp_path):
        results = make_results(tmp_path)
        again = page.write(results, drawn=draw(results), verdict=VERDICT)
        assert again.read_text(encoding="utf-8") == made

    def test_a_folder_that_cannot_be_written_is_named(self, tmp_path):
        results = make_results(tmp_path / "nowhere")
        with pytest.raises(DataError, match="nowhere"):
            page.write(results, drawn=[], verdict=None)


class TestWhatItSays:
    def test_the_answer_comes_first(self, made):
        places = [made.index(sentence) for sentence in VERDICT["answer"]]
        assert places == sorted(places)
        assert places[-1] < made.index('id="fig-headline"') < made.index("<nav")

    def test_decisions_are_a_sign_and_a_word(self, made):
        assert '<td class="t bad">✗ does not track</td>' in made
        assert "▲ inflated" in made
        assert "? undecided" in made

    def test_the_paper_stands_beside_ours(self, made):
        assert "18.7 [18.4, 19.1]" in made

    def test_without_a_verdict_it_says_so(self, tmp_path):
        results = make_results(tmp_path)
        text = page.render(results, svgs={}, verdict=None)
        assert "This run has no verdict" in text
        assert "does not track" not in Tags(text).text

    def test_an_empty_run_still_makes_a_page(self, tmp_path):
        full = make_results(tmp_path)
        empty = {
            name: getattr(full, name).head(0)
            for name in (
                "summary", "paper_table", "claims", "matched", "decisions", "curves", "flags",
                "linkability",
            )
        }  # fmt: skip
        results = make_results(tmp_path, **empty)
        text = page.render(results, svgs={}, verdict=None)
        assert "Nobody links in this run." in text
        assert "<table>" not in text

    def test_a_simulated_crowd_is_called_one_before_anything_is_said(self, tmp_path):
        results = make_results(tmp_path)
        results.manifest["dataset"]["simulated"] = True
        text = page.render(results, svgs={}, verdict=VERDICT)
        notice = text.index("Simulated crowd: says nothing of real people by itself.")
        assert notice < text.index(VERDICT["answer"][0])

    def test_a_task_that_was_left_out_is_named(self, made):
        assert "split: too few people" in made

    def test_flags_of_weak_attacks_are_told(self, tmp_path):
        flag = {
            "kind": "beaten", "mechanism": "raw", "level": np.nan, "attack": "radial_rts",
            "knowledge": "informed", "by": "radial_rts", "by_knowledge": "blind", "metric": "plr",
            "difference": 0.003, "ci_low": 0.001, "ci_high": 0.005, "compared": 47,
            "sentence": "",
        }  # fmt: skip
        results = make_results(tmp_path, flags=pd.DataFrame([flag], columns=flags.COLUMNS))
        text = page.render(results, svgs={}, verdict=None)
        assert "radial_rts (informed) is beaten by radial_rts (blind) at 1 of 47 levels" in text
        assert "+0.3 [+0.1, +0.5]" in text


@pytest.fixture(scope="module")
def odd(tmp_path_factory):
    frame = make_linkability("<script>alert(1)</script>")
    odd = frame["consumer"].str.replace("shape", "a&b<i>")
    results = make_results(
        tmp_path_factory.mktemp("odd"),
        "<script>alert(1)</script>",
        linkability=frame.assign(consumer=odd),
    )
    results.manifest["environment"]["command"] = ["matrix.py", "--dataset", "</code><b>x"]
    item = {**ITEM, "subject": "</td><img src=x>"}
    return page.write(results, drawn=draw(results), verdict={**VERDICT, "items": [item]}).read_text(
        encoding="utf-8"
    )


@pytest.mark.slow  # test_untrusted_names.py looks at whole runs
class TestOddNames:
    def test_a_data_set_in_the_shape_of_a_script_is_a_word(self, odd):
        assert "alert(1)" in odd
        assert "<script>alert" not in odd
        assert len(Tags(odd).of("script")) == 1

    def test_an_attack_with_marks_in_its_name_is_a_word(self, odd):
        tags = Tags(odd)
        assert not tags.of("i")
        assert not tags.of("img")
        assert not tags.of("b")
        assert "a&b<i>" in tags.text
        assert "a&amp;b&lt;i&gt;" in odd


class TestTheInlineFigure:
    SVG = (
        b'<?xml version="1.0"?>\n<!DOCTYPE svg PUBLIC "x" "http://outside">\n'
        b'<svg xmlns:xlink="http://www.w3.org/1999/xlink" width="10pt" viewBox="0 0 10 20">'
        b"<metadata>made by</metadata><defs><style>*{color:red}</style></defs>"
        b'<g id="unused"><!-- secret --><path id="a" d="M 1.23456 2 \nL 3 4 \nz\n" '
        b'style="fill: #ffffff; stroke: #123456"/></g>'
        b'<g id="empty"/><use xlink:href="#a" x="1.98765" clip-path="url(#clip)"/>'
        b'<clipPath id="clip"/></svg>'
    )

    def test_what_is_not_the_figure_goes(self):
        content, box = page_svg.inline(self.SVG, name="f1", styles=page_svg.Styles())
        assert box == "0 0 10 20"
        for gone in ("metadata", "secret", "style", "xlink", "unused", "empty", "http"):
            assert gone not in content

    def test_ids_get_the_figures_name_and_references_follow(self):
        one, _ = page_svg.inline(self.SVG, name="f1", styles=page_svg.Styles())
        other, _ = page_svg.inline(self.SVG, name="f2", styles=page_svg.Styles())
        ids = re.findall(r' id="([^"]+)"', one)
        assert len(ids) == 2
        assert not set(ids) & set(re.findall(r' id="([^"]+)"', other))
        assert set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', one)) == {
            (ids[0], ""),
            ("", ids[1]),
        }

    def test_numbers_are_short_and_the_path_is_the_same(self):
        content, _ = page_svg.inline(self.SVG, name="f1", styles=page_svg.Styles())
        assert 'd="M1.23 2L3 4z"' in content
        assert 'x="1.99"' in content

    def test_black_and_white_can_change_and_other_colours_stay(self):
        styles = page_svg.Styles()
        content, _ = page_svg.inline(self.SVG, name="f1", styles=styles)
        (name,) = re.findall(r'class="(\w+)"', content)
        assert styles.css() == (f".{name}{{fill:var(--f-ffffff,#ffffff);stroke:#123456}}")
        assert "--f-ffffff:#17191c;" in page_svg.dark_css()

    def test_a_style_is_written_once_for_all_figures(self):
        styles = page_svg.Styles()
        for name in ("f1", "f2"):
            page_svg.inline(self.SVG, name=name, styles=styles)
        assert styles.css().count("{") == 1

    @pytest.mark.parametrize("broken", [b"", b"<p>no</p>", b"<svg width='3'></svg>"])
    def test_what_is_no_figure_is_refused_by_name(self, broken):
        with pytest.raises(DataError, match="f7"):
            page_svg.inline(broken, name="f7", styles=page_svg.Styles())


class TestCells:
    @pytest.mark.parametrize(
        ("given", "text"),
        [
            ((0.187, 0.184, 0.191), "18.7 [18.4, 19.1]"),
            ((0.187,), "18.7"),
            ((0.187, np.nan, np.nan), "18.7"),
            ((np.nan, 0.1, 0.2), ""),
            ((None,), ""),
        ],
    )
    def test_a_number_stands_with_its_interval(self, given, text):
        assert page_cells.number(*given, scale=100.0).text == text

    def test_it_is_sorted_by_the_number_that_is_shown(self):
        assert page_cells.number(0.187, scale=100.0).value == pytest.approx(18.7)
        assert page_cells.word("as shared").value is None

    def test_a_column_of_numbers_is_one_even_with_gaps(self):
        rows = [[page_cells.word("a"), page_cells.number(None)],
                [page_cells.word("b"), page_cells.number(1.0)]]  # fmt: skip
        assert page_cells.table("x", "x", ["name", "value"], rows).numeric == (False, True)


class TestTables:
    def test_the_middle_of_the_matched_points_is_shown(self):
        table = page_tables.matched_table(make_matched(), make_summary(), [], dataset="students03")
        ((*_, at, fid, fixed, difference),) = table.rows
        assert at.text == "2.0"
        assert fid.text == "30.0 [20.0, 40.0]"
        assert fixed.text == "35.0 [30.0, 40.0]"
        assert difference.text == "-2.0 [-3.0, -1.0]"

    def test_only_the_strongest_attack_of_those_matched_is_shown(self, task):
        others = [
            make_matched().assign(consumer=f"rerelease/{name}", knowledge=knows, metric="rank1")
            for name in ("shape", "shape@radial_rts")
            for knows in ("blind", "informed", "oracle")
        ]
        table = page_tables.matched_table(
            pd.concat(others), make_summary(), [task], dataset="students03"
        )
        assert [(row[3].text, row[4].text) for row in table.rows] == [
            ("rerelease/shape@radial_rts", "informed")
        ]

    def test_after_attack_shows_the_levels_that_tell_and_the_controls(self):
        table = page_tables.attack_table(make_summary(), dataset="students03")
        shown = {(row[0].text, row[1].text, row[2].text) for row in table.rows}
        assert ("fixed", "linear", "0.7") in shown
        assert ("fixed", "linear", "0.4") not in shown
        assert ("offset", "linear", "0.4") in shown
        assert ("raw", "", "") in shown

    def test_cells_that_measure_nothing_are_listed_with_the_reason(self):
        frame = make_linkability().iloc[:4].copy()
        frame.loc[0, "invalid"] = "noise_level"
        frame.loc[1, "outcome"] = "attack too weak"
        frame.loc[2, "outcome"] = "no link detected"
        table = page_tables.doubt_table(frame)
        assert [row[-1].text for row in table.rows] == [
            "invalid: noise_level tells people apart",
            "attack too weak: it fails on clean too",
        ]

    def test_the_verdict_has_a_table_for_each_section(self):
        found = page_tables.verdict_tables(VERDICT["items"])
        assert list(found) == ["validity", "inflation"]
        (row,) = found["validity"].rows
        assert row[0].text == "✗ does not track"
        assert row[2].text == "-48.1 [-54.8, -41.7] points"
        inflated, undecided = found["inflation"].rows
        assert inflated[2].text == "3.29 [3.17, 3.44] times"
        assert undecided[1].text.endswith("Undecided: too few people.")
        assert undecided[2].text == ""

    def test_the_contrasts_name_what_is_compared(self):
        rows = page_tables.contrast_table(VERDICT["items"]).rows
        assert [(row[4].text, row[5].text, row[6].text) for row in rows] == [
            ("correlated", "0.5", "✗ differs"),
            ("fid", "", "✓ equal"),
        ]


class TestMechanisms:
    @pytest.mark.parametrize(
        ("name", "rule", "is_control"),
        [
            ("raw", "", False),
            ("clean", "", False),
            ("fid", "linear", False),
            ("fixed:adding=independent", "independent", False),
            ("offset", "", True),
            ("thin", "", True),
            ("thin:d_sigma=0.75", "linear", True),
            ("thin:adding=independent,d_sigma=0.75", "independent", True),
            ("my_file:Mine", "linear", True),
        ],
    )
    def test_rule_and_kind_are_read_off_the_name(self, name, rule, is_control):
        assert page_figures.rule_of(name) == rule
        assert page_figures.is_control(name) is is_control


class TestTheStrongest:
    def test_the_oracle_is_never_it(self, task):
        assert page_figures.strongest_link(task) == Source("shape@radial_rts", "informed")
        found = page_figures.strongest_reconstruction(make_summary(), dataset="students03")
        assert found == Source("radial_rts", "informed")

    def test_controls_do_not_count(self):
        frame = make_linkability()
        of = (frame["consumer"] == "rerelease/shape") & frame["mechanism"].isin(
            ["offset", "correlated", "clean"]
        )
        frame.loc[of, "rank1"] = 1.0
        (found,) = page_figures.tasks_of(frame, dataset="students03")
        assert page_figures.strongest_link(found).consumer == "shape@radial_rts"


class TestTheHeatMap:
    def test_columns_run_from_no_error_to_the_controls(self, task):
        names = [f"{name} {level or ''}".strip() for name, level in page_heat._in_order(task.cells)]
        assert names[:2] == ["clean", "raw"]
        assert names[2:4] == ["fid 1000.0", "fid 1.0"]
        assert names.index("fixed 0.4") < names.index("fixed 1.0") < names.index("offset 0.4")

    def test_the_image_holds_rank_1_in_percent_and_each_number_is_printed(self, task):
        with figure_style.style():
            figure = page_heat.heat_figure(task)
        linear, independent = figure.axes
        values = linear.images[0].get_array()
        assert values.shape == (6, 2 + 2 + 3 + 3)
        assert values[0, 1] == pytest.approx(100 * (0.9 * 0.4 - 0.01))
        assert independent.images[0].get_array().shape == (6, 2 + 2 + 3 + 2)
        printed = sum(
            len(line.get_xdata()) for line in linear.lines if line.get_linestyle() == "None"
        )
        assert printed == sum(len(f"{value:.0f}") for value in values.flat)

    def test_marks_say_what_is_not_to_be_read(self):
        row = {"outcome": "links", "rank1": 0.564, "invalid": ""}
        assert page_heat._cell_text(row) == "56"
        assert page_heat._cell_text(row | {"outcome": "attack too weak"}) == "?"
        assert page_heat._cell_text(row | {"outcome": "no link detected"}) == "~56"

    def test_an_invalid_cell_is_crossed_out(self):
        frame = make_linkability()
        frame.loc[frame["mechanism"] == "raw", "invalid"] = "frame"
        (found,) = page_figures.tasks_of(frame, dataset="students03")
        with figure_style.style():
            figure = page_heat.heat_figure(found)
        crosses, _ = figure.axes[0].collections
        segments = crosses.get_segments()
        assert len(segments) == 2 * 6
        assert {tuple(np.sort(segment[:, 0])) for segment in segments} == {(0.5, 1.5)}
        assert "crossed out: a shortcut leaks" in [
            text.get_text() for text in figure.legends[0].get_texts()
        ]


class TestDescriptorAgainstLinkability:
    def test_points_pair_the_descriptor_with_rank_1_of_one_level(self, task):
        points = page_figures.dissociation_points(make_summary(), task, dataset="students03")
        assert "clean" not in set(points["mechanism"])  # its descriptors were not measured
        offset = points[points["mechanism"] == "offset"].iloc[0]
        assert offset["plr"] == 0.0
        assert offset["rank1"] == pytest.approx(0.6 - 0.01 * LEVELS.index(("offset", 0.4)))

    def test_controls_are_marked_and_a_descriptor_of_zero_is_on_the_axis(self, task):
        with figure_style.style():
            figure = page_figures.dissociation_figure(make_summary(), task, dataset="students03")
            figure.draw_without_rendering()
        assert len(figure.axes) == 6
        labels = [text.get_text() for text in figure.legends[0].get_texts()]
        assert {"control: offset", "control: correlated", "control: thin"} <= set(labels)
        ael = figure.axes[1]
        assert ael.get_xscale() == "symlog"
        (diamond,) = [line for line in ael.lines if line.get_marker() == "D"]
        assert list(diamond.get_xdata()) == [0.0]
        low, high = ael.get_xlim()
        assert low < 0.0 < high

    def test_without_a_sweep_there_is_no_figure(self, task):
        frame = make_summary()
        alone = frame[frame["mechanism"].isin(["raw", "offset"])]
        assert page_figures.dissociation_figure(alone, task, dataset="students03") is None


class TestTheCurves:
    def test_compared_is_the_fixed_noise_that_costs_most_nearly_the_same(self):
        frame = make_summary()
        wheres = page_figures.compared_levels(frame, dataset="students03")
        # Misses rise along LEVELS: fid 1 costs less than any fixed level of its rule.
        assert wheres == [
            ("raw", None),
            ("fid", 1.0),
            ("fixed", 0.4),
            ("fid:adding=independent", 1.0),
            ("fixed:adding=independent", 0.4),
        ]

    def test_every_score_is_a_line_in_percent(self):
        with figure_style.style():
            figure = page_figures.curves_figure(make_curves(), make_summary(), dataset="students03")
        lines = [line for line in figure.axes[0].lines if len(line.get_xdata()) > 1]
        assert len(lines) == 2
        np.testing.assert_allclose(lines[0].get_xdata(), [0, 50, 100])
        np.testing.assert_allclose(lines[0].get_ydata(), [100, 50, 0])
        (point,) = [line for line in figure.axes[0].lines if len(line.get_xdata()) == 1]
        assert point.get_xydata().tolist() == [[pytest.approx(15.0), pytest.approx(10.0)]]


def gallery(ready, *specs):
    mechanisms = [plugin for spec in specs for plugin in registry.parse("mechanisms", spec)]
    return page_gallery.gallery_rows(
        tracks=ready.tracks,
        mechanisms=mechanisms,
        attacks=(),
        stages=ready.settings.stages,
        seed=0,
    )


@pytest.fixture(scope="module")
def found(ready):
    return gallery(ready, "raw", "fid:1", "fid:100", "fixed:0.2", "fixed:0.8")


@pytest.fixture(scope="module")
def ready():
    return plan(Settings(preset="smoke", dataset="plaza", scenes=2, attacks=(), tasks=()))


class TestTheGallery:
    def test_four_people_under_three_mechanisms(self, found):
        assert list(found.columns) == page_gallery.COLUMNS
        assert list(found["mechanism"].unique()) == ["raw", "fid:1", "fixed:0.8"]
        assert found["track"].nunique() == 4
        assert set(found["attack"]) == {"radial_rts"}

    def test_a_leak_is_a_place_within_epsilon_of_the_truth(self, found):
        for what, leaked in (("shared", "leaked_shared"), ("rec", "leaked_rec")):
            distance = np.hypot(
                found[f"x_{what}"] - found["x_true"], found[f"y_{what}"] - found["y_true"]
            )
            sure = abs(distance - 0.3) > 0.002  # positions are kept in millimetres
            np.testing.assert_array_equal((distance < 0.3)[sure], found[leaked][sure])

    def test_the_truth_is_the_same_whatever_is_shared(self, found):
        raw, fid = (found[found["mechanism"] == name] for name in ("raw", "fid:1"))
        np.testing.assert_array_equal(raw[["t", "x_true"]], fid[["t", "x_true"]])
        assert fid["leaked_shared"].mean() < raw["leaked_shared"].mean()

    def test_without_any_error_everything_leaks(self, ready):
        clean = gallery(ready, "clean")
        assert clean["leaked_shared"].all()
        np.testing.assert_array_equal(clean["x_shared"], clean["x_true"])

    def test_samples_that_are_not_shared_are_not_shown(self, ready):
        whole, thin = gallery(ready, "clean"), gallery(ready, "thin:4")
        assert 0.2 < len(thin) / len(whole) < 0.3
        assert (thin.groupby("track")["t"].diff().dropna() > 0).all()
        # What is shared lies about the truth of its own instant, not of another one.
        assert np.hypot(thin["x_shared"] - thin["x_true"], 0).median() < 1.0

    def test_it_is_kept_and_read_again(self, found, tmp_path):
        page_gallery.write_gallery([found], out=tmp_path)
        pd.testing.assert_frame_equal(page_gallery.read_gallery(tmp_path), found)
        assert page_gallery.read_gallery(tmp_path / "other") is None

    @pytest.mark.parametrize("content", [b"no parquet", None])
    def test_a_broken_one_is_an_error_that_says_what_to_do(self, tmp_path, content):
        path = tmp_path / page_gallery.GALLERY
        if content is None:
            pd.DataFrame({"other": [1]}).to_parquet(path)
        else:
            path.write_bytes(content)
        with pytest.raises(DataError, match="delete it"):
            page_gallery.read_gallery(tmp_path)

    def test_the_figure_has_a_panel_for_each_and_says_what_leaks(self, found):
        with figure_style.style():
            figure = page_gallery.gallery_figure(found)
            figure.draw_without_rendering()
        assert len(figure.axes) == 4 * 3
        part = found[(found["track"] == found["track"].iloc[0]) & (found["mechanism"] == "raw")]
        assert next(text.get_text() for text in figure.axes[0].texts) == (
            f"leaks: shared {100 * part['leaked_shared'].mean():.0f} %, "
            f"rebuilt {100 * part['leaked_rec'].mean():.0f} %"
        )
        assert page_gallery.gallery_figure(found.head(0)) is None


class TestTheCommand:
    def test_it_is_the_one_given_with_data_set_and_seed(self):
        assert page_words.command(MANIFEST) == (
            "python -m evaluation.matrix --out 'a run' --dataset students03 --seed 3"
        )

    def test_what_was_named_is_not_named_twice(self):
        manifest = copy.deepcopy(MANIFEST)
        manifest["environment"]["command"] = ["/bin/isac-track", "matrix", "--seed=3", "--dataset",
                                              "walks.csv"]  # fmt: skip
        assert page_words.command(manifest) == (
            "python -m evaluation.matrix --seed=3 --dataset walks.csv"
        )

    def test_a_run_from_python_names_all_of_its_axes_and_what_was_changed(self):
        manifest = copy.deepcopy(MANIFEST)
        manifest["environment"]["command"] = ["/lib/ipykernel_launcher.py", "-f", "x"]
        manifest["settings"]["stages"]["privacy.epsilon_m"] = 0.5
        assert page_words.command(manifest) == (
            "python -m evaluation.matrix --preset paper --scenes 500 --mechanism raw --mechanism "
            "fid:1 --predictor least_squares --attack none --task rerelease --set "
            "privacy.epsilon_m=0.5 --dataset students03 --seed 3"
        )


class TestWords:
    def test_the_headline_is_told_in_numbers(self, task):
        said = page_words.words(
            "headline",
            summary=make_summary(),
            tasks=[task],
            gallery=None,
            dataset="students03",
        )
        assert "PLR after radial_rts (informed) 90.0 % at η = 1 to 90.0 % at η = 1000" in said.text

    def test_every_name_of_a_figure_is_known(self, made):
        assert {path.split('"')[0] for path in made.split('id="fig-')[1:]} <= set(figures.NAMES)


def test_the_templates_are_where_the_package_is():
    folder = Path(page.__file__).with_name("templates")
    assert {path.name for path in folder.iterdir()} >= {
        "report.html.j2",
        "report.css",
        "report.js",
    }
