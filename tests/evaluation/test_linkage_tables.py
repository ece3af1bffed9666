"""Linkage tables: the numbers of the frame, what a cell cannot say, and lines that fit."""

import io
import re

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from evaluation.analysis import linkability
from evaluation.analysis.levels import linked_levels, linked_tasks
from evaluation.reporting import tables
from evaluation.reporting.latex import linkability_tex
from evaluation.reporting.linkage_tables import show_linkage

LEVELS = [
    ("clean", np.nan),
    ("raw", np.nan),
    *[
        (f"{name}{suffix}", level)
        for suffix in ("", ":adding=independent")
        for name, level in (("fid", 1.0), ("fid", 1000.0), ("fixed", 0.7), ("fixed", 1.0))
    ],
]
FEW = LEVELS[:6]
ATTACKS = [
    ("shape", "blind"),
    ("shape", "informed"),
    ("profile", "informed"),
    ("shape@radial_rts", "blind"),
    ("shape@radial_rts", "informed"),
    ("shape@radial_rts", "oracle"),
    ("dtw@mine", "oracle"),
]
ROWS = ["shape", "@radial_rts", "profile", "dtw@mine (oracle)"]
CHANCE = 0.0072
COHORTS = {"without_groups": (0.1, 0.0206), "without_frozen": (-0.01, 0.0073)}


def value(n, m):
    """Rank 1 of attack n at level m, each another."""
    return 0.9 / (1.37 + 0.3 * n + m)


def make_frame(*, tasks=("rerelease",), levels=LEVELS, attacks=ATTACKS):
    rows = []
    for task in tasks:
        for m, (mechanism, level) in enumerate(levels):
            where = {
                "dataset": linkability.dataset_of(f"{task}/x", dataset="students03"),
                "mechanism": mechanism,
                "level": level,
                "invalid": "",
            }
            size = {"n_probes": 276, "n_mated": 276, "n_clusters": 175, "chance": CHANCE}
            size |= {"gallery_min": 138, "gallery_mean": 138.0, "gallery_max": 138}
            for name in ("random", "duration", "noise_level"):
                row = {"consumer": f"{task}/control-{name}", "knowledge": "", "cohort": "all"}
                row |= {"outcome": "at chance", "p_value": 0.4, "rank1": CHANCE}
                rows.append(where | size | row)
            for n, (attack, knowledge) in enumerate(attacks):
                found = value(n, m)
                row = {"consumer": f"{task}/{attack}", "knowledge": knowledge}
                result = {"cohort": "all", "outcome": "links", "p_value": 0.001, "rank1": found}
                result |= {"ci_low": 0.9 * found, "ci_high": 1.1 * found}
                rows.append(where | size | row | result)
                for cohort, (more, chance) in COHORTS.items():
                    part = {"cohort": cohort, "rank1": found + more, "chance": chance}
                    rows.append(where | row | part | {"outcome": np.nan})
    return pd.DataFrame(rows, columns=linkability.COLUMNS)


def changed(frame, where, **values):
    frame.loc[where & (frame["cohort"] == "all"), list(values)] = list(values.values())
    return frame


def shown(frame, *, width=200, manifest=None, **options):
    raw = io.StringIO()
    console = Console(file=raw, width=width, highlight=False, **options)
    show_linkage(frame, manifest=manifest or {}, console=console)
    return raw.getvalue()


def row_of(text, label):
    """The cells of a row of the first block."""
    (line, *_) = [one for one in text.splitlines() if one.strip().startswith(f"{label} ")]
    return line.strip().removeprefix(label).split()


def numbered(text, rows=ROWS):
    return [
        line
        for line in text.splitlines()
        if any(re.match(rf"{re.escape(row)} +[\d.-]+", line.strip()) for row in rows)
    ]


def test_a_row_is_the_attack_at_the_headline_levels_with_intervals():
    cells = row_of(shown(make_frame()), "profile")
    assert len(cells) == 2 * len(LEVELS)
    for m in range(len(LEVELS)):
        found = 100 * value(2, m)
        assert cells[2 * m : 2 * m + 2] == [f"{found:.1f}", f"{0.9 * found:.1f}-{1.1 * found:.1f}"]


def test_each_attack_has_one_row_of_who_knows_most_short_of_the_oracle():
    text = shown(make_frame())
    assert [line.split("  ")[0] for line in numbered(text)] == ["shape", "", "profile", ROWS[3]]
    for row, n in zip(ROWS, (1, 4, 2, 6), strict=True):
        assert row_of(text, row)[0] == f"{100 * value(n, 0):.1f}"
    assert text.index("shape ") < text.index("  @radial_rts") < text.index("profile ")
    assert "the adversary is informed where none is named" in text


