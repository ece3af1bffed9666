"""The tutorial, run as a reader would: in an empty folder, with the two files beside each other."""

import io
import json
import re
import runpy
import shutil
import sys
from contextlib import redirect_stdout

import pandas as pd
import pytest
from helpers.processes import ROOT

from evaluation.reporting.figures import drawing
from evaluation.results import build

EXAMPLE = ROOT / "examples" / "tutorial"
MINE = "geometric_median:GeometricMedian"
FILES = (
    "report.html",
    "manifest.json",
    "summary.csv",
    "matched.csv",
    "linkability.csv",
    "verdict.json",
    "flags.json",
    "figures/after_attack.svg",
    "tables/attacks.tex",
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder after the script, and what it said; of the figures one is enough."""
    folder, said = tmp_path_factory.mktemp("tutorial"), io.StringIO()
    for path in EXAMPLE.glob("*.py"):
        shutil.copy(path, folder)
    figures = drawing.figures_of
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        patch.setattr(
            drawing,
            "figures_of",
            lambda run: [one for one in figures(run) if one.name == "after_attack"],
        )
        runpy.run_path("tutorial.py")
    del sys.modules["geometric_median"]  # the name is free again
    return folder, said.getvalue()


@pytest.fixture(scope="module")
def summary(finished):
    return pd.read_csv(finished[0] / "tutorial-run" / "summary.csv", keep_default_na=False)


@pytest.mark.parametrize("name", FILES)
def test_the_run_leaves_a_report(finished, name):
    assert (finished[0] / "tutorial-run" / name).stat().st_size > 0


def test_the_recording_is_the_one_that_was_written(finished):
    manifest = json.loads((finished[0] / "tutorial-run" / "manifest.json").read_text("utf-8"))
    assert manifest["dataset"]["name"] == "walks"
    assert manifest["dataset"]["tracks"] == 1100
    assert "1100 tracks; mended on reading: nothing" in finished[1]


def test_the_attack_keeps_the_contract(finished):
    assert "attack kit: all checks pass" in finished[1]


def test_the_attack_is_judged_like_the_built_in_one(summary):
    metrics = {
        name: set(summary.loc[summary["consumer"] == name, "metric"])
        for name in (MINE, "kalman_rts", f"rerelease/shape@{MINE}", "rerelease/shape@kalman_rts")
    }
    assert {"plr", "ael", "mel"} < metrics[MINE] == metrics["kalman_rts"]
    assert metrics[f"rerelease/shape@{MINE}"] == metrics["rerelease/shape@kalman_rts"]


def test_what_the_text_says_of_the_attack_is_so(summary):
    """It undoes less than the smoother, and links more people."""

    def value(consumer, metric, mechanism, level):
        row = (
            (summary["consumer"] == consumer)
            & (summary["metric"] == metric)
            & (summary["knowledge"].isin(["", "blind"]))
            & (summary["mechanism"] == mechanism)
            & (summary["level"] == level)
        )
        return float(summary.loc[row, "value"].item())

    where = "fixed", "1.0"
    shared = value("shared", "plr", *where)
    assert shared < value(MINE, "plr", *where) < value("kalman_rts", "plr", *where)
    linked = [value(f"rerelease/shape@{one}", "rank1", *where) for one in (MINE, "kalman_rts")]
    assert linked[0] > linked[1] > 0.1
    # Moved as a whole, a walk is linked as if it had been shared raw.
    moved = value(f"rerelease/shape@{MINE}", "rank1", "offset", "0.3")
    raw = value(f"rerelease/shape@{MINE}", "rank1", "raw", "")
    assert moved == pytest.approx(raw, abs=0.02)
    assert value("shared", "plr", "offset", "0.3") < value("shared", "plr", "raw", "") - 0.1


def test_verdict_and_design_question_are_answered(finished):
    folder, said = finished
    verdict = json.loads((folder / "tutorial-run" / "verdict.json").read_text("utf-8"))
    sections = {one["section"] for one in verdict["items"]}
    assert sections == {"validity", "within", "claim", "inflation"}
    assert all(sentence in said for sentence in verdict["answer"])
    found = [one for one in verdict["items"] if one["section"] == "validity"]
    assert {one["decision"] for one in found} == {"does not track"}
    assert all(one["against"] == "offset 0.3" and one["effect"] > 0 for one in found)
    assert "\nNo: fid" in said
    assert said.rstrip().endswith("exit code: 1")


def test_the_page_shows_the_attack(finished):
    assert MINE in (finished[0] / "tutorial-run" / "report.html").read_text("utf-8")


def test_the_text_shows_the_files_as_they_are():
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    ((name, shown),) = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", text, flags=re.DOTALL)
    assert (EXAMPLE / name).read_text("utf-8").endswith(shown)
    cells = re.findall(r"^# %% (\d)\.", (EXAMPLE / "tutorial.py").read_text("utf-8"), re.MULTILINE)
    assert re.findall(r"^## (\d)\.", text, re.MULTILINE) == cells


def test_the_numbers_of_the_text_are_those_of_the_run(finished, summary):
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    row = r"^\| (raw|fixed 1 m|offset 0\.3 m) \| (0\.[^|]+\|[^|]+\|[^|]+) \|$"
    rows = dict(re.findall(row, text, re.MULTILINE))
    places = {"raw": ("raw", ""), "fixed 1 m": ("fixed", "1.0"), "offset 0.3 m": ("offset", "0.3")}
    assert rows.keys() == places.keys()
    for name, (mechanism, level) in places.items():
        at = summary[(summary["mechanism"] == mechanism) & (summary["level"] == level)]
        plr = at[(at["metric"] == "plr") & at["knowledge"].isin(["", "blind"])]
        values = plr.set_index("consumer")["value"].astype(float)
        shown = [float(one) for one in rows[name].split("|")]
        assert shown == pytest.approx(list(values[["shared", MINE, "kalman_rts"]]), abs=6e-4)
    answer = json.loads((finished[0] / "tutorial-run" / "verdict.json").read_text("utf-8"))[
        "answer"
    ]
    said = " ".join(text.split())
    assert [one for one in answer if one not in said] == []


def test_a_folder_can_be_redrawn_without_the_attack(finished):
    results = build(finished[0] / "tutorial-run", pictures=False)
    assert MINE in set(results.summary["consumer"])
