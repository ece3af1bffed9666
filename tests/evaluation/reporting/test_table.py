"""A table in each of its five ways: nothing lost, nothing misread, lines that fit."""

import io
import re

import numpy as np
import pytest
from helpers.pages import Tags
from rich.console import Console

from evaluation.reporting import table as make
from evaluation.reporting.markup import HTML, escape, latex, markdown
from evaluation.reporting.table import Cell, Column, Table, number_cell, text_cell
from evaluation.reporting.terminal import PIPE_WIDTH, show_table, standard_output

NAME = make.text_column("name")
ODD = ["<script>", "[red]x[/red]", "[/]", ":smile:", "$a_b%&#{}~^\\|", "\x1b[31mx"]


def make_table(
    *, n_columns=3, n_rows=4, names=("fid", "fixed"), notes=(), marks=None, mark=""
):
    columns = [NAME, Column("level")]
    columns += [
        Column(f"m_{n}", unit="%", above="linear" if n else "")
        for n in range(n_columns)
    ]
    rows = [
        [
            text_cell(name),
            number_cell(place, digits=0),
            *(
                number_cell(0.1 * n + place, place, place + 1, mark=mark)
                for n in range(n_columns)
            ),
        ]
        for name in names
        for place in range(1, n_rows + 1)
    ]
    return Table(
        "some",
        "A title",
        columns,
        rows,
        notes=notes,
        marks=marks,
        n_headings=1,
        n_keys=2,
    )


def printed(table, *, width=120, encoding="utf-8", **options):
    raw = io.BytesIO()
    file = io.TextIOWrapper(raw, encoding=encoding, write_through=True)
    show_table(
        table, console=Console(file=file, width=width, highlight=False, **options)
    )
    return raw.getvalue().decode(encoding)


def html(table):
    return str(HTML.get_template("table.html.j2").module.table(table))


def assert_well_formed(tex):
    """Check balanced braces, escaped characters, and rows as long as their tabular."""
    body = "\n".join(line for line in tex.splitlines() if not line.startswith("%"))
    depth = np.cumsum(
        [{"{": 1, "}": -1}.get(c, 0) for c in re.sub(r"\\[{}]", "", body)]
    )
    assert depth.min() >= 0 == depth[-1]
    assert not re.search(r"(?<!\\)[_#%~^]", body)
    for part in body.split(r"\begin{tabular}")[1:]:
        spec, *lines = part.partition(r"\end{tabular}")[0].splitlines()
        rows = [
            line for line in lines if line.endswith(r"\\") and "multicolumn" not in line
        ]
        assert rows
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {
            len(spec.strip("{}")) - 1
        }


class TestCells:
    @pytest.mark.parametrize(
        ("given", "text"),
        [
            ((0.187, 0.184, 0.191), "18.7 [18.4, 19.1]"),
            ((0.187,), "18.7"),
            ((0.187, np.nan, np.nan), "18.7"),
            ((np.nan, 0.1, 0.2), ""),
            ((None,), ""),
        ],
    )
    def test_a_number_stands_with_its_interval(self, given, text):
        assert number_cell(*given, scale=100.0).full == text
        assert make.metric_cell("plr", *given).full == text

    def test_it_is_sorted_by_the_number_shown_and_a_column_of_numbers_may_have_gaps(
        self,
    ):
        assert number_cell(0.187, scale=100.0).value == pytest.approx(18.7)
        assert text_cell("as shared").value is None
        assert text_cell(np.nan) == text_cell(None) == Cell()
        rows = [[text_cell("a"), number_cell(None)], [text_cell("b"), number_cell(1.0)]]
        assert Table("x", "x", [NAME, Column("n")], rows).numeric == [False, True]