def test_the_columns_are_named_by_rule_mechanism_and_level():
    lines = shown(make_frame(), width=116).splitlines()
    (n,) = [n for n, line in enumerate(lines) if line.startswith("attack ")]
    assert lines[n].split() == ["attack", "clean", "raw", *["1", "1000", "0.7", "1"] * 2]
    assert lines[n - 1].split() == ["fid", "fid", "fixed", "fixed"] * 2
    assert lines[n - 2].split() == ["lin."] * 4 + ["ind."] * 4
    alone = shown(make_frame(levels=FEW))
    assert "lin." not in alone
    assert "ind." not in alone


def test_tasks_are_apart_and_say_what_they_are():
    manifest = {"linkage": {"tasks": {"rerelease": {"people": 275}}}}
    frame = make_frame(tasks=("rerelease", "handover-2s", "new_traversal"))
    handed = frame["consumer"].str.startswith("handover")
    changed(frame, handed, gallery_min=21, gallery_mean=37.66, gallery_max=52, n_mated=201)
    text = shown(frame, manifest=manifest)
    assert text.count("attack ") == 3
    assert (
        "rerelease: one walk sensed and shared twice: an upper bound\n275 people; all 276 " in text
    )
    assert "mate among 138 candidates; chance 0.7 %\n" in text
    assert "201 of 276 releases have a mate among 21 to 52 (mean 37.7) candidates" in text
    assert "new_traversal: the same person on another day, simulated" in text
    assert text.count("people") == 1


def test_what_does_not_link_is_marked_and_the_marks_are_explained():
    frame = make_frame()
    informed = (frame["consumer"] == "rerelease/shape") & (frame["knowledge"] == "informed")
    at_fid = (frame["mechanism"] == "fid") & (frame["level"] == 1.0)
    changed(frame, informed & at_fid, outcome="no link detected")
    changed(frame, informed & (frame["mechanism"] == "raw"), outcome="attack too weak")
    text = shown(frame)
    cells = row_of(text, "shape")
    assert [cell[-1] for cell in cells[::2] if not cell[-1].isdigit()] == ["?", "~"]
    assert cells[2].endswith("?")
    assert cells[4].endswith("~")
    assert (
        "~ no link detected; ? attack too weak: it fails on clean too; unmarked: it links" in text
    )
    plain = shown(make_frame())
    assert "~" not in plain
    assert "unmarked" not in plain
    # A less knowing adversary is not shown, nor is what it fails at.
    blind = frame["knowledge"] == "blind"
    assert "~" not in shown(changed(make_frame(), blind, outcome="no link detected"))


def test_an_audit_that_leaks_is_named_and_its_cells_are_marked():
    frame = make_frame()
    frame.loc[frame["mechanism"] == "fixed", "invalid"] = "duration, noise_level"
    text = shown(frame)
    assert [cell.endswith("!") for cell in row_of(text, "profile")[::2]] == (
        [False] * 4 + [True] * 2 + [False] * 4
    )
    assert "! a shortcut leaks" in text
    assert "audits that leak: duration at 2 of 10 levels, noise_level at 2 of 10 levels\n" in text
    assert "audits that leak: none\n" in shown(make_frame())


def test_controls_are_counted_once_where_they_cannot_differ():
    frame = make_frame()
    assert "controls: 0 of 21 beat chance at 5 % (1.1 expected);" in shown(frame)
    duration = frame["consumer"] == "rerelease/control-duration"
    noise = (frame["consumer"] == "rerelease/control-noise_level") & frame["level"].notna()
    changed(frame, duration, p_value=0.03)
    changed(frame, noise, p_value=0.05)
    changed(frame, (frame["consumer"] == "rerelease/control-random") & (frame["level"] == 0.7),
            p_value=0.01)  # fmt: skip
    assert (
        "controls: 11 of 21 beat chance at 5 % (1.1 expected; duration 1 of 1; noise_level 8 of 10)"
    ) in shown(frame)


def test_without_the_confounders_the_best_attack_is_shown_with_its_chance():
    at_fid = [100 * value(1, 2), 100 * (value(1, 2) + 0.1), 100 * (value(1, 2) - 0.01)]
    fid = "fid 1, shape: {:.1f} (chance 0.7); without walking groups {:.1f} (2.1), without frozen "
    assert (fid + "annotations {:.1f} (0.7)\n").format(*at_fid) in shown(make_frame())
    assert "\nraw, shape: " not in shown(make_frame())
    assert "\nclean, shape: " in shown(make_frame(levels=LEVELS[:2]))
    frame = make_frame()
    changed(frame, frame["consumer"] == "rerelease/profile", rank1=0.99)
    assert "fid 1, profile: 99.0 (chance" in shown(frame)
    assert "walking" not in shown(frame[frame["cohort"] == "all"])


