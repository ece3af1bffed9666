"""Tables: the numbers of the frames, in lines that fit, whatever the names."""

import io
import re

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from evaluation import paper, summary, tables
from evaluation.tex import escape, paper_tex, sweep_tex

UNITS = {
    "plr": "fraction",
    "ael": "s",
    "mel": "s",
    "rmse": "m",
    "missed_conflict_rate": "fraction",
    "false_alarm_rate": "fraction",
    "distance_mae": "m",
}


LONG_CLAIM = "eta: it falls [red]monotonically[/red] " * 3


def make_summary(*, predictors=("least_squares",), n_levels=2, suffixes=("",)):
    levels = [("raw", np.nan)]
    for suffix in suffixes:
        levels += [(f"fid{suffix}", eta) for eta in np.geomspace(1, 1000, n_levels)]
        levels += [(f"fixed{suffix}", d_sigma) for d_sigma in np.linspace(0.7, 1.0, n_levels)]
    rows = []
    for n, (mechanism, level) in enumerate(levels):
        for consumer in ("shared", *predictors):
            metrics = list(UNITS)[:4] if consumer == "shared" else list(UNITS)[4:]
            for m, metric in enumerate(metrics):
                value = 0.9 / (1.37 + n + m)
                names = ["students03", mechanism, level, consumer, "", metric]
                rows.append([*names, value, 0.9 * value, 1.1 * value, 55, UNITS[metric]])
    return pd.DataFrame(rows, columns=summary.COLUMNS)


def make_paper_table():
    return pd.DataFrame(
        [
            ["raw", np.nan, "ael", 2.93, 3.5, 3.2, 3.8, False],
            ["fid", 1.0, "missed_conflict_rate", 0.305, 0.26, 0.205, 0.322, True],
            ["fid", 1.0, "plr", 0.184, 0.187, 0.182, 0.193, True],
            ["fixed:adding=independent", 1.0, "mel", 0.25, 0.31, np.nan, np.nan, None],
        ],
        columns=paper.PAPER_COLUMNS,
    )


def make_claims():
    return pd.DataFrame(
        [
            ["linear", LONG_CLAIM, "holds", -0.088, -0.122, -0.055, "fraction", "e"],
            ["linear", "at every rate", "does not hold", 0.0123, 0.001, 0.02, "s", "e"],
            ["", "about 366 history points", "undecided", 368.79, np.nan, np.nan, "points", "e"],
        ],
        columns=paper.CLAIM_COLUMNS,
    )


def make_manifest(name="students03", **dataset):
    return {
        "dataset": {"name": name, "tracks": 428, "tracks_used": 106, "notice": None} | dataset,
        "identity": {"scenes": 500, "seed": 3},
    }


def shown(frame=None, *, width=120, manifest=None, encoding="utf-8", **options):
    raw = io.BytesIO()
    console = Console(
        file=io.TextIOWrapper(raw, encoding=encoding, write_through=True),
        width=width,
        highlight=False,
        **options,
    )
    tables.show(
        make_summary() if frame is None else frame,
        make_paper_table(),
        make_claims(),
        manifest=manifest or make_manifest(),
        console=console,
    )
    return raw.getvalue().decode(encoding)


def line_starting(text, start):
    return next(line for line in text.splitlines() if line.split()[: len(start)] == start)


def test_the_header_says_what_was_run():
    assert shown().splitlines()[0] == "students03: 106 of 428 tracks used, 500 scenes, seed 3"


def test_a_notice_is_visible_and_simulated_tracks_have_one_anyway():
    assert "NOTICE: a stand-in" in shown(manifest=make_manifest("plaza", notice="a stand-in"))
    assert "NOTICE: the tracks are simulated" in shown(manifest=make_manifest(simulated=True))
    assert "NOTICE" not in shown()


