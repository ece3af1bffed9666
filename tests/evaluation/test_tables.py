"""Tables: the numbers of the frames, in lines that fit, whatever the names."""

import io
import re

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from evaluation.analysis import paper, summary
from evaluation.analysis import weak_attacks as flags
from evaluation.reporting import tables
from evaluation.reporting.latex import attacks_tex, escape, paper_tex, sweep_tex
from evaluation.reporting.terminal import PIPE_WIDTH

UNITS = {
    "plr": "fraction",
    "ael": "s",
    "mel": "s",
    "rmse": "m",
    "missed_conflict_rate": "fraction",
    "false_alarm_rate": "fraction",
    "distance_mae": "m",
}
AFTER = {"plr": "fraction", "ael": "s", "mel": "s", "rmse": "m"}
RATIOS = {"rmse_over_benchmark": "ratio", "plr_over_benchmark": "ratio"}
ATTACKS = (
    ("identity", "blind"),
    ("moving_average", "blind"),
    ("moving_average", "informed"),
    ("savgol", "blind"),
    ("savgol", "informed"),
    ("kalman_rts", "blind"),
    ("kalman_rts", "informed"),
    ("kalman_rts", "oracle"),
    ("radial_rts", "blind"),
    ("radial_rts", "informed"),
    ("averaging", "oracle"),
)

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


def make_attacked(attacks=ATTACKS, **axes):
    """The rows of `make_summary` and those of attacks; the control repeats what was shared."""
    frame = make_summary(**axes)
    shared = frame[frame["consumer"] == "shared"]
    found = [frame]
    for n, (attack, knowledge) in enumerate(attacks):
        lift = 1.0 if attack == "identity" else 1.0 + 0.02 * n
        rows = shared.assign(consumer=attack, knowledge=knowledge)
        ratio = rows[rows["metric"].isin(["plr", "rmse"])]
        ratio = ratio.assign(metric=ratio["metric"] + "_over_benchmark", unit="ratio", value=1.0)
        rows = rows.assign(**{c: lift * rows[c] for c in ("value", "ci_low", "ci_high")})
        found += [rows, ratio]
    return pd.concat(found, ignore_index=True)


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
    assert max(map(len, text.splitlines())) <= PIPE_WIDTH
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


def after_attack_of(text):
    """The table over all levels, and the block of headline levels."""
    first = text.index("After attack: ")
    second = text.index("After attack, every adversary")
    return text[first:second], text[second : text.index("The paper's")]


def test_attacks_get_no_table_of_a_predictor_and_change_none():
    frame = make_attacked([*ATTACKS, ("least_squares", "informed"), ("shared", "blind")])
    text, without = shown(frame), shown(make_summary())
    assert text.count("Sweep") == 1
    assert text[: text.index("After attack")] == without[: without.index("The paper's")]
    assert sweep_tex(frame) == sweep_tex(make_summary())
    assert tables.headline_markdown(frame) == tables.headline_markdown(make_summary())
    assert "After attack" not in without


def test_plr_after_each_attack_is_that_of_who_knows_most_short_of_the_oracle():
    frame = make_attacked()
    levels, _ = after_attack_of(shown(frame, width=200))
    head = [line.split() for line in levels.splitlines()[1:4]]
    assert head[1][1:] == ["average", "savgol", "rts", "rts", "averaging"]
    assert head[2] == ["level", "shared", "blind", *["informed"] * 4, "oracle"]
    plr = frame[(frame["mechanism"] == "raw") & (frame["metric"] == "plr")]
    plr = plr.set_index(["consumer", "knowledge"])
    rows = [("shared", ""), *[ATTACKS[n] for n in (0, 2, 4, 6, 9, 10)]]
    cells = line_starting(levels, ["raw"]).split()[1:]
    for n, key in enumerate(rows):
        value, low, high = (100 * plr.loc[key, c] for c in ("value", "ci_low", "ci_high"))
        assert cells[2 * n] == f"{value:.1f}"
        assert cells[2 * n + 1] == f"{low:.1f}-{high:.1f}"