@pytest.mark.parametrize("levels", [LEVELS, FEW], ids=["both", "linear"])
@pytest.mark.parametrize("width", [40, 60, 80, 100, 116, 200])
def test_lines_fit_and_columns_line_up(width, levels):
    frame = make_frame(tasks=("rerelease", "split"), levels=levels)
    split = (frame["consumer"] == "split/profile") & ~(frame["level"] > 0.7)
    changed(frame, split, outcome="no link detected")
    lines = shown(frame, width=width).splitlines()
    assert max(map(len, lines)) <= width
    rows = numbered("\n".join(lines))
    assert len(rows) == 2 * len(ROWS)
    for block in (rows[:4], rows[4:]):
        # The decimal points of the values; those of intervals are where they are.
        values = [re.sub(r"[\d.]+-[\d.]+", lambda hit: " " * len(hit[0]), line) for line in block]
        points = [[hit.start() for hit in re.finditer(r"\.\d", line)] for line in values]
        assert points[0]
        assert all(one == points[0] for one in points)


def test_intervals_go_before_columns_and_columns_before_lines_wrap():
    wide, piped, narrow = (shown(make_frame(), width=width) for width in (200, 116, 80))
    assert row_of(wide, "profile")[1::2] == [c for c in row_of(wide, "profile") if "-" in c]
    assert ["-" in cell for cell in row_of(piped, "profile")][:6] == (
        [False, False, False, True, False, True]
    )
    assert not any("-" in cell for cell in row_of(piped, "profile")[-4:])
    assert "No room" not in piped
    few = row_of(shown(make_frame(levels=FEW), width=116), "profile")
    assert sum("-" in cell for cell in few) >= 5
    assert not any("-" in cell for cell in row_of(narrow, "profile"))
    slim = shown(make_frame(), width=72)
    assert len(row_of(slim, "profile")) < len(LEVELS)
    assert "(independent): linkability.csv fid 1," in " ".join(slim.split())
    assert "\nNo room for 5 more levels: linkability.csv\n" in shown(make_frame(), width=50)


def test_a_run_without_headline_levels_shows_those_that_it_has():
    levels = [("raw", np.nan), ("fid", 20.0), ("fid", 3.0), ("some.package:Mechanism,a=2", 7.0)]
    frame = make_frame(levels=levels)
    assert linked_levels(linked_tasks(frame)[0]) == [
        ("raw", None), ("fid", 3.0), ("fid", 20.0), ("some.package:Mechanism,a=2", 7.0)
    ]  # fmt: skip
    text = shown(frame)
    assert row_of(text, "attack") == ["raw", "3", "20", "7"]
    for part in ("some.pack", "age:Mecha", "nism,a=2"):
        assert part in text
    assert row_of(text, "profile")[2] == f"{100 * value(2, 2):.1f}"
    (*_, last) = linked_levels(linked_tasks(make_frame(levels=[*levels, LEVELS[3]]))[0])
    assert last == ("fid", 1000.0)


def test_read_from_its_file_the_frame_says_the_same(tmp_path):
    frame = make_frame(tasks=("rerelease", "new_traversal"))
    frame.to_csv(tmp_path / "linkability.csv", index=False)
    read = pd.read_csv(tmp_path / "linkability.csv")
    assert shown(read) == shown(frame)
    assert linkability_tex(read) == linkability_tex(frame)


def test_without_linkage_nothing_is_printed_and_a_skipped_task_is_named():
    frame = make_frame()
    assert shown(frame[:0]) == ""
    assert shown(frame[frame["knowledge"] == ""]) == ""
    manifest = {"linkage": {"skipped": {"split": "too few [red]people[/red]"}}}
    assert "split is left out: too few [red]people[/red]" in shown(frame, manifest=manifest)


def test_missing_cells_and_values_do_not_stop_it():
    frame = make_frame()
    profile = frame["consumer"] == "rerelease/profile"
    frame = frame[~(profile & (frame["mechanism"] == "raw"))]
    changed(frame, profile & (frame["mechanism"] == "clean"), rank1=np.nan)
    changed(frame, profile & (frame["mechanism"] == "fid"), ci_low=np.nan, ci_high=np.nan)
    assert row_of(shown(frame), "profile")[:4] == (
        ["-", "-", f"{100 * value(2, 2):.1f}", f"{100 * value(2, 3):.1f}"]
    )
    assert r"profile (informed) & -- & -- & " in linkability_tex(frame)


