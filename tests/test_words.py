"""Plain English where everybody reads: lengths of sentences, and of the README.

Words to avoid are listed, not refused: `pytest tests/test_words.py -s` prints them.
"""

import re
from collections import Counter
from contextlib import redirect_stdout
from functools import partial
from importlib import import_module
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from helpers.finished_runs import (
    emptied,
    everything,
    make_run,
    make_summary,
    with_links,
)
from helpers.summaries import BAD, GOOD, RAW, SHIFTED, changed, write_run

from evaluation.reporting.answers import answers
from evaluation.reporting.design_words import answer_question, to_json
from evaluation.reporting.first_screen import first_screen
from evaluation.verdict.question import Question

ROOT = Path(__file__).parent.parent
PAGES: tuple[str, ...] = ("README.md",)
"""Pages that must keep within the limits."""
MOST_WORDS = 25
MOST_LINES, MOST_COLUMNS = 120, 100
AVOIDED = re.compile(
    r"\b(one|ones|who|whom|whoever|found|told|kept|alike|gone|somebody|nobody|what is"
    r" left)\b",
    re.IGNORECASE,
)
COMMANDS = {
    "matrix": "evaluation.matrix",
    "report": "evaluation.report",
    "design": "evaluation.design",
    "compare": "evaluation.compare",
    "sensitivity": "evaluation.sensitivity",
    "study": "evaluation.study",
    "attacks": "attacks.__main__",
}
RUNS = {
    "all": make_run,
    "linked": lambda: with_links(make_run()),
    "everything": everything,
    "raw alone": lambda: make_run(at=[("raw", np.nan)]),
    "a stranger": lambda: with_links(make_run(at=[("ou", 0.2), ("ou", 0.4)])),
    "no predictor": lambda: make_run(summary=make_summary(predictors=())),
    "no attack": lambda: make_run(summary=make_summary(attacks=()), strongest={}),
    "no verdict": lambda: make_run(verdict={}),
    "nothing": lambda: make_run(**emptied(make_run()), verdict={}, strongest={}),
}
QUESTIONS = {
    "usual": {},
    "missed": {"limits": {"missed": 0.21, "plr": 0.5}},
    "all": {
        "limits": {
            "missed": 0.1,
            "false_alarm": 0.05,
            "plr": 0.1,
            "ael": 0.5,
            "rank1": 0.1,
        }
    },
    "against": {"against": ("anchor", "insider")},
    "as sent": {"as_shared": True},
}


def sentences(text):
    """The sentences of a text; they end with a stop, colon, semicolon or paragraph."""
    plain = re.sub(r"`[^`]*`", "CODE", text)
    paragraphs = re.split(r"\n\s*\n|\n(?=[-*|] )", plain)
    return [
        sentence
        for paragraph in paragraphs
        for sentence in re.split(r"(?<=[.;:?!])\s+", " ".join(paragraph.split()))
    ]


def n_words(sentence):
    """Words of a sentence; numbers, units, signs and options are none."""
    return sum(
        bool(re.fullmatch(r"[(\"'\w]*[A-Za-z].*", word)) for word in sentence.split()
    )


def too_long(text):
    """Sentences with more than `MOST_WORDS` words."""
    return [sentence for sentence in sentences(text) if n_words(sentence) > MOST_WORDS]


def list_avoided(name, text):
    """Print the words of a text that a plain word should replace."""
    if counts := Counter(word.lower() for word in AVOIDED.findall(text)):
        print(name, *(f"{word}: {n}" for word, n in counts.most_common()), sep="; ")  # noqa: T201 - a list to read


def page_faults(page):
    """Where a page of Markdown leaves its limits."""
    lines = page.splitlines()
    wide = [f"wide: {line}" for line in lines if len(line) > MOST_COLUMNS]
    long = [f"long: {sentence}" for sentence in too_long(prose(page))]
    many = [f"{len(lines)} lines"] if len(lines) > MOST_LINES else []
    return many + wide + long


def prose(page):
    """A page of Markdown without code, tables, pictures, comments and link targets."""
    text = re.sub(r"```.*?```|<!--.*?-->|!\[.*?\]\(.*?\)", "", page, flags=re.DOTALL)
    text = re.sub(r"^(\||#).*$", "\n", text, flags=re.MULTILINE)
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)


class TestTheMeasure:
    def test_a_long_sentence_is_reported_and_a_list_is_not(self):
        long = "word " * (MOST_WORDS + 1)
        assert too_long(f"Short. {long}.") == [f"{long.strip()} ."]
        assert too_long("; ".join(["three short words"] * MOST_WORDS)) == []

    def test_options_and_numbers_are_no_words(self):
        assert n_words("It takes 3 m ±2 and `code` --set a.b=1") == 5

    def test_words_to_avoid_are_counted(self, capsys):
        list_avoided("text", "Somebody who told one. Someone else.")
        assert capsys.readouterr().out.count(": 1") == 4

    def test_a_page_is_held_to_its_lines_columns_and_sentences(self):
        many, long = page_faults("word\n" * MOST_LINES + "word")
        assert (many, long) == (
            f"{MOST_LINES + 1} lines",
            f"long: {'word ' * MOST_LINES}word",
        )
        assert page_faults("`" + "c" * MOST_COLUMNS + "`") == [
            f"wide: `{'c' * MOST_COLUMNS}`"
        ]
        code = f"```\n{'word ' * 19}word\n```\n| {'cell ' * 15}|\nShort."
        assert page_faults(code) == []


@pytest.mark.parametrize("name", RUNS)
def test_the_first_screen_has_short_sentences(name):
    run = RUNS[name]()
    text = "\n\n".join(re.sub(r"\n  ", " ", "\n".join(first_screen(run))).splitlines())
    list_avoided(f"first screen, {name}", text)
    assert too_long(text) == []


@pytest.mark.parametrize("name", RUNS)
def test_the_answers_have_short_sentences(name):
    for answer in answers(RUNS[name]()):
        text = " ".join([answer.sentence, *answer.details])
        list_avoided(f"answer {answer.topic}, {name}", text)
        assert too_long(text) == []


@pytest.mark.parametrize("name", QUESTIONS)
def test_design_answers_in_short_sentences(name, tmp_path):
    broken = changed(
        GOOD, level=0.5, missed=0.3, plr=0.2, beyond={"repeats": 0.6, "anchor": 0.4}
    )
    for levels in ((RAW, GOOD, broken, BAD), (RAW, BAD, SHIFTED)):
        out = write_run(tmp_path / str(len(levels)), levels)
        question = Question(adding=("independent",), **QUESTIONS[name])
        answer = to_json(answer_question(out, question))
        text = "\n\n".join([answer["answer"], *answer["notes"]])
        list_avoided(f"design, {name}", text)
        assert too_long(text) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_short_sentences(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "500")
    main = partial(import_module(COMMANDS[name]).main, ["--help"])
    with redirect_stdout(StringIO()) as sink:
        try:
            main()
        except SystemExit as end:
            assert end.code == 0  # noqa: PT017 - of argparse
    _, _, text = sink.getvalue().partition("\n\n")
    # A line of help is a paragraph; the examples are code.
    prose_of_help = "\n\n".join(text.partition("examples:")[0].splitlines())
    list_avoided(f"help of {name}", prose_of_help)
    assert prose_of_help
    assert too_long(prose_of_help) == []


@pytest.mark.parametrize("page", PAGES)
def test_a_page_keeps_within_its_limits(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    list_avoided(page, prose(text))
    assert page_faults(text) == []
