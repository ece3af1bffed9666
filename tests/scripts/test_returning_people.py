"""The example of people who come back, and the counts of planted crowds."""

import importlib.util
from pathlib import Path

import pandas as pd
import pytest
import returning_crowds
import returning_figure
from helpers.recordings import write_csv

import isac_track

EXAMPLE = Path(isac_track.__file__).parent.parent / "examples" / "returning_people.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("returning_people", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_crowd(path):
    """Write a small crowd, a track an id, with people and sessions."""
    sessions = ((6, 2, 3.6), (8, 2, 4.5))
    tracks = returning_crowds.returning_crowd(
        1, traits=3.0, is_order_kept=False, sessions=sessions, n_people=9
    )
    path.mkdir()
    for name in sorted(set(tracks.session)):
        parts = [
            pd.DataFrame(
                {
                    "t": walk.t,
                    "id": walk.source[0].split(":")[1],
                    "x": walk.xy[:, 0],
                    "y": walk.xy[:, 1],
                    "person": walk.person[0],
                }
            )
            for walk in tracks
            if walk.session[0] == name
        ]
        pd.concat(parts).to_csv(path / f"{name}.csv", index=False)


def test_the_example_prints_every_error_and_the_answer(example, tmp_path, capsys):
    write_crowd(tmp_path / "runs")
    out = tmp_path / "sweep.csv"
    options = ["--all-passages", "--error", "0,0.1", "--out", str(out)]
    assert example.main(["--dataset", str(tmp_path / "runs"), *options]) == 0
    shown = capsys.readouterr().out
    assert "Is the walk a fingerprint? not decided" in shown
    assert "too few" in shown
    table = pd.read_csv(out)
    assert len(table) == 2 * 4
    assert set(table.linker) == {*returning_figure.STYLES}
    for column in ("rank1", "control", "auc"):
        assert table[column].between(0, 1).all(), column


def test_a_recording_without_people_or_a_wrong_error_ends_in_a_line(
    example, tmp_path, capsys
):
    tracks = returning_crowds.returning_crowd(
        0, traits=0.0, is_order_kept=False, sessions=((4, 1, 3.6),), n_people=4
    )
    write_csv(tmp_path / "plain.csv", tracks)
    assert example.main(["--dataset", str(tmp_path / "plain.csv")]) == 2
    assert "person" in capsys.readouterr().err
    write_crowd(tmp_path / "runs")
    options = ["--dataset", str(tmp_path / "runs"), "--error", "much"]
    assert example.main(options) == 2
    assert capsys.readouterr().err == (
        "error: an error is a number of metres or raw, got 'much'\n"
    )


def test_counts_of_answers_have_exact_intervals():
    rows = pd.DataFrame(
        {
            "traits": ["none"] * 20,
            "kept": [False] * 20,
            "rank1": 0.03,
            "control": 0.04,
            "p": [0.001] + [0.5] * 19,
            "decision": ["yes"] + ["not decided"] * 19,
        }
    )
    (line,) = returning_crowds.summary(rows).to_dict("records")
    assert line["yes"] == "1 [0, 25] %"
    assert line["no"] == "0 [0, 17] %"
    assert line["p_below_1pct"] == pytest.approx(0.05)
