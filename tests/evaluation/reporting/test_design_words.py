"""The answer in words, as a table and JSON."""

import io
import json
from functools import partial
from pathlib import Path

import pytest
from helpers.pages import assert_as_approved
from helpers.summaries import BAD, GOOD, RAW, changed, write_run
from rich.console import Console

from evaluation.reporting.design_words import answer_of, show, to_json
from evaluation.verdict.what_to_share import USUAL, Question

INDEPENDENT = ("independent",)


def shown(answer, *, width=116):
    raw = io.StringIO()
    show(answer, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


def test_the_answer_is_letter_for_letter_what_was_read_and_approved(made, tmp_path):
    broken = changed(GOOD, level=0.5, missed=0.3, plr=0.2, beyond={"repeats": 0.6, "anchor": 0.4})
    out = made((RAW, GOOD, broken, BAD))
    limits = {**USUAL, "missed": 0.35, "rank1": 0.5}
    questions = [
        Question(adding=INDEPENDENT),
        Question(adding=INDEPENDENT, limits=limits, against=("repeats", "companions")),
        Question(adding=INDEPENDENT, limits={**USUAL, "plr": 0.1}),
    ]
    answers = [answer_of(out, question) for question in questions]
    parts = [shown(answers[0], width=80), *map(shown, answers[1:])]
    parts.append(json.dumps(to_json(answers[0]), indent=1))
    text = "\n".join(parts).replace(str(tmp_path), "")
    assert_as_approved(text, Path(__file__).with_name("design.txt"))
