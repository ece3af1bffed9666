"""Tables of patrols: small runs, comparisons by hand, and pages that show the numbers."""

from pathlib import Path

import numpy as np
import pandas as pd
import patrol_estimates
import patrol_matching
import patrol_runs
import patrol_tables
import pytest
from patrol_names import NUMBERS

import isac_track
from isac_track import datasets
from isac_track.config import StageSettings
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.equal_alarms import AlarmCounts
from isac_track.patrols.knowledge import guesses_from_map, known_places
from isac_track.patrols.metrics import UtilityCounts, knowledge_metrics
from isac_track.patrols.network import share_patrol
from isac_track.place import placed
from isac_track.plugins import parse
from predictors.kalman import KalmanCV

RESULTS = Path(isac_track.__file__).parents[1] / "docs" / "results"
PEOPLE = 40


def test_pages_show_the_committed_numbers():
    for name, lines in patrol_tables.pages(RESULTS).items():
        assert (RESULTS / name).read_text(encoding="utf-8").splitlines() == lines


@pytest.fixture
def counted(tmp_path, csv_recording):
    """Counts of a small patrol, and the folder of the numbers made of them."""
    folder = tmp_path / "patrols"
    folder.mkdir()
    words = ["--dataset", str(csv_recording), "--fleets", "2", "--segment", "8"]
    words += ["--robot", "least_squares", "--out", str(folder)]
    for policy in ("everything", "near:3.5"):
        words += ["--policy", policy]
    for mechanism in ("raw", "fid:1"):
        words += ["--mechanism", mechanism]
    assert patrol_runs.main(words) == 0
    assert patrol_estimates.main([str(folder), "--out", str(folder)]) == 0
    return folder


def test_numbers_are_those_of_the_library_and_stay(counted, csv_recording, capsys):
    numbers = pd.read_csv(counted / NUMBERS)
    settings = StageSettings().changed({"patrol.fleets": 2, "patrol.segment_s": 8.0})
    recorded = placed(datasets.load(csv_recording).tracks, settings=settings)
    patrol = make_patrol(recorded, settings=settings, seed=0)
    network = share_patrol(
        patrol,
        mechanism=parse("mechanisms", "fid:1")[0].instance,
        forecaster=KalmanCV(),
        settings=settings,
        seed=0,
    )
    known = known_places(
        network,
        disclose(network, parse("policies", "near:3.5")[0].instance),
        guesses=guesses_from_map(patrol, epsilon_m=0.3),
        epsilon_m=0.3,
    )
    metrics = knowledge_metrics(known, group=patrol.people.group, seed=0)
    rows = numbers[(numbers.mechanism == "fid:1") & (numbers.policy == "near:3.5")]
    for name in ("disclosed_share", "known_share", "people_seen"):
        (row,) = rows[(rows.knowledge == "oracle") & (rows.metric == name)].to_dict(
            "records"
        )
        assert row["value"] == pytest.approx(metrics[name].value, rel=1e-3)
    capsys.readouterr()
    words = ["--dataset", str(csv_recording), "--fleets", "2", "--segment", "8"]
    words += ["--policy", "near:3.5", "--mechanism", "fid:1", "--out", str(counted)]
    assert patrol_runs.main(words) == 0
    assert capsys.readouterr().out == ""  # A second run counts what is missing alone.


def test_without_counts_the_way_out_is_named(tmp_path, capsys):
    assert patrol_estimates.main([str(tmp_path), "--out", str(tmp_path)]) == 2
    assert "run scripts/patrol_runs.py" in capsys.readouterr().err


