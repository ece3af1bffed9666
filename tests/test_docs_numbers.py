"""A finding stands with its number on a single page of the documentation.

Two sentences on different pages are the same finding if they share a number with its
unit and three longer words. Tables, code and `docs/results/` are not read.
"""

import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"
CONSTANTS = {
    "95 %": "the confidence of every interval",
    "97.5 %": "replicates that must reach a point",
    "0.3 m": "the usual epsilon",
    "0.93 s": "the paper's horizon",
    "3 s": "the further horizon of a run",
    "10 points": "the largest rise of missed conflicts that is compared",
    "0.7 %": "chance among 138 candidates",
}
"""Definitions, which pages repeat to be read alone; no findings."""
NUMBER = re.compile(
    r"(?<![\w.,\[-])(\d[\d,]*(?:\.\d+)?) ?"
    r"(%|points?|ms|us|m|s|min|h|nats|dB|Hz|MB|GB|degrees)(?![\w/²^])"
)
LEAST_SHARED = 3
COMMON = {
    *("about", "conflicts", "every", "level", "levels", "people", "positions"),
    *("share", "shared", "that", "their", "there", "these", "this", "those", "which"),
    *("with", "where", "would", "interval", "intervals", "than", "more", "less"),
    *("point", "points", "under"),
}


def prose_sentences(page):
    """The sentences of a page of Markdown without code, tables, notes and heads."""
    text = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
    text = re.sub(r"^\s*[|#>].*$", "\n", text, flags=re.MULTILINE)
    text = re.sub(r"\]\([^)]*\)|`[^`]*`", "]", text)
    return [
        sentence
        for paragraph in re.split(r"\n\s*\n|\n(?=[-*] )", text)
        for sentence in re.split(r"(?<=[.:;?!])\s+", " ".join(paragraph.split()))
    ]


def words(sentence):
    """The longer words of a sentence that say what it is about."""
    return {word.lower() for word in re.findall(r"[A-Za-z]{4,}", sentence)} - COMMON


def repeated(pages):
    """Numbers that two of the pages, texts by name, give for the same finding."""
    places = defaultdict(dict)
    for name, page in pages.items():
        for sentence in prose_sentences(page):
            for value, unit in NUMBER.findall(sentence):
                places[f"{value} {unit}"].setdefault((name, sentence))
    return [
        (number, first, second)
        for number, by_place in places.items()
        if number not in CONSTANTS
        for first, second in combinations(by_place, 2)
        if first[0] != second[0]
        and len(words(first[1]) & words(second[1])) >= LEAST_SHARED
    ]


def test_a_repeated_finding_is_reported_and_another_is_not():
    steps = "18.7 % of the steps of the recording stand still."
    other = "The attack gains 18.7 % under slow noise."
    table = "| steps of the recording that stand | 18.7 % |"
    assert len(repeated({"a": steps, "b": f"Many wait: {steps}"})) == 1
    assert repeated({"a": steps, "b": other, "c": table}) == []
    assert repeated({"a": f"{steps} {steps}"}) == []


def test_each_finding_has_its_number_on_one_page():
    pages = {
        path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8")
        for path in sorted(DOCS.rglob("*.md"))
        if path.relative_to(DOCS).parts[0] != "results"
    }
    assert repeated(pages) == []
