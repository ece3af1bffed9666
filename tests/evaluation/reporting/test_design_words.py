"""The answer of `design` in words, as a table and as JSON."""

import io
import json
from functools import partial
from pathlib import Path

import pytest
from helpers.pages import assert_as_approved
from helpers.summaries import BAD, GOOD, PATROLS, RAW, changed, write_run
from rich.console import Console

from evaluation.reporting.design_words import answer_question, show, to_json
from evaluation.verdict.question import USUAL, Question

INDEPENDENT = ("independent",)


def shown(answer, *, width=116, verbose=False):
    raw = io.StringIO()
    show(
        answer, verbose=verbose, console=Console(file=raw, width=width, highlight=False)
    )
    return raw.getvalue()


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


def test_the_answer_is_letter_for_letter_what_was_read_and_approved(made, tmp_path):
    broken = changed(
        GOOD, level=0.5, missed=0.3, plr=0.2, beyond={"repeats": 0.6, "anchor": 0.4}
    )
    out = made((RAW, GOOD, broken, BAD))
    limits = {**USUAL, "missed": 0.35, "rank1": 0.5}
    questions = [
        Question(adding=INDEPENDENT),
        Question(adding=INDEPENDENT, limits=limits, against=("repeats", "companions")),
        Question(adding=INDEPENDENT, limits={**USUAL, "plr": 0.1}),
    ]
    answers = [answer_question(out, question) for question in questions]
    parts = [shown(answers[0], width=80), *map(shown, answers[1:])]
    parts += [shown(answer, verbose=True) for answer in answers]
    parts.append(json.dumps(to_json(answers[0]), indent=1))
    patrolled = write_run(tmp_path / "patrolled", (RAW, GOOD), options=PATROLS)
    answer = answer_question(patrolled, Question(adding=INDEPENDENT))
    parts += [shown(answer), shown(answer, verbose=True)]
    text = "\n".join(parts).replace(str(tmp_path), "")
    assert_as_approved(text, Path(__file__).with_name("design.txt"))


@pytest.mark.parametrize("width", [80, 116])
@pytest.mark.parametrize(
    "limits",
    [USUAL, {**USUAL, "missed": 0.1}, {**USUAL, "plr": 0.1, "rank1": 0.1, "ael": 0.5}],
)
def test_the_short_answer_has_twelve_lines(made, limits, width):
    broken = changed(
        GOOD, level=0.5, missed=0.3, plr=0.2, beyond={"repeats": 0.6, "anchor": 0.4}
    )
    out = made((RAW, GOOD, broken, BAD))
    lines = shown(
        answer_question(out, Question(adding=INDEPENDENT, limits=limits)), width=width
    )
    assert len(lines.splitlines()) <= 12
    assert max(map(len, lines.splitlines())) <= width


def test_a_yes_names_the_adversary_of_the_run_that_breaks_it(made):
    broken = changed(GOOD, beyond={"anchor": 0.92})
    question = Question(adding=INDEPENDENT)
    text = " ".join(shown(answer_question(made((RAW, broken)), question)).split())
    assert text.startswith(
        "Yes, against one release, but not an adversary with one true position:"
    )
    assert "knows 92 % ±2 of positions; to make it count: --against anchor." in text


def test_too_few_people_are_in_the_answer(made):
    out = made((RAW, GOOD), would_help="the longest last 9.0 s", tracks_used=18)
    answer = answer_question(out, Question(adding=INDEPENDENT))
    assert "Doubt: 18 usable tracks: too few to decide anything" in shown(answer)
    assert any("18 usable tracks" in note for note in to_json(answer)["notes"])


@pytest.mark.parametrize(
    ("times", "expected"), [(3.0, "about 1,500 scenes"), (1e7, "no realistic number")]
)
def test_the_number_of_people_that_would_decide_is_one_that_can_exist(
    made, times, expected
):
    half = 0.1
    value = 0.5 + half / times**0.5
    out = made((RAW, changed(GOOD, plr=value, wide=0.3, half=half)))
    answer = answer_question(out, Question(adding=INDEPENDENT, limits={"plr": 0.5}))
    (reason,) = [
        check["reason"]
        for check in to_json(answer)["nearest"]["checks"]
        if check["name"] == "plr"
    ]
    assert expected in reason