@pytest.mark.parametrize("width", [50, 60, 80, 100, 116, 200])
def test_the_tables_after_attack_line_up_and_fit(width):
    frame = make_attacked(n_levels=10, suffixes=("", ":adding=independent"))
    levels, headline = after_attack_of(shown(frame, width=width))
    for table in (levels, headline):
        assert max(map(len, table.splitlines())) <= width
    rows = [line for line in levels.splitlines() if re.match(r"^ *([\d.]+|raw) ", line)]
    assert len(rows) == 41 * levels.count("After attack:")
    assert levels.count("After attack:") == (1 if width >= 80 else 2)
    rows = [line for line in headline.splitlines() if re.match(r"^(shared|\w+ \()", line)]
    assert len({len(line) for line in rows if not line.endswith("-")}) == 1


def test_every_attack_and_adversary_is_shown_at_the_headline_levels():
    frame = make_attacked(suffixes=("", ":adding=independent"))
    _, headline = after_attack_of(shown(frame, width=200))
    headings = [line for line in headline.splitlines() if re.match(r"^(raw|fid|fixed)", line)]
    assert headings == [
        "raw", "fid 1", "fid 1000", "fixed 0.7", "fixed 1", "fid:adding=independent 1",
        "fid:adding=independent 1000", "fixed:adding=independent 0.7",
        "fixed:adding=independent 1",
    ]  # fmt: skip
    for attack, knowledge in ATTACKS[1:]:
        assert headline.count(f"{attack} ({knowledge}) ") == len(headings)
    assert headline.count("\nshared ") == len(headings)
    assert "identity" not in headline  # it says what `shared` says
    raw = frame[(frame["mechanism"] == "raw") & (frame["consumer"] == "averaging")]
    raw = raw.set_index("metric")
    digits = dict(zip([*AFTER, *RATIOS], (1, 3, 3, 3, 2, 2), strict=True))
    for n, (metric, places) in enumerate(digits.items()):
        value = raw.loc[metric, "value"] * (100 if metric == "plr" else 1)
        cells = line_starting(headline, ["averaging", "(oracle)"]).split()[2:]
        assert cells[2 * n] == f"{value:.{places}f}"


def test_a_control_that_differs_is_shown_and_equal_adversaries_share_a_line():
    frame = make_attacked()
    frame.loc[frame["consumer"] == "identity", "value"] += 0.1
    last = frame[frame["knowledge"] == "informed"].assign(knowledge="oracle")
    last = last[last["consumer"] == "radial_rts"]
    same = frame["consumer"] == "savgol"
    frame.loc[same, ["value", "ci_low", "ci_high"]] = 0.5
    _, headline = after_attack_of(shown(pd.concat([frame, last])))
    assert "identity (blind)" in headline
    assert "radial_rts (informed, oracle)" in headline
    assert "savgol (any adversary)" in headline


def test_slow_attacks_and_the_oracle_are_marked():
    manifest = make_manifest() | {"cells": [{"consumer": "kalman_rts", "slow": True}, {}]}
    levels, _ = after_attack_of(shown(make_attacked(), manifest=manifest))
    assert "kalman_rts saw only the first release" in levels
    assert "The oracle is a reference" in levels
    levels, _ = after_attack_of(shown(make_attacked(ATTACKS[:3])))
    assert "oracle" not in levels
    assert "first release" not in levels


def test_long_and_odd_names_of_attacks_are_all_there():
    name = "some_package.attacks.clever:TheVeryBestOfAll,window_s=2.5"
    frame = make_attacked([(name, "blind"), ("[red]x", "informed")])
    levels, headline = after_attack_of(shown(frame, width=80))
    for part in ("some_", "package.", "attacks.", "clever:", "window_s", "[red]x"):
        assert part in levels
    assert "some_package" in headline
    assert "[red]x (informed)" in headline