def make_option(mechanism, policy, *, known, missed):
    """An option that knows and misses the same shares of everybody on all routes."""
    n_routes, trials = 20, np.full((PEOPLE, 20), 10)
    n_missed = round(10 * missed)
    hits = np.full((PEOPLE, n_routes), n_missed)
    metric = patrol_matching.MISSED
    person, route, number = np.indices((PEOPLE, n_routes, 10)).reshape(3, -1)
    by_distance = AlarmCounts(
        alarms=np.arange(3)[:, None] * np.ones((1, n_routes), dtype=int),
        person=person,
        route=route,
        step=np.where(number < n_missed, 3, 0),  # Missed at every distance, or at none.
    )
    counts = UtilityCounts(
        hits={metric: hits},
        trials={metric: trials},
        false_alarms=np.zeros(n_routes, dtype=int),
        walked_s=1.0,
        by_distance=by_distance,
        allowed=np.ones(n_routes, dtype=int),
    )
    return patrol_matching.Option(
        mechanism=mechanism,
        policy=policy,
        group=tuple(map(str, range(PEOPLE))),
        seed=0,
        instants=np.full(PEOPLE, 100),
        known={"own chains": np.full((PEOPLE, n_routes), round(100 * known))},
        misses={"kalman_cv": counts},
    )


@pytest.fixture(scope="module")
def matched():
    options = [
        make_option("raw", "everything", known=0.9, missed=0.2),
        make_option("raw", "near:3.5", known=0.3, missed=0.3),
        make_option("raw", "state:2", known=0.2, missed=0.5),  # It costs too much.
        make_option("raw", "random:0.2", known=0.0, missed=0.2),  # A control.
        make_option("fid:10", "everything", known=0.7, missed=0.3),
        make_option("fid:100", "everything", known=0.9, missed=0.2),
        make_option("ou:0.1", "everything", known=0.8, missed=0.2),
        make_option("ou:0.4", "everything", known=0.4, missed=0.4),
        make_option("ou:0.4", "near:3.5", known=0.1, missed=0.3),
    ]
    return pd.DataFrame(patrol_matching.compare_options("here", options))


def test_a_policy_meets_the_noise_of_as_many_misses(matched):
    rows = matched[matched.question == "positions against noise"]
    assert set(rows.criterion) == set(patrol_matching.CRITERIA)
    for row in rows[rows.slack == 0.10].to_dict("records"):
        # Halfway between the two levels of `ou`: 0.6, less than 0.7 of `fid`.
        assert (row["choice"], row["against"]) == ("near:3.5", "ou")
        assert row["missed_against"] == pytest.approx(0.3)
        assert row["known_less"] == pytest.approx(0.3)
        assert row["known_less_low"] == pytest.approx(0.3)
    for row in rows[rows.slack == 0.05].to_dict("records"):
        # No policy costs so little, and no noise either.
        assert (row["choice"], row["against"]) == ("everything", "raw")


def test_noise_on_top_of_a_policy_is_compared_with_the_policy(matched):
    rows = matched[matched.question == "noise on a policy"]
    for row in rows.to_dict("records"):
        assert (row["choice"], row["against"]) == ("near:3.5 with ou:0.4", "near:3.5")
        assert row["known_less"] == pytest.approx(0.2)
        assert row["missed_more"] == pytest.approx(0.0)
    rows = matched[matched.question == "policies with noise against policies without"]
    (choice,) = set(rows[rows.slack == 0.10].choice)
    assert choice == "near:3.5 with ou:0.4"


def test_a_choice_is_scored_on_the_people_who_did_not_make_it():
    # In either half another policy looks best, and is worst in the other half.
    first = patrol_matching.first_half(tuple(map(str, range(PEOPLE))))
    options = [
        make_option("raw", "everything", known=0.9, missed=0.2),
        make_option("raw", "near:1", known=0.5, missed=0.2),
        make_option("raw", "near:2", known=0.5, missed=0.2),
        *(
            make_option(f"fid:{eta}", "everything", known=0.9, missed=0.2)
            for eta in range(1, 5)
        ),
    ]
    options[1].known["own chains"][first] = 0
    options[1].known["own chains"][~first] = 100
    options[2].known["own chains"][first] = 100
    options[2].known["own chains"][~first] = 0
    for row in patrol_matching.compare_options("here", options):
        if row.question == "samples against noise":
            assert row.choice in ("near:1 / near:2", "near:2 / near:1")
            assert row.known == pytest.approx(1.0)
