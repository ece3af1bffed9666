"""The examples of the documents run."""

import importlib
import re
import sys
from pathlib import Path

import pytest

from attacks.testing import run_checks
from evaluation import matrix

ROOT = Path(__file__).parent.parent
DOCS = sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("*.md")])


@pytest.mark.parametrize(
    "path", DOCS, ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_links_lead_somewhere(path):
    targets = re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text(encoding="utf-8"))
    targets += re.findall(r'src="(?!https?:)([^"]+)"', path.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (path.parent / target).exists()]
    assert missing == []


def misnamed_links(page):
    """Links of a Markdown page whose text names another file than their target."""
    links = re.findall(
        r"\[`?([\w./-]+\.(?:md|py|csv|json|toml|html|svg|txt))`?\]\((?!https?:|#)([^)#]+)",
        page,
    )
    return [
        (text, target)
        for text, target in links
        if Path(text).name != Path(target).name and Path(target).suffix
    ]


def test_a_misnamed_link_is_reported_and_a_title_is_not():
    stale = "[linkage.md](linkage-tasks.md#tasks)"
    good = "[linkage.md](../linkage.md), [`run.py`](a/run.py), [the tasks](tasks.md)"
    assert misnamed_links(stale) == [("linkage.md", "linkage-tasks.md")]
    assert misnamed_links(good) == []


@pytest.mark.parametrize(
    "path", DOCS, ids=lambda path: path.relative_to(ROOT).as_posix()
)
def test_a_link_that_names_a_file_leads_to_it(path):
    assert misnamed_links(path.read_text(encoding="utf-8")) == []


def test_sentences_quoted_from_the_readme_stand_there():
    page = (ROOT / "docs" / "explanation" / "tracking.md").read_text(encoding="utf-8")
    _, _, section = page.partition("## Which sentences of the README turn")
    quoted = re.findall(r"^\| \*([^*]+)\*", section.partition("\n## ")[0], re.MULTILINE)
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    plain = re.sub(r"\]\([^)]*\)|[*[]", "", readme)
    assert quoted
    assert [sentence for sentence in quoted if sentence not in plain] == []


@pytest.mark.usefixtures("undrawn", "single_process")
def test_the_plugin_guide_runs_as_it_stands(
    tmp_path, monkeypatch, csv_recording, capsys
):
    guide = (ROOT / "docs" / "how-to" / "plugins.md").read_text(encoding="utf-8")
    for name, code in re.findall(
        r"```python\n# (\w+\.py)\n(.*?)```", guide, flags=re.DOTALL
    ):
        (tmp_path / name).write_text(code, encoding="utf-8")
    # Commands with a module of the guide; the others need a package of `attacks new`.
    shown_commands = re.findall(r"python -m evaluation\.matrix (.+)", guide)
    commands = [text for text in shown_commands if re.search(r"\w:[A-Z]", text)]
    assert len(commands) == 2
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for number, command in enumerate(commands):
        options = f"--scenes 8 --task none --attack kalman_rts --out run{number}"
        words = [*command.split(), *options.split()]
        assert matrix.main([*words, "--dataset", str(csv_recording)]) == 0
        assert (tmp_path / f"run{number}" / "summary.csv").is_file()
    shown = capsys.readouterr().out
    assert "coarse:Coarse" in shown
    assert "stand:Stand" in (tmp_path / "run1" / "tables.txt").read_text(
        encoding="utf-8"
    )


def test_the_linker_of_the_guide_passes_the_kit(tmp_path, monkeypatch):
    guide = (ROOT / "docs" / "how-to" / "your-linker.md").read_text(encoding="utf-8")
    ((name, code),) = re.findall(
        r"```python\n# (\w+)\.py\n(.*?)```", guide, flags=re.DOTALL
    )
    (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    attack = importlib.import_module(name).MyLinker()
    del sys.modules[name]  # the name is free again for other tests
    failed = [result for result in run_checks(attack) if result.status == "failed"]
    assert failed == []


def test_the_tracker_of_the_guide_passes_the_kit(tmp_path, monkeypatch):
    guide = (ROOT / "docs" / "how-to" / "trackers.md").read_text(encoding="utf-8")
    ((name, code),) = re.findall(
        r"```python\n# (\w+)\.py\n(.*?)```", guide, flags=re.DOTALL
    )
    (tmp_path / f"{name}.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    tracker = importlib.import_module(name).Simple()
    del sys.modules[name]  # the name is free again for other tests
    failed = [result for result in run_checks(tracker) if result.status == "failed"]
    assert failed == []


PAGE_OF_ONE_NUMBER = ROOT / "docs" / "explanation" / "how-a-number-is-made.md"
FUNCTIONS = re.findall(
    r"`((?:isac_track|attacks|evaluation)\.[\w.]+)`",
    PAGE_OF_ONE_NUMBER.read_text(encoding="utf-8"),
)


@pytest.mark.parametrize("name", dict.fromkeys(FUNCTIONS))
def test_the_functions_behind_one_number_exist(name):
    module, _, attribute = name.rpartition(".")
    assert callable(getattr(importlib.import_module(module), attribute))