class TestTheTerminal:
    @pytest.mark.parametrize("width", [40, 60, 80, 100, 116, 200])
    def test_no_line_is_wider_and_columns_line_up(self, width):
        text = printed(make_table(n_columns=8), width=width)
        lines = text.splitlines()
        assert max(map(len, lines)) <= width
        assert text.count("m_") == 8  # whatever is split, nothing is left out
        for part in text.split("A title")[1:]:
            numbers = [
                line for line in part.splitlines() if re.match(r"^fi\w+ +\d ", line)
            ]
            assert len(numbers) == 8
            assert len({len(line) for line in numbers}) == 1

    def test_marks_are_explained_where_they_are_used_and_values_line_up(self):
        marks = {"~": "no link detected", "^": "too weak"}
        text = printed(make_table(n_columns=1, mark="~", marks=marks))
        assert "(~ no link detected)" in text
        assert "^" not in text
        assert "1.0~ [1.0, 2.0]" in text

    def test_long_words_wrap_and_long_columns_are_left_out(self):
        columns = [NAME, Column("n"), Column("why", align="left", is_long=True)]
        rows = [[text_cell("it falls " * 20), number_cell(1.0), text_cell("evidence")]]
        text = printed(Table("x", "x", columns, rows), width=60)
        assert max(map(len, text.splitlines())) <= 60
        assert " ".join(text.split()).count("it falls") == 20
        assert "evidence" not in text

    @pytest.mark.parametrize("name", ODD)
    def test_names_are_shown_literally(self, name):
        assert name.replace("\x1b", "?") in printed(make_table(names=(name,)))

    def test_without_colours_nothing_is_lost_and_ascii_terminals_survive(
        self, monkeypatch
    ):
        coloured = printed(make_table(), force_terminal=True, color_system="truecolor")
        assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == printed(make_table())
        monkeypatch.setenv("NO_COLOR", "1")
        assert not re.search(
            r"\x1b\[[0-9;]*3\dm", printed(make_table(), force_terminal=True)
        )
        assert "??" in printed(make_table(names=("広場",)), encoding="ascii")

    def test_piped_output_has_a_fixed_width(self, monkeypatch):
        monkeypatch.delenv("COLUMNS", raising=False)
        assert standard_output().width == PIPE_WIDTH


class TestLatex:
    def test_it_is_balanced_and_escaped_whatever_the_names(self):
        marked = make_table(mark="~", marks={"~": "~x"})
        text = latex([make_table(names=ODD, notes=["a_b%"]), marked])
        assert_well_formed(text)
        assert text.count(r"\toprule") == 2
        assert r"\textasciitilde{} \textasciitilde{}x" in text

    def test_every_special_character_is_escaped(self):
        assert escape("a_b%$&#{}") == r"a\_b\%\$\&\#\{\}"
        assert escape("\\~^<>|") == (
            r"\textbackslash{}\textasciitilde{}\textasciicircum{}"
            r"\textless{}\textgreater{}\textbar{}"
        )

    def test_values_stand_with_their_intervals_and_marks(self):
        text = latex([make_table(n_columns=1, mark="?", marks={"?": "weak"})])
        assert r"fid & 1 & 1.0\textsuperscript{?} {\scriptsize [1.0, 2.0]} \\" in text
        signed = latex(
            [Table("x", "x", [Column("d")], [[number_cell(-4.5)], [number_cell(None)]])]
        )
        assert "$-4.5$ \\\\\n-- \\\\" in signed

    def test_many_intervals_stand_below_and_more_columns_in_further_tabulars(self):
        text = latex([make_table(n_columns=23)])
        assert_well_formed(text)
        specs = re.findall(r"begin{tabular}{(l+r+)}", text)
        assert [len(spec) for spec in specs] == [12, 12, 5]
        assert "\n &  & {\\scriptsize [1.0, 2.0]} & " in text
        assert text.count(" & linear & ") > 0


class TestHtmlAndMarkdown:
    @pytest.mark.parametrize("name", ODD)
    def test_a_name_is_a_word_on_a_page(self, name):
        tags = Tags(html(make_table(names=(name,))))
        assert {tag for tag, _ in tags.opened} == {
            "div", "table", "caption", "thead", "tr", "th", "button", "tbody", "td",
            "p",
        }  # fmt: skip
        assert name in tags.text

    def test_cells_hold_what_they_are_sorted_by(self):
        tags = Tags(html(make_table(n_columns=1, n_rows=1, names=("fid",))))
        assert [cell.get("data-value") for cell in tags.attributes("td")] == [
            None,
            "1",
            "1",
        ]

    def test_decisions_are_a_sign_a_word_and_a_colour(self):
        text = html(Table("x", "x", [NAME], [[make.decision_cell("does not track")]]))
        assert '<td class="t bad">✗ does not track</td>' in text

    def test_markdown_has_as_many_cells_in_every_line(self):
        lines = markdown(make_table(names=("a|b", "<i>"))).splitlines()
        assert len({len(re.findall(r"(?<!\\)\|", line)) for line in lines}) == 1
        assert lines[1] == "| :-- | --: | --: | --: | --: |"
        assert lines[2].endswith("| 1.2 [1.0, 2.0] |")
        assert "<i>" not in "".join(lines)
