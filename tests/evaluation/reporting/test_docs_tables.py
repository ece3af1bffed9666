"""Result tables of README and docs: written between their marks, nothing else touched."""

import pandas as pd
import pytest
from helpers.finished_runs import levels, make_run, make_summary

from evaluation.reporting.docs_tables import TABLES, filled, write_docs
from evaluation.reporting.markup import markdown
from isac_track.errors import DataError

BLOCK = "Before.\n<!-- table: sweep students03-paper-3 -->\nold\n<!-- end -->\nAfter.\n"


@pytest.fixture
def root(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text(BLOCK, encoding="utf-8")
    (tmp_path / "docs" / "other.md").write_text("Nothing.\n", encoding="utf-8")
    return tmp_path


def test_the_summary_and_the_blocks_are_written_and_written_again_the_same(root):
    run = make_run()
    path = root / "docs" / "results" / "students03-paper-3.csv"
    assert write_docs(run, root=root) == [path, root / "README.md"]
    text = (root / "README.md").read_text(encoding="utf-8")
    expected = markdown(TABLES["sweep"](run.summary))
    assert text == BLOCK.replace("old\n", expected)
    assert (root / "docs" / "other.md").read_text(encoding="utf-8") == "Nothing.\n"
    assert write_docs(run, root=root) == [path]
    assert filled(text, results=path.parent) == text


def test_every_table_is_the_same_from_the_file(tmp_path):
    frame = make_summary(levels())
    frame.to_csv(tmp_path / "run.csv", index=False)
    read = pd.read_csv(tmp_path / "run.csv")
    for make in TABLES.values():
        assert markdown(make(read)) == markdown(make(frame))


@pytest.mark.parametrize("mark", ["sweep nowhere-paper-0", "nothing students03-paper-3"])
def test_what_is_not_there_is_named(root, mark):
    (root / "README.md").write_text(f"<!-- table: {mark} -->\n<!-- end -->\n", encoding="utf-8")
    with pytest.raises(DataError, match=mark.split()[0]):
        write_docs(make_run(), root=root)


def test_outside_the_repository_nothing_is_written(tmp_path):
    with pytest.raises(DataError, match="no README"):
        write_docs(make_run(), root=tmp_path)
    assert not list(tmp_path.iterdir())
