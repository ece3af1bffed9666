"""The sources of error: the same list on the page of a run and in the documentation."""

import re
from pathlib import Path

from helpers.finished_runs import make_run, with_links

from evaluation.reporting.error_sources import DOCS_PAGE, ERROR_SOURCES
from evaluation.reporting.first_screen import first_screen
from evaluation.reporting.page import render

ROOT = Path(__file__).parents[3]
DOCUMENTED = (ROOT / "docs" / "explanation" / DOCS_PAGE).read_text(encoding="utf-8")


def test_the_documentation_has_the_same_list():
    table = DOCUMENTED.partition("| source |")[2].partition("\n\n")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.splitlines()[2:]
    ]
    assert [row[:3] for row in rows] == [
        [source.name, source.assumption, source.error or "none"]
        for source in ERROR_SOURCES
    ]


def test_the_page_has_every_source():
    page = render(make_run())
    section = page.partition('<section id="assumed">')[2].partition("</section>")[0]
    assert re.findall(r"<dt>(.*?)</dt>", section) == [
        source.name for source in ERROR_SOURCES
    ]
    assert f"docs/explanation/{DOCS_PAGE}" in section


def test_the_first_screen_names_the_page_beside_its_doubts():
    for run in (make_run(), with_links(make_run())):
        screen = "\n".join(first_screen(run))
        doubts = screen.partition("\nDoubts: ")[2].partition("\nPage: ")[0]
        assert DOCS_PAGE in doubts