def test_missing_values_after_attack_do_not_stop_it():
    frame = make_attacked()
    frame.loc[frame["consumer"] != "shared", ["value", "ci_low", "ci_high"]] = np.nan
    levels, headline = after_attack_of(shown(frame))
    assert set(line_starting(levels, ["raw"]).split()[3:]) == {"-"}
    assert "kalman_rts (any adversary)" in headline
    part = frame[(frame["consumer"] == "shared") | (frame["mechanism"] == "fid")]
    assert line_starting(after_attack_of(shown(part))[0], ["raw"]).split()[3:] == ["-"] * 6


def test_the_attacks_as_tex_have_a_tabular_each():
    frame = make_attacked()
    text = attacks_tex(frame)
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 1 + len(ATTACKS)
    for attack, knowledge in ATTACKS:
        assert rf"\multicolumn{{4}}{{c}}{{After {escape(attack)} ({knowledge})}} \\" in text
    assert text.count("{As shared}") == 1
    rows = [line for line in text.splitlines() if line.startswith(("raw &", "fid &", "fixed &"))]
    assert len(rows) == 5 * (1 + len(ATTACKS))
    assert all(len(re.findall(r"(?<!\\)&", row)) == 5 for row in rows)
    plr = frame[(frame["mechanism"] == "raw") & (frame["metric"] == "plr")].iloc[0]
    value, low, high = (100 * plr[c] for c in ("value", "ci_low", "ci_high"))
    assert rows[0].startswith(rf"raw &  & {value:.1f} {{\scriptsize [{low:.1f}, {high:.1f}]}} & ")
    assert attacks_tex(make_summary()).count("tabular") == 0


def test_privacy_is_labelled_as_shared_wherever_it_is_shown():
    assert "PLR, shared (\\%)" in sweep_tex(make_summary())
    assert "PLR, shared (\\%)" in paper_tex(make_paper_table())
    assert "missed (\\%)" in paper_tex(make_paper_table())
    assert "PLR, shared (%)" in tables.headline_markdown(make_summary())
    text = shown()
    assert "Sweep, predictor least_squares; privacy as shared" in text
    assert "The paper's numbers beside ours, privacy as shared" in text


def test_the_attacks_as_markdown_are_the_headline_levels_with_intervals():
    frame = make_attacked(suffixes=("", ":adding=independent"))
    lines = tables.attacks_markdown(frame).splitlines()
    assert lines[0] == (
        "| sharing | adding | PLR, shared (%) | PLR, kalman_rts (informed) (%) | "
        "PLR, radial_rts (informed) (%) | PLR, averaging (oracle) (%) |"
    )
    assert len(lines) == 2 + 5 + 4
    assert len({line.count("|") for line in lines}) == 1
    fid = frame[(frame["mechanism"] == "fid") & (frame["level"] == 1.0)]
    fid = fid[(fid["consumer"] == "averaging") & (fid["metric"] == "plr")].iloc[0]
    plr, low, high = (100 * fid[c] for c in ("value", "ci_low", "ci_high"))
    assert lines[3].endswith(f"| {plr:.1f} [{low:.1f}, {high:.1f}] |")
    assert len(tables.attacks_markdown(make_summary()).splitlines()) == 2


def test_flags_are_shown_in_short_and_without_any_nothing_is():
    row = dict.fromkeys(flags.COLUMNS, "")
    row |= {"kind": "beaten", "mechanism": "fid", "attack": "mine", "knowledge": "informed"}
    row |= {"by": "savgol", "by_knowledge": "blind", "metric": "plr", "compared": 47}
    row |= {"difference": 0.012, "ci_low": 0.003, "ci_high": 0.02}
    rows = pd.DataFrame([row | {"level": level} for level in (1.0, 10.0, 100.0)])
    raw = io.StringIO()
    tables.show_flags(rows, console=Console(file=raw, width=200))
    assert raw.getvalue().splitlines()[1] == (
        "flag: mine (informed) is beaten by savgol (blind) at 3 of 47 levels, by up to "
        "1.2 [0.3, 2.0] points: flags.json"
    )
    raw = io.StringIO()
    tables.show_flags(rows[:0], console=Console(file=raw, width=200))
    assert raw.getvalue() == ""