def test_the_sweep_shows_the_numbers_of_the_frame_with_intervals():
    frame = make_summary()
    raw = frame[frame["mechanism"] == "raw"].set_index("metric")
    cells = line_starting(shown(), ["raw"]).split()[1:]
    order = ["missed_conflict_rate", "false_alarm_rate", "distance_mae", "plr", "ael", "mel"]
    for n, metric in enumerate(order):
        scale, digits = (100, 1) if UNITS[metric] == "fraction" else (1, 2 if n == 2 else 3)
        value, low, high = (scale * raw.loc[metric, c] for c in ("value", "ci_low", "ci_high"))
        assert cells[2 * n] == f"{value:.{digits}f}"
        assert cells[2 * n + 1] == f"{low:.{digits}f}-{high:.{digits}f}"


@pytest.mark.parametrize("width", [60, 80, 100, 116, 120, 200])
def test_no_line_is_wider_than_the_terminal_and_columns_line_up(width):
    frame = make_summary(n_levels=12, suffixes=("", ":adding=independent"))
    text = shown(frame, width=width)
    lines = [line for line in text.splitlines() if not line.startswith(("NOTICE", "The"))]
    assert max(map(len, lines)) <= width
    sweep = text[text.index("Sweep") : text.index("The paper's")].splitlines()
    numbers = [line for line in sweep if re.match(r"^ *([\d.]+|raw) ", line)]
    assert len(numbers) == 49
    assert len({len(line) for line in numbers}) == 1
    assert len(sweep) <= 60


def test_intervals_go_before_lines_wrap():
    assert line_starting(shown(width=80), ["raw"]).count("-") == 2
    assert line_starting(shown(width=100), ["raw"]).count("-") == 4
    assert line_starting(shown(width=116), ["raw"]).count("-") == 6


def test_each_further_predictor_has_a_table_of_its_own():
    text = shown(make_summary(predictors=("least_squares", "kalman_cv")))
    assert text.index("predictor least_squares") < text.index("predictor kalman_cv")
    assert text.count("MEL\n") == 1


def test_the_paper_table_has_bias_interval_and_tolerance():
    text = shown()
    assert line_starting(text, ["1", "missed", "%", "30.5"]).split()[3:] == (
        ["30.5", "26.0", "20.5-32.2", "-4.5", "yes", "no", "(4.0)"]
    )
    assert line_starting(text, ["AEL", "s"]).split()[2:] == (
        ["2.930", "3.500", "3.200-3.800", "+0.570", "no", "yes", "(0.879)"]
    )
    assert line_starting(text, ["1", "MEL"]).split()[3:] == (
        ["0.250", "0.310", "+0.060", "no", "(0.050)"]
    )


def test_another_recording_is_compared_but_not_judged():
    text = shown(manifest=make_manifest("plaza"))
    assert "The paper used students03; ours are of plaza" in text
    assert "tolerance" not in text
    assert line_starting(text, ["1", "missed", "%", "30.5"]).split()[-1] == "-4.5"


def test_claims_show_answer_effect_and_interval():
    text = shown()
    assert re.search(r"holds +-8\.8 +\[-12\.2, -5\.5\] +%-points", text)
    assert re.search(r"at every rate +does not hold +0\.012 +\[0\.001, 0\.020\] +s", text)
    assert re.search(r"undecided +368\.8 +points", text)


@pytest.mark.parametrize(
    "name", ["<script>", "[red]x[/red]", "[/]", ":smile:", "$a_b%", "\x1b[31mx"]
)
def test_names_are_shown_literally(name):
    text = shown(manifest=make_manifest(name))
    assert text.startswith(f"{name.replace(chr(27), '?')}: 106 of")
    assert "[red]monotonically[/red]" in text


def test_without_colours_nothing_is_lost_and_ascii_terminals_survive(monkeypatch):
    coloured = shown(force_terminal=True, color_system="truecolor")
    assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == shown()
    monkeypatch.setenv("NO_COLOR", "1")
    assert not re.search(r"\x1b\[[0-9;]*3\dm", shown(force_terminal=True))
    assert shown(manifest=make_manifest("広場"), encoding="ascii").startswith("??: 106")