def test_long_and_odd_names_keep_their_settings():
    name = "some_package.attacks.clever:TheVeryBest,window_s=2.5"
    frame = make_frame(attacks=[(name, "informed"), ("[red]x", "blind"), ("\x1b[31mx", "blind")])
    text = shown(frame)
    assert re.search(r"^some_package\S*\.\.\.\S*window_s=2\.5 ", text, flags=re.MULTILINE)
    assert "[red]x (blind)" in text
    assert "\x1b" not in text
    ascii_only = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    show_linkage(frame, manifest={}, console=Console(file=ascii_only, width=80))


def test_without_colours_nothing_is_lost():
    coloured = shown(make_frame(), force_terminal=True, color_system="truecolor")
    assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == shown(make_frame())


def test_the_tables_of_a_run_show_it_if_they_are_given_it():
    empty = pd.DataFrame(columns=["consumer", "knowledge", "metric", "level", "mechanism"])
    manifest = {
        "dataset": {"name": "students03", "tracks": 428, "tracks_used": 106},
        "identity": {"scenes": 500, "seed": 3},
    }
    found = []
    for given in (make_frame(), make_frame()[:0], None):
        raw = io.StringIO()
        console = Console(file=raw, width=116, highlight=False)
        tables.show(
            empty, empty, empty, manifest=manifest, linkability=given, console=console
        )  # fmt: skip
        found.append(raw.getvalue())
    assert found[0] == found[1] + shown(make_frame(), width=116)
    assert found[1] == found[2]


def test_tex_has_a_balanced_tabular_for_each_task():
    frame = make_frame(tasks=("rerelease", "new_traversal"), attacks=[*ATTACKS, ("a_b%{", "blind")])
    changed(frame, frame["mechanism"] == "fid", outcome="attack too weak")
    frame.loc[frame["mechanism"] == "fixed", "invalid"] = "clock"
    text = linkability_tex(frame)
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 2
    assert r"% new\_traversal: the same person on another day, simulated; rank 1 in %" in text
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    bare = re.sub(r"\\[{}]", "", body)
    depth = np.cumsum([{"{": 1, "}": -1}.get(c, 0) for c in bare])
    assert depth.min() >= 0
    assert depth[-1] == 0
    assert not re.search(r"(?<!\\)[_#%~^]", body)
    rows = [line for line in body.splitlines() if line.endswith(r"\\") and "multi" not in line]
    assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(LEVELS)}
    assert r"\multicolumn{11}{l}{\scriptsize \textsuperscript{b}attack too weak" in body


def test_tex_shows_values_intervals_marks_and_chance():
    frame = make_frame()
    changed(frame, frame["mechanism"] == "raw", outcome="no link detected", invalid="clock")
    lines = linkability_tex(frame).splitlines()
    (n,) = [n for n, line in enumerate(lines) if line.startswith("profile (informed)")]
    first, second = (100 * value(2, m) for m in (0, 1))
    assert lines[n].startswith(
        rf"profile (informed) & {first:.1f} & {second:.1f}\textsuperscript{{ac}} & "
    )
    assert lines[n + 1].startswith(
        rf" & {{\scriptsize [{0.9 * first:.1f}, {1.1 * first:.1f}]}} & {{\scriptsize ["
    )
    assert " & ".join(["chance", *["0.7"] * 10]) + r" \\" in lines
    assert r" &  &  & linear & linear & linear & linear & " in lines[4]
    assert lines[5] == (
        r"Attack & clean & raw & fid 1 & fid 1000 & fixed 0.7 & fixed 1 & fid 1 & fid 1000 & "
        r"fixed 0.7 & fixed 1 \\"
    )


def test_more_levels_than_a_page_holds_go_to_further_tabulars():
    levels = [("fid", float(level)) for level in range(2, 25)]
    text = linkability_tex(make_frame(levels=levels))
    assert text.count(r"\begin{tabular}") == 3
    assert [len(spec) for spec in re.findall(r"begin{tabular}{(l+r+)}", text)] == [11, 11, 4]


def test_tex_is_written_where_there_is_linkage(tmp_path):
    empty = pd.DataFrame(
        columns=["consumer", "knowledge", "metric", "level", "mechanism", "value"]
    )  # fmt: skip
    tables.write_tex(empty, empty, folder=tmp_path / "without")
    assert not (tmp_path / "without" / "linkability.tex").exists()
    frame = make_frame()
    tables.write_tex(empty, empty, folder=tmp_path / "with", linkability=frame)
    assert (tmp_path / "with" / "linkability.tex").read_text() == linkability_tex(frame)
