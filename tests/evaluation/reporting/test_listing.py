"""`--list`: a line for everything that can be named."""

import pytest

from attacks.tasks.task_list import ALL_TASKS
from evaluation.reporting.listing import (
    SETTINGS,
    WIDTH,
    listing,
    read_class_summary,
    shorten_text,
)
from isac_track import plugins
from isac_track.config import StageSettings


@pytest.fixture(scope="module")
def sections():
    lines_by_title, title = {}, ""
    for line in listing():
        if line.endswith(":") and not line.startswith(" "):
            title = line.removesuffix(":")
            lines_by_title[title] = []
        elif line:
            lines_by_title[title].append(line.strip())
    return lines_by_title


def test_no_line_is_too_wide(sections):
    assert max(map(len, listing())) <= WIDTH
    assert all(sections.values())


@pytest.mark.parametrize("kind", ["mechanisms", "predictors", "attacks", "policies"])
def test_every_plugin_is_a_line_that_says_what_it_is(kind, sections):
    names = plugins.names(kind)
    lines = sections[kind]
    assert [line.split(":")[0].split()[0] for line in lines] == [*names]
    for line, origin in zip(lines, names.values(), strict=True):
        assert origin not in line
        assert len(line.split()) > 3


def test_a_mechanism_has_its_level_and_the_unit(sections):
    lines = " ".join(sections["mechanisms"])
    for expected in (
        "fid:ETA (1/(m^2 s))",
        "fixed:D_SIGMA (m)",
        "ou:STD_M (m)",
        "thin:EVERY (samples)",
    ):
        assert expected in lines


def test_every_setting_has_its_value_unit_and_words(sections):
    lines = dict(
        zip(
            StageSettings().flat(), sections["settings (--set NAME=VALUE)"], strict=True
        )
    )
    assert SETTINGS.keys() == lines.keys()
    assert lines["privacy.epsilon_m"].split(maxsplit=3)[1:3] == ["0.3", "m"]
    assert lines["sensing.carrier_ghz"].split(maxsplit=3)[1:3] == ["3.5", "GHz"]
    for name, text in SETTINGS.items():
        assert lines[name].endswith(text)


def test_every_task_is_a_line(sections):
    assert [line.split()[0] for line in sections["tasks"]] == [*ALL_TASKS]


def test_a_source_is_read_and_not_run(tmp_path, monkeypatch):
    text = (
        'raise SystemExit\n\nclass Mine:\n    """Hide.\n\n    More."""\n    std_m:'
        " float = 1.0\n"
    )
    (tmp_path / "mine_unrun.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    summary = read_class_summary("mine_unrun:Mine")
    assert (summary.about, summary.parameter) == ("Hide.", "std_m")
    assert read_class_summary("mine_unrun:Other").about == ""
    assert read_class_summary("no_such_module:Mine").about == ""
    assert read_class_summary("no_such.module:Mine").about == ""


@pytest.mark.parametrize(
    ("text", "room", "short"),
    [
        ("Whole.", 20, "Whole."),
        ("The first clause; a second one", 20, "The first clause"),
        ("No clause at all to cut this at", 16, "No clause at ..."),
    ],
)
def test_a_text_is_cut_at_a_clause_or_a_word(text, room, short):
    assert shorten_text(text, room=room) == short