def test_piped_output_has_a_fixed_width(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    tables.show(make_summary(), make_paper_table(), make_claims(), manifest=make_manifest())
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= tables.PIPE_WIDTH
    assert line_starting(text, ["raw"]).count("-") == 6


def test_missing_parts_and_intervals_do_not_stop_it():
    frame = make_summary(predictors=())
    frame[["ci_low", "ci_high"]] = np.nan
    frame.loc[frame["metric"] == "mel", "value"] = np.nan
    assert line_starting(shown(frame), ["raw"]).split() == ["raw", "65.7", "0.380", "-"]
    assert "Sweep" not in shown(frame[:0])
    for table in (make_paper_table(), make_paper_table()[:0]):
        tables.show(frame, table, make_claims()[:0], manifest=make_manifest(),
                    console=Console(file=io.StringIO(), width=80))  # fmt: skip


def test_near_levels_are_not_merged():
    frame = make_summary()
    frame["level"] = frame["level"].replace({1000.0: 1.00001})
    text = shown(frame)
    sweep = text[text.index("Sweep") : text.index("The paper's")]
    assert len(re.findall(r"^ +1 ", sweep, flags=re.MULTILINE)) == 3


def test_tex_is_deterministic_balanced_and_escaped(tmp_path):
    frame = make_summary(predictors=("least_squares", "my_{odd}%"))
    frame["mechanism"] = frame["mechanism"].replace({"fid": "fid:a_b=$x&#~^\\"})
    tables.write_tex(frame, make_paper_table(), folder=tmp_path / "tables")
    for name, expected in (
        ("sweep.tex", sweep_tex(frame)),
        ("paper.tex", paper_tex(make_paper_table())),
    ):
        text = (tmp_path / "tables" / name).read_text()
        assert text == expected
        body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
        bare = re.sub(r"\\[{}]", "", body)
        depth = np.cumsum([{"{": 1, "}": -1}.get(c, 0) for c in bare])
        assert depth.min() >= 0
        assert depth[-1] == 0
        assert not re.search(r"(?<!\\)[_#%~]|(?<!\\)\^", body)
        assert body.count(r"\begin{tabular}") == body.count(r"\end{tabular}")
        columns = None
        for line in body.splitlines():
            if line.startswith(r"\begin"):
                columns = len(line.split("{")[-1].rstrip("}"))
            elif line.endswith(r"\\"):
                assert len(re.findall(r"(?<!\\)&", line)) == columns - 1


def test_tex_shows_values_with_intervals():
    assert r"fid & 1 & missed (\%) & 30.5 & 26.0 {\scriptsize [20.5, 32.2]} & $-4.5$ \\" in (
        paper_tex(make_paper_table())
    )


def test_tex_escapes_every_special_character():
    assert escape("a_b%$&#{}") == r"a\_b\%\$\&\#\{\}"
    assert escape("\\~^<>|") == (
        r"\textbackslash{}\textasciitilde{}\textasciicircum{}\textless{}\textgreater{}\textbar{}"
    )


def test_the_headline_has_the_five_rows_of_each_adding_rule():
    frame = make_summary(suffixes=("", ":adding=independent"))
    lines = tables.headline_markdown(frame).splitlines()
    assert len(lines) == 2 + 5 + 4
    assert len({line.count("|") for line in lines}) == 1
    fid = frame[(frame["mechanism"] == "fid") & (frame["level"] == 1.0)].set_index("metric")
    plr, low, high = (100 * fid.loc["plr", c] for c in ("value", "ci_low", "ci_high"))
    assert f"| {plr:.1f} [{low:.1f}, {high:.1f}] |" in lines[3]
    assert len(tables.headline_markdown(make_summary()).splitlines()) == 2 + 5
    assert len(tables.headline_markdown(frame[:0]).splitlines()) == 2
