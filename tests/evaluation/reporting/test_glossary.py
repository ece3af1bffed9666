"""The glossary: a sentence for every name that a run can show, and hover text."""

import re
from pathlib import Path

import pytest
from helpers.finished_runs import (
    levels,
    make_gallery,
    make_run,
    make_summary,
    with_links,
)
from helpers.pages import Tags

from attacks.tasks.task_list import ALL_TASKS
from evaluation.estimates.metrics import METRICS
from evaluation.estimates.strongest import BEYOND, HEADLINE
from evaluation.reporting.glossary import (
    DEFINITIONS,
    GLOSSARY,
    definition,
    glossary_page,
    hinted,
    plain_name,
)
from evaluation.reporting.names import ATTACK_NAMES, FAMILY_NAMES, ROBOT_NAMES
from evaluation.reporting.page import render
from isac_track import plugins
from isac_track.config import StageSettings

ROOT = Path(__file__).parents[3]
MOST_WORDS = 25
LAWS = ("radial", "isotropic", "fixed_direction")
WORDS = (
    *LAWS,
    "linear",
    "independent",
    "epsilon",
    "eta",
    "chance",
    "handover",
    "interval",
    "front",
)


@pytest.mark.parametrize(
    "kind", ["mechanisms", "predictors", "attacks", "policies", "trackers"]
)
def test_every_built_in_plugin_has_a_sentence(kind):
    built_in = [
        name for name, path in plugins.names(kind).items() if "tests" not in path
    ]
    assert len(built_in) > 3
    assert not [name for name in built_in if not DEFINITIONS.get(name)]


def test_every_task_metric_adversary_and_word_has_a_sentence():
    heads = [metric.head for metric in METRICS.values()]
    names = [*ALL_TASKS, *heads, *HEADLINE, *BEYOND, "oracle", *WORDS]
    assert not [name for name in names if not DEFINITIONS.get(name)]
    assert StageSettings().flat()["sensing.law"] in LAWS


def test_every_plain_name_has_the_sentence_of_its_code_name():
    for names in (FAMILY_NAMES, ATTACK_NAMES, ROBOT_NAMES):
        for code, plain in names.items():
            assert DEFINITIONS[plain] == DEFINITIONS[code]
            assert plain_name(code) == plain


def test_sentences_are_short_and_end_with_a_point():
    for entries in GLOSSARY.values():
        for name, text in entries.items():
            assert text.endswith("."), name
            assert len(text.split()) <= MOST_WORDS, name


@pytest.mark.parametrize(
    ("shown", "name"),
    [
        ("FID noise, eta 1 (independent)", "fid"),
        ("radial_rts (informed)", "radial_rts"),
        ("rerelease/dtw@kalman_rts", "dtw"),
        ("kalman_cv", "kalman_cv"),
        ("fid:1,adding=independent", "fid"),
    ],
)
def test_a_name_with_a_level_or_an_adversary_has_the_sentence_of_its_kind(shown, name):
    assert definition(shown) == DEFINITIONS[name]


def test_a_name_of_a_user_has_no_sentence():
    assert definition("my.module:Mine") == ""


def test_hover_text_marks_each_name_once_and_escapes_the_rest():
    html = hinted("PLR <b> of PLR after kalman_rts")
    assert html.count("<abbr") == 2
    assert "<b>" not in html
    tags = Tags(html)
    assert "".join(tags.text) == "PLR <b> of PLR after kalman_rts"
    titles = [attributes["title"] for attributes in tags.attributes("abbr")]
    assert titles == [DEFINITIONS["PLR"], DEFINITIONS["kalman_rts"]]


def test_the_page_of_the_docs_is_that_of_the_code():
    assert (ROOT / "docs" / "reference" / "glossary.md").read_text(
        encoding="utf-8"
    ) == glossary_page()


@pytest.fixture(scope="module")
def made():
    """A run with many mechanisms, and its page."""
    others = [(name, 0.4) for name in ("ou", "laplace", "correlated", "offset")]
    at = levels(rules=("",), others=[*others, ("thin", 4.0)])
    summary = make_summary(at, predictors=("least_squares", "kalman_cv"))
    run = with_links(make_run(at=at, gallery=make_gallery(), summary=summary))
    return run, render(run)


def test_every_name_of_a_run_is_in_the_glossary_of_its_page(made):
    run, text = made
    section = text[
        text.index('<section id="words">') : text.index('<section id="again">')
    ]
    listed = set(re.findall(r"<dt>([^<]+?) ?(?:<span|</dt>)", section))
    consumers = {name for name in run.summary["consumer"] if "control-" not in name}
    parts = {part for name in consumers for part in re.split(r"[/@]", name)} - {
        "shared"
    }
    shown = {*parts, *run.summary["family"], *run.summary["knowledge"]} - {""}
    assert {
        "radial_rts",
        "least_squares",
        "rerelease",
        "fid",
        "informed",
        "thin",
    } <= shown
    assert shown <= listed


def test_cells_and_keys_have_hover_text(made):
    _, text = made
    assert f'title="{DEFINITIONS["fid"].replace(chr(39), "&#39;")}"' in text
    tags = Tags(text)
    assert {DEFINITIONS["raw"], DEFINITIONS["fid"]} <= {
        attributes["title"] for attributes in tags.attributes("abbr")
    }
    assert DEFINITIONS["linear"] in {
        attributes.get("title") for attributes in tags.attributes("td")
    }
