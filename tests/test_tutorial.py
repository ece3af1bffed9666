"""The tutorial, run as a reader would: in an empty folder with its two files."""

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
from helpers.small_runs import single_process

from evaluation.api import build

EXAMPLE = ROOT / "examples" / "tutorial"
TEXT = (ROOT / "docs" / "tutorial" / "first-study.md").read_text(encoding="utf-8")
KEY = ["consumer", "metric", "mechanism", "level"]
ATTACK = "geometric_median:GeometricMedian"
FILES = (
    "report.html",
    "figures/after_attack.svg",
    "tables/attacks.tex",
    *(f"{name}.csv" for name in ("summary", "matched", "linkability")),
    *(f"{name}.json" for name in ("manifest", "verdict", "flags")),
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return the files of the run, and the output of the script."""
    folder, said = tmp_path_factory.mktemp("tutorial"), io.StringIO()
    for path in EXAMPLE.glob("*.py"):
        shutil.copy(path, folder)
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said), single_process():
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
    """Return the value of a metric for a consumer without knowledge."""
    blind = finished.summary[finished.summary["knowledge"].isin(["", "blind"])]
    values = blind.set_index(KEY).sort_index()["value"]
    return float(values[(consumer, metric, mechanism, level)])


def test_the_run_leaves_a_report(finished):
    out = finished.out
    assert [name for name in FILES if not (out / name).stat().st_size] == []
    assert ATTACK in (out / "report.html").read_text("utf-8")
    dataset = json.loads((out / "manifest.json").read_text("utf-8"))["dataset"]
    assert (dataset["name"], dataset["tracks"]) == ("walks", 474)
    assert "474 tracks; mended on reading: nothing" in finished.said
    assert "attack kit: all checks pass" in finished.said


def test_the_attack_is_judged_like_the_built_in_one(finished):
    metrics = finished.summary.groupby("consumer")["metric"].agg(set)
    assert {"plr", "ael", "mel"} < metrics[ATTACK] == metrics["kalman_rts"]
    assert metrics[f"rerelease/shape@{ATTACK}"] == metrics["rerelease/shape@kalman_rts"]


def test_what_the_text_says_of_the_attack_is_so(finished):
    """The attack undoes less noise than the smoother, and links more people."""
    at = "fixed", "1.0"
    plr = [
        value(finished, consumer, "plr", *at)
        for consumer in ("shared", ATTACK, "kalman_rts")
    ]
    assert plr[0] < plr[1] < plr[2]
    ours, smoother = (
        f"rerelease/shape@{consumer}" for consumer in (ATTACK, "kalman_rts")
    )
    assert (
        value(finished, ours, "rank1", *at)
        > value(finished, smoother, "rank1", *at)
        > 0.1
    )
    # Moved as a whole, a walk is linked as if it had been shared raw.
    moved, raw = ("offset", "0.3"), ("raw", "")
    linked = value(finished, ours, "rank1", *moved)
    assert linked == pytest.approx(value(finished, ours, "rank1", *raw), abs=0.02)
    shared = value(finished, "shared", "plr", *moved)
    assert shared < value(finished, "shared", "plr", *raw) - 0.1


def test_verdict_and_design_question_are_answered(finished):
    verdict, said = finished.verdict, finished.said
    sections = {item["section"] for item in verdict["items"]}
    assert sections == {"validity", "within", "claim", "inflation"}
    assert all(sentence in said for sentence in verdict["answer"])
    validity = [item for item in verdict["items"] if item["section"] == "validity"]
    assert {item["decision"] for item in validity} == {"not testable"}
    assert validity[0]["sentence"] in " ".join(TEXT.split())
    offset = [
        gap
        for item in validity
        for gap in item["contrasts"]
        if gap["mechanism"] == "offset"
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
        shown = [float(number) for number in rows[name].split("|")]
        plr = [
            value(finished, consumer, "plr", *at)
            for consumer in ("shared", ATTACK, "kalman_rts")
        ]
        assert shown == pytest.approx(plr, abs=6e-4)
    text = " ".join(TEXT.split())
    missing = [line for line in finished.verdict["answer"] if line not in text]
    assert missing == []


def test_a_folder_can_be_redrawn_without_the_attack(finished):
    assert ATTACK in set(build(finished.out).summary["consumer"])
