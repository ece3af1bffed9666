"""The answer in words, as tables and JSON."""

import io
import json
from functools import partial
from pathlib import Path

import pytest
from helpers.pages import assert_as_approved
from helpers.summaries import asked, write_run
from rich.console import Console

from evaluation.reporting.design_words import show, to_json

LIMITS = {"missed": 0.23, "plr": 0.42, "rank1": 0.44}


def shown(choice, *, width=116):
    raw = io.StringIO()
    show(choice, console=Console(file=raw, width=width, highlight=False))
    return raw.getvalue()


@pytest.fixture
def made(tmp_path):
    return partial(write_run, tmp_path / "run")


def test_the_answer_is_letter_for_letter_what_was_read_and_approved(made, tmp_path):
    # Limits stand above what they are about, but not above a simulated task.
    cells = {
        ("split", "shape", "informed"): {"rank1": 0.01, "outcome": "no link detected"},
        ("rerelease", "shape", "informed"): {"rank1": 0.40},
        ("new_traversal", "shape", "blind"): {"rank1": 0.80},
    }
    out = made(cells=cells)
    answer = asked(out, as_shared=True, **LIMITS)
    after = asked(out, missed=0.23, plr=0.9, adding=("linear",))
    parts = [shown(answer, width=80), shown(after), json.dumps(to_json(after), indent=1)]
    text = "\n".join(parts).replace(str(tmp_path), "")
    assert_as_approved(text, Path(__file__).with_name("design.txt"))
