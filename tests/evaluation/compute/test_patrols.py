"""Patrols of a run: the numbers of the library, whatever else is in the run."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from helpers.commands import assert_refused
from helpers.small_runs import smoke, write_walks

import evaluation
from attacks.following.followed import following_metrics
from attacks.following.logs import follow_fleets
from evaluation import matrix
from evaluation.compute.patrol_rows import (
    followed_from_rows,
    followed_rows,
    known_from_rows,
    known_rows,
    utility_counts,
    utility_tables,
)
from evaluation.estimates.differences import compare
from evaluation.plan.axes import expand_axes
from evaluation.pool.execute import FailedCellsWarning
from evaluation.reporting.failed_cells import failed_lines
from evaluation.reporting.patrol_tables import patrol_tables
from evaluation.reporting.patrol_words import patrol_sentence
from isac_track import datasets
from isac_track.patrols import horizon_scans, make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.estimators import ESTIMATORS
from isac_track.patrols.knowledge import guesses_from_map, known_places
from isac_track.patrols.metrics import (
    count_utility,
    foresee,
    knowledge_metrics,
    robot_task,
    utility_metrics,
)
from isac_track.patrols.network import share_patrol
from isac_track.place import placed
from isac_track.plugins import parse
from isac_track.policies.samples import Everything
from isac_track.sharing import Raw
from predictors.kalman import KalmanCV
from predictors.least_squares import LeastSquares

POLICIES = ("near:3", "random:0.5", "flag")
FEW = {"patrol.fleets": 2, "patrol.segment_s": 20.0, "conflict.horizons_s": (2.0,)}
KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric", "policy"]


def run(csv_recording, out, **changes):
    """A small run with patrols, as a frame."""
    usual = {"mechanisms": ("raw", "fixed:0.5"), "policies": POLICIES, "stages": FEW}
    settings = smoke(csv_recording, out, **(usual | changes))
    return evaluation.run(settings, progress=False, pictures=False)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("patrols") / "walks.csv"
    write_walks(path, n_people=12)
    return path


@pytest.fixture(scope="module")
def made(recording):
    return run(recording, recording.parent / "run")


@pytest.fixture(scope="module")
def world(recording):
    """The same patrol, from the library alone."""
    stages = smoke(recording, stages=FEW).stages
    tracks = placed(datasets.load(str(recording)).tracks, settings=stages)
    patrol = make_patrol(tracks, settings=stages, seed=0)
    (mechanism,) = parse("mechanisms", "fixed:0.5")
    network = share_patrol(
        patrol,
        mechanism=mechanism.instance,
        forecaster=KalmanCV(),
        settings=stages,
        seed=0,
    )
    unnoised = share_patrol(
        patrol, mechanism=Raw(), forecaster=KalmanCV(), settings=stages, seed=0
    )
    reference, task = None, None
    for each in (unnoised, network):
        task = robot_task(
            each,
            disclose(each, Everything()),
            predictor=LeastSquares(),
            settings=stages,
            reference=reference,
        )
        reference = reference or task
    guesses = guesses_from_map(patrol, epsilon_m=stages.privacy.epsilon_m)
    return {"stages": stages, "network": network, "task": task, "guesses": guesses}


def value(made, policy, consumer, metric, *, knowledge="", world=""):
    rows = made.summary[made.summary["policy"] == policy]
    rows = rows[(rows["mechanism"] == "fixed") & (rows["consumer"] == consumer)]
    rows = rows[(rows["metric"] == metric) & (rows["knowledge"] == knowledge)]
    name = f"{made.dataset}:{world}" if world else made.dataset
    (number,) = rows.loc[rows["dataset"] == name, "value"]
    return number


@pytest.mark.parametrize("policy", POLICIES)
def test_numbers_are_those_of_the_library(made, world, policy):
    network, task, stages = world["network"], world["task"], world["stages"]
    (plugin,) = parse("policies", policy)
    disclosure = disclose(network, plugin.instance)
    for horizon, name in zip(horizon_scans(stages), ("", "horizon=2s"), strict=True):
        expected = utility_metrics(task, disclosure, horizon=horizon, seed=0)
        for metric, estimate in expected.items():
            ours = value(made, policy, "least_squares", metric, world=name)
            np.testing.assert_equal(ours, estimate.value)
    epsilon_m = stages.privacy.epsilon_m
    known = known_places(
        network, disclosure, guesses=world["guesses"], epsilon_m=epsilon_m
    )
    group = network.patrol.people.group
    expected = knowledge_metrics(known, group=group, seed=0)
    for metric in ("known_share", "known_undisclosed", "known_worst_tenth"):
        ours = value(made, policy, "log", metric, knowledge="oracle")
        np.testing.assert_equal(ours, expected[metric].value)
    for metric in ("disclosed_share", "people_seen", "plr_walk"):
        ours = value(made, policy, "shared", metric)
        np.testing.assert_equal(ours, expected[metric].value)
    by_map = expected["known_by_map"].value
    np.testing.assert_equal(value(made, policy, "map", "known_share"), by_map)
    for knowledge, knows in (("blind", None), ("informed", plugin.instance)):
        following = follow_fleets(
            network,
            disclosure,
            estimator=ESTIMATORS[known.best],
            guesses=world["guesses"],
            epsilon_m=epsilon_m,
            seed=0,
            knows_policy=knows,
        )
        expected_followed = following_metrics(following, group=group, seed=0)
        for metric in ("known_share", "followed_s", "followed_10s"):
            ours = value(made, policy, "log", metric, knowledge=knowledge)
            np.testing.assert_equal(ours, expected_followed[metric].value)


def test_rows_are_unique_and_all_others_have_no_policy(made, recording):
    assert not made.summary.duplicated(KEY).any()
    assert set(made.patrols["policy"]) == set(POLICIES)
    alone = run(recording, recording.parent / "alone", policies=())
    others = made.without_policy.reset_index(drop=True)
    pd.testing.assert_frame_equal(others, alone.summary, check_exact=True)


def test_options_of_a_log_reach_the_numbers(recording):
    named = {"patrol.errors": "query", "patrol.pseudonyms": "encounter"}
    results = run(
        recording,
        recording.parent / "named",
        policies=("near:3",),
        mechanisms=("fixed:0.5",),
        stages=FEW | named,
    )
    stages = smoke(recording, stages=FEW | named).stages
    tracks = placed(datasets.load(str(recording)).tracks, settings=stages)
    patrol = make_patrol(tracks, settings=stages, seed=0)
    network = share_patrol(
        patrol,
        mechanism=parse("mechanisms", "fixed:0.5")[0].instance,
        forecaster=KalmanCV(),
        settings=stages,
        seed=0,
    )
    disclosure = disclose(network, parse("policies", "near:3")[0].instance)
    guesses = guesses_from_map(patrol, epsilon_m=stages.privacy.epsilon_m)
    places = {"guesses": guesses, "epsilon_m": stages.privacy.epsilon_m}
    known = known_places(network, disclosure, **places)
    expected = knowledge_metrics(known, group=patrol.people.group, seed=0)
    ours = value(results, "near:3", "log", "known_share", knowledge="oracle")
    assert ours == expected["known_share"].value
    following = follow_fleets(
        network,
        disclosure,
        estimator=ESTIMATORS[known.best],
        seed=0,
        pseudonyms="encounter",
        **places,
    )
    ours = value(results, "near:3", "log", "followed_s", knowledge="blind")
    expected = following_metrics(following, group=patrol.people.group, seed=0)
    assert ours == expected["followed_s"].value


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        ("window:0", "'window:0': seconds must be positive, got 0.0"),
        ("near:-1", "'near:-1': metres must be positive, got -1.0"),
        ("random:2", "'random:2': share must lie within 0 to 1, got 2.0"),
        ("nearr:2", "unknown policy 'nearr'; did you mean 'near'?"),
        (
            "ahead:2,horizon_s=9",
            "policy ahead:2,horizon_s=9: horizon_s=9 is beyond the 4.01 s that",
        ),
        ("state:2,horizon_s=9", "--set conflict.horizons_s=3,9"),
    ],
)
def test_a_policy_that_cannot_be_meant_is_one_line(ran, recording, policy, says):
    words = ["--preset", "smoke", "--dataset", recording, "--out", "never"]
    assert_refused(ran(matrix, *words, "--policy", policy), says)


@pytest.mark.parametrize("horizon", ["horizon_s=9", "horizon_s=4.1"])
def test_a_longer_horizon_of_conflicts_makes_room_for_that_of_a_policy(horizon):
    settings = smoke("plaza", policies=(f"ahead:2,{horizon}",))
    stages = settings.stages.changed({"conflict.horizons_s": (9.0,)})
    assert expand_axes(replace(settings, stages=stages)).patrols.policies


@pytest.mark.usefixtures("single_process")
def test_a_robot_that_meets_nobody_and_a_single_person_are_said(recording, tmp_path):
    brief = FEW | {"patrol.segment_s": 0.5, "patrol.fleets": 1}
    named = {"policies": ("everything", "near:0.2"), "mechanisms": ("raw",)}
    nobody = run(recording, tmp_path / "brief", stages=brief, **named)
    met = nobody.patrols[nobody.patrols["metric"] == "missed_future_rate"]
    assert met["value"].isna().all()
    assert patrol_sentence(nobody).startswith(
        "Nothing is proposed: no robot meets anybody; add --set patrol.fleets=20"
    )
    robots = patrol_tables(nobody)[1]
    assert any(note.startswith("Empty: a robot met nobody") for note in robots.notes)
    alone = write_walks(tmp_path / "alone.csv", n_people=1)
    single = run(alone, tmp_path / "alone", stages=FEW | {"scenes.agents": 1}, **named)
    shares = single.patrols[single.patrols["metric"] == "known_share"]
    assert np.isfinite(shares["value"]).all()
    assert "no policy of this run lowers that within" in patrol_sentence(single)


@pytest.mark.usefixtures("single_process")
def test_a_cell_that_fails_names_its_policy_and_fails_alone(made, recording):
    out, spec = recording.parent / "failing", "helpers.bad_plugins:Overrun:3"
    longer = {"stages": FEW | {"patrol.segment_s": 30.0}, "mechanisms": ("raw",)}
    with pytest.warns(FailedCellsWarning, match="too late"):
        results = run(recording, out, policies=("near:3", spec), **longer)
    failed = pd.read_csv(out / "failed.csv", keep_default_na=False)
    assert set(failed["policy"]) == {spec}
    assert set(failed["consumer"]) == {"least_squares", "log"}
    assert len(failed) == 2 + 3  # Two horizons, three adversaries.
    own, ahead = (
        line for line in failed_lines(failed) if line.startswith("least_squares")
    )
    assert own.startswith(f"least_squares under {spec} at raw: policy {spec} failed")
    assert ahead.startswith(f"least_squares under {spec} in horizon=2s at raw: policy")
    # A run of an earlier version wrote no world: both horizons are one line there.
    earlier = failed_lines(failed.drop(columns="world"))
    assert own in earlier
    assert ahead not in earlier
    is_near = made.patrols["policy"] == "near:3"
    usual = made.patrols[is_near & (made.patrols["mechanism"] == "raw")]
    assert set(results.patrols["policy"]) == {"near:3"}
    assert results.patrols["metric"].tolist() == usual["metric"].tolist()


def test_two_workers_and_another_order_give_the_same_rows(made, recording):
    other = run(
        recording,
        recording.parent / "other",
        policies=(*POLICIES[::-1], "state"),
        mechanisms=("fid:3", "fixed:0.5", "raw"),
        jobs=2,
    )
    ours, theirs = (
        result.patrols.fillna({"level": -1.0}).set_index(KEY).sort_index()
        for result in (made, other)
    )
    assert set(ours.index) < set(theirs.index)
    pd.testing.assert_frame_equal(theirs.loc[ours.index], ours, check_exact=True)
    rows = compare(made.out, other.out).rows
    on_patrol = rows[rows["policy"] != ""]
    assert len(on_patrol) == ours["value"].notna().sum()
    assert set(on_patrol["finding"]) == {"identical"}
    assert set(on_patrol["pairing"]) == {"people and draws"}
    assert not on_patrol["headline"].any()


def test_numbers_of_other_patrols_are_compared_without_pairing(made, recording):
    other = run(
        recording,
        recording.parent / "other-patrols",
        policies=("near:3",),
        stages=FEW | {"patrol.robots": 2},
    )
    rows = compare(made.out, other.out).rows
    on_patrol = rows[rows["policy"] != ""]
    assert set(on_patrol["policy"]) == {"near:3"}
    assert set(on_patrol["pairing"]) == {"none"}
    (known,) = on_patrol.query(
        "mechanism == 'fixed' and consumer == 'log' and knowledge == 'oracle'"
        " and metric == 'known_share'"
    ).to_dict("records")
    before, after = (
        value(each, "near:3", "log", "known_share", knowledge="oracle")
        for each in (made, other)
    )
    assert known["difference"] == pytest.approx(after - before)


def test_a_policy_is_added_to_a_folder_and_other_patrols_replace_its_own(
    recording, tmp_path
):
    out = tmp_path / "run"
    first = run(recording, out, policies=("near:3",))
    more = run(recording, out, policies=("flag",))
    assert set(more.patrols["policy"]) == {"near:3", "flag"}
    kept = more.patrols[more.patrols["policy"] == "near:3"].reset_index(drop=True)
    before = first.patrols.reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before, check_exact=True)
    again = run(recording, out, policies=("flag",), stages=FEW | {"patrol.robots": 2})
    assert set(again.patrols["policy"]) == {"flag"}


def test_rows_hold_all_that_estimates_need(world):
    network, task, stages = world["network"], world["task"], world["stages"]
    (plugin,) = parse("policies", "near:3")
    disclosure = disclose(network, plugin.instance)
    horizon = horizon_scans(stages)[-1]
    counts = count_utility(task, foresee(task, disclosure), horizon=horizon)
    back = utility_counts(utility_tables(counts))
    for part in ("hits", "trials", "allowed"):
        np.testing.assert_equal(getattr(back, part), getattr(counts, part))
    for part in ("alarms", "person", "route", "step"):
        ours, theirs = (getattr(each.by_distance, part) for each in (back, counts))
        np.testing.assert_equal(ours, theirs)
    known = known_places(
        network,
        disclosure,
        guesses=world["guesses"],
        epsilon_m=stages.privacy.epsilon_m,
    )
    following = follow_fleets(
        network,
        disclosure,
        estimator="smooth",
        guesses=world["guesses"],
        epsilon_m=stages.privacy.epsilon_m,
        seed=0,
    )
    for before, after in (
        (known, known_from_rows(known_rows(known))),
        (following, followed_from_rows(followed_rows(following))),
    ):
        for name in type(before).__dataclass_fields__:
            np.testing.assert_equal(getattr(after, name), getattr(before, name))


def test_what_a_forecasting_policy_withholds_is_a_result(recording):
    # It decides by the robot's own forecast, within less than the safety radius.
    narrow = parse("policies", "ahead:0.01,window_s=none")[0].spec
    made = run(
        recording,
        recording.parent / "narrow",
        mechanisms=("raw",),
        predictors=("kalman_cv",),
        policies=("everything", narrow),
        stages=FEW | {"patrol.fleets": 4},
    )
    rows = made.summary[made.summary["metric"] == "withheld_share"]
    withholds = rows[(rows["policy"] == narrow) & (rows["value"] > 0.0)]
    assert not withholds.empty
    marked = {
        (place["policy"], f"{made.dataset}:{place['world']}".rstrip(":"))
        for place in made.verdict["patrols"]["by_construction"]
    }
    assert ("everything", made.dataset) in marked
    assert not marked & {(narrow, name) for name in withholds["dataset"]}
