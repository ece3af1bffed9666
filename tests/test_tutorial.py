"""The tutorial, run as a reader would: in an empty folder, with the two files beside each other."""

import io
import json
import re
import runpy
import shutil
import sys
from contextlib import redirect_stdout
from types import SimpleNamespace

import pandas as pd
import pytest
from helpers.processes import ROOT
from helpers.small_runs import one_process

from evaluation.api import build

EXAMPLE = ROOT / "examples" / "tutorial"
TEXT = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
KEY = ["consumer", "metric", "mechanism", "level"]
MINE = "geometric_median:GeometricMedian"
FILES = (
    "report.html",
    "figures/after_attack.svg",
    "tables/attacks.tex",
    *(f"{name}.csv" for name in ("summary", "matched", "linkability")),
    *(f"{name}.json" for name in ("manifest", "verdict", "flags")),
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The run as its files hold it, and what the script said."""
    folder, said = tmp_path_factory.mktemp("tutorial"), io.StringIO()
    for path in EXAMPLE.glob("*.py"):
        shutil.copy(path, folder)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), one_process():
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        runpy.run_path("tutorial.py")
    del sys.modules["geometric_median"]  # the name is free again
    out = folder / "tutorial-run"
    verdict = json.loads((out / "verdict.json").read_text("utf-8"))
    summary = pd.read_csv(out / "summary.csv", keep_default_na=False)
    return SimpleNamespace(
        out=out, said=said.getvalue(), verdict=verdict, summary=summary
    )


def value(finished, consumer, metric, mechanism, level):
    """What a consumer without knowledge comes to."""
    found = finished.summary[finished.summary["knowledge"].isin(["", "blind"])]
    row = found.set_index(KEY).sort_index()["value"]
    return float(row[(consumer, metric, mechanism, level)])


def test_the_run_leaves_a_report(finished):
    out = finished.out
    assert [name for name in FILES if not (out / name).stat().st_size] == []
    assert MINE in (out / "report.html").read_text("utf-8")
    dataset = json.loads((out / "manifest.json").read_text("utf-8"))["dataset"]
    assert (dataset["name"], dataset["tracks"]) == ("walks", 474)
    assert "474 tracks; mended on reading: nothing" in finished.said
    assert "attack kit: all checks pass" in finished.said


def test_the_attack_is_judged_like_the_built_in_one(finished):
    metrics = finished.summary.groupby("consumer")["metric"].agg(set)
    assert {"plr", "ael", "mel"} < metrics[MINE] == metrics["kalman_rts"]
    assert metrics[f"rerelease/shape@{MINE}"] == metrics["rerelease/shape@kalman_rts"]


def test_what_the_text_says_of_the_attack_is_so(finished):
    """It undoes less than the smoother, and links more people."""
    at = "fixed", "1.0"
    plr = [value(finished, one, "plr", *at) for one in ("shared", MINE, "kalman_rts")]
    assert plr[0] < plr[1] < plr[2]
    mine, smoother = (f"rerelease/shape@{one}" for one in (MINE, "kalman_rts"))
    assert (
        value(finished, mine, "rank1", *at)
        > value(finished, smoother, "rank1", *at)
        > 0.1
    )
    # Moved as a whole, a walk is linked as if it had been shared raw.
    moved, raw = ("offset", "0.3"), ("raw", "")
    linked = value(finished, mine, "rank1", *moved)
    assert linked == pytest.approx(value(finished, mine, "rank1", *raw), abs=0.02)
    shared = value(finished, "shared", "plr", *moved)
    assert shared < value(finished, "shared", "plr", *raw) - 0.1


def test_verdict_and_design_question_are_answered(finished):
    verdict, said = finished.verdict, finished.said
    sections = {one["section"] for one in verdict["items"]}
    assert sections == {"validity", "within", "claim", "inflation"}
    assert all(sentence in said for sentence in verdict["answer"])
    found = [one for one in verdict["items"] if one["section"] == "validity"]
    assert {one["decision"] for one in found} == {"not testable"}
    assert found[0]["sentence"] in " ".join(TEXT.split())
    offset = [
        gap for one in found for gap in one["contrasts"] if gap["mechanism"] == "offset"
    ]
    assert all(
        gap["evidence"] == "construction" and gap["reading"] == "differs"
        for gap in offset
    )
    assert offset[0]["effect"] == pytest.approx(0.13, abs=0.005)
    answer = (
        "straight line misses up to 88 % of future conflicts within 3 s (limit 45 %);"
        " about 75"
    )
    assert all(answer in " ".join(text.split()) for text in (said, TEXT))
    assert said.rstrip().endswith("exit code: 1")


def test_the_text_shows_the_files_as_they_are():
    ((name, shown),) = re.findall(
        r"```python\n# (\w+\.py)\n(.*?)```", TEXT, flags=re.DOTALL
    )
    assert (EXAMPLE / name).read_text("utf-8").endswith(shown)
    cells = re.findall(
        r"^# %% (\d)\.", (EXAMPLE / "tutorial.py").read_text("utf-8"), re.MULTILINE
    )
    assert re.findall(r"^## (\d)\.", TEXT, re.MULTILINE) == cells


def test_the_numbers_of_the_text_are_those_of_the_run(finished):
    row = r"^\| (raw|fixed 1 m|offset 0\.3 m) \| (0\.[^|]+\|[^|]+\|[^|]+) \|$"
    rows = dict(re.findall(row, TEXT, re.MULTILINE))
    places = {
        "raw": ("raw", ""),
        "fixed 1 m": ("fixed", "1.0"),
        "offset 0.3 m": ("offset", "0.3"),
    }
    assert rows.keys() == places.keys()
    for name, at in places.items():
        shown = [float(one) for one in rows[name].split("|")]
        plr = [
            value(finished, one, "plr", *at) for one in ("shared", MINE, "kalman_rts")
        ]
        assert shown == pytest.approx(plr, abs=6e-4)
    text = " ".join(TEXT.split())
    assert [one for one in finished.verdict["answer"] if one not in text] == []


def test_a_folder_can_be_redrawn_without_the_attack(finished):
    assert MINE in set(build(finished.out).summary["consumer"])
