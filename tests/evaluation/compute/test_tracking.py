"""Tracks of a run: as without tracking if nothing is lost, whatever else is in the run."""

import numpy as np
import pandas as pd
import pytest
from helpers.commands import assert_refused
from helpers.patrols import straight_walks
from helpers.recordings import write_csv
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation import matrix
from evaluation.compute.current_cell import current_cell
from evaluation.compute.loops import list_loops
from evaluation.compute.recipients import strongest
from evaluation.compute.track_links import LINK_COLUMNS, link_rows
from evaluation.compute.track_rows import FOLLOWED_COLUMNS, TRACK_COLUMNS, track_rows
from evaluation.compute.tracking_setup import make_tracking_setup, share_tracked
from evaluation.compute.work import TrackingWork, compute_cells
from evaluation.plan.axes import expand_axes
from evaluation.plan.plan import make_plan
from evaluation.pool.execute import FailedCellsWarning
from evaluation.pool.pieces import cut_work, planned_cells
from evaluation.reporting.first_screen import first_screen
from evaluation.reporting.tracking_table import tracking_sentence, tracking_table
from isac_track import compiling, datasets
from isac_track.config import StageSettings
from isac_track.errors import SettingsError
from isac_track.plugins import parse

FEW = {
    "patrol.fleets": 2,
    "patrol.segment_s": 12.0,
    "conflict.horizons_s": (2.0,),
    "tracking.method": "gnn",
    "tracking.seeds": 2,
    "tracking.block_s": 0.6,
}
CERTAIN = {"tracking.detection_probability": 1.0, "tracking.clutter_per_scan": 0.0}
KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric", "policy"]


def run(recording, out, *, stages=FEW, **changes):
    usual = {"mechanisms": ("raw", "fixed:0.5"), "policies": ()}
    settings = smoke(recording, out, **(usual | changes), stages=stages)
    return evaluation.run(settings, progress=False, pictures=False)


def indexed(rows):
    return rows.fillna({"level": -1.0}).set_index(KEY).sort_index()


def values(rows, policy, metric, consumer=None):
    rows = rows[(rows["policy"] == policy) & (rows["metric"] == metric)]
    rows = rows if consumer is None else rows[rows["consumer"] == consumer]
    return rows.fillna({"level": -1.0}).set_index(["dataset", "mechanism"])["value"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_walks(tmp_path_factory.mktemp("tracks") / "walks.csv", n_people=12)


@pytest.fixture(scope="module")
def made(recording):
    return run(recording, recording.parent / "run")


def test_rows_are_unique_and_all_others_are_those_of_a_run_without(made, recording):
    assert not made.summary.duplicated(KEY).any()
    assert set(made.tracks["policy"]) == {"tracks:oracle", "tracks:gnn"}
    usual = FEW | {"tracking.method": "oracle"}
    alone = run(recording, recording.parent / "alone", stages=usual)
    assert alone.tracks.empty
    others = made.without_policy.reset_index(drop=True)
    pd.testing.assert_frame_equal(others, alone.summary, check_exact=True)


@pytest.mark.slow
def test_two_workers_and_other_mechanisms_give_the_same_rows(made, recording):
    other = run(
        recording,
        recording.parent / "other",
        mechanisms=("fid:3", "fixed:0.5", "raw"),
        jobs=2,
    )
    ours, theirs = indexed(made.tracks), indexed(other.tracks)
    assert set(ours.index) < set(theirs.index)
    pd.testing.assert_frame_equal(theirs.loc[ours.index], ours, check_exact=True)


def test_with_certain_detection_the_oracle_is_the_policy_everything(recording):
    certain = run(
        recording,
        recording.parent / "certain",
        mechanisms=("raw",),
        policies=("everything",),
        predictors=("kalman_cv",),
        stages=FEW | CERTAIN | {"tracking.seeds": 1},
    )
    rows, recorded = certain.summary, datasets.load(str(recording)).tracks
    for metric, consumer in (
        ("missed_conflict_rate", "kalman_cv"),
        ("missed_future_rate", "kalman_cv"),
        ("missed_future_at_equal_false_alarms", "kalman_cv"),
        ("false_alarms_per_min", "kalman_cv"),
    ):
        ours = values(rows, "tracks:oracle", metric, consumer)
        usual = rows[(rows["policy"] == "everything") & (rows["metric"] == metric)]
        usual = usual[usual["consumer"] == consumer]
        expected = usual.set_index(["dataset", "mechanism"])["value"]
        np.testing.assert_allclose(ours, expected.loc[ours.index], rtol=1e-12)
    # Tracks have the samples after the last query, too.
    log = rows[(rows["policy"] == "everything") & (rows["metric"] == "known_share")]
    usual = log.loc[log["knowledge"] == "oracle", "value"].item()
    assert usual <= values(rows, "tracks:oracle", "known_share").item() < usual + 0.06
    assert (values(rows, "tracks:oracle", "purity") == 1.0).all()
    assert (values(rows, "tracks:oracle", "fragments") == 0.0).all()
    present_s = np.diff(
        [[walk.t[0], min(walk.t[-1], FEW["patrol.segment_s"])] for walk in recorded]
    )
    followed_s = values(rows, "tracks:oracle", "followed_s").item()
    assert followed_s == pytest.approx(present_s.mean(), abs=0.1)
    assert values(rows, "tracks:oracle", "rejoined_share").isna().all()


POLICIES = ("everything", "window:2", "near:3", "ahead:1.5", "state", "flag")


@pytest.fixture(scope="module")
def answered(recording):
    """A run in which policies answer from certain tracks of the oracle, and as usual."""
    return run(
        recording,
        recording.parent / "answered",
        mechanisms=("raw", "fixed:0.5"),
        policies=POLICIES,
        predictors=("kalman_cv",),
        stages=FEW | CERTAIN | {"tracking.seeds": 1},
    )


@pytest.mark.parametrize("policy", POLICIES)
def test_a_policy_answers_from_perfect_tracks_as_about_people(answered, policy):
    rows = answered.summary[answered.summary["mechanism"] == "raw"]
    on_tracks = f"tracks:oracle,policy={policy}"
    for metric in (
        "missed_conflict_rate",
        "missed_future_rate",
        "missed_encounter_rate",
        "missed_future_at_equal_false_alarms",
        "false_alarms_per_min",
    ):
        ours = values(rows, on_tracks, metric, "kalman_cv").dropna()
        usual = values(rows, policy, metric, "kalman_cv")
        np.testing.assert_allclose(ours, usual.loc[ours.index], rtol=1e-12)
    for metric, consumer, within in (
        ("disclosed_share", "shared", 1e-12),
        ("known_share", "log", 0.02),  # The usual adversary has more estimators.
    ):
        chosen = rows[rows["knowledge"].isin(["", "oracle"])]
        ours, usual = (
            values(chosen, name, metric, consumer).item()
            for name in (on_tracks, policy)
        )
        assert ours == pytest.approx(usual, abs=within)


def test_a_policy_that_sends_everything_from_tracks_is_the_release(answered):
    rows = answered.tracks
    for consumer, metric in (
        ("kalman_cv", "missed_future_rate"),
        ("kalman_cv", "false_alarms_per_min"),
    ):
        sent, shared = (
            values(rows, f"tracks:gnn{end}", metric, consumer)
            for end in ("", ",policy=everything")
        )
        pd.testing.assert_series_equal(sent, shared)
    less = values(rows, "tracks:gnn,policy=near:3", "disclosed_share")
    assert (
        less < values(rows, "tracks:gnn,policy=everything", "disclosed_share")
    ).all()
    shown = {row[0].text for row in tracking_table(answered).rows}
    assert "tracks:gnn,policy=near:3" in shown
    assert "policy=" not in tracking_sentence(answered)


LINKED = FEW | {
    "patrol.segment_s": 100.0,
    "linkage.handover_period_s": 8.0,
    "tracking.seeds": 1,
    "tracking.clutter_per_scan": 1.0,
}
TASK = "handover-1s"


@pytest.fixture(scope="module")
def coming(tmp_path_factory):
    """A recording of 26 people who come one after another."""
    walks = [
        (
            2.0 * n,
            2.0 * n + 23.0,
            (0.9 * (n % 7), 1.1 * (n % 5)),
            (0.3 * (-1) ** n, 0.2),
        )
        for n in range(26)
    ]
    path = tmp_path_factory.mktemp("coming") / "walks.csv"
    return write_csv(path, straight_walks(*walks))


def linked(recording, tracker, **stages):
    """The shares of trials of linkers and controls of raw tracks, by consumer."""
    settings = smoke(
        recording,
        mechanisms=("raw",),
        tasks=(TASK,),
        attacks=("kinematic", "kinematic@radial_rts"),
        predictors=(),
        stages=LINKED | stages,
    )
    recorded = datasets.load(str(recording)).tracks
    setup = make_tracking_setup(recorded, stages=settings.stages, seed=0)
    crossed = expand_axes(settings)
    links = [each for each in crossed.tracks.consumers() if each.task]
    links = [link for link in links if link.track_release.name == tracker]
    raw, plugin = parse("mechanisms", "raw")[0], parse("trackers", tracker)[0]
    releases = share_tracked(raw, plugin, setup)
    shares = {}
    for consumer, tables in link_rows(links, releases, setup, mechanism=raw):
        counts = {name: tables["rows"][name].sum() for name in LINK_COLUMNS[2:]}
        n = counts.pop("trials")
        shares[consumer.spec, consumer.adversary] = {
            name: count / n for name, count in counts.items()
        } | {"trials": n}
    return shares


def test_linkers_of_tracks_beat_chance_and_never_the_linkable(coming):
    perfect, gnn = linked(coming, "oracle"), linked(coming, "gnn")
    assert {spec for spec, _ in perfect} > {
        f"{TASK}/{name}"
        for name in (
            "kinematic",
            "kinematic@radial_rts",
            "control-random",
            "control-shuffled",
        )
    }
    for shares in (*perfect.values(), *gnn.values()):
        assert shares["hits"] <= shares["linkable"] + 1e-12
        assert 0.0 < shares["chance"] < shares["linkable"]
    kinematic = f"{TASK}/kinematic", "informed"
    assert perfect[kinematic]["linkable"] > 0.9
    assert perfect[kinematic]["hits"] > 0.6
    assert gnn[kinematic]["trials"] == perfect[kinematic]["trials"]
    assert gnn[kinematic]["hits"] < perfect[kinematic]["hits"]
    assert perfect[f"{TASK}/control-random", ""]["hits"] < 0.4


def test_a_network_that_loses_everybody_has_lost_trials_and_no_error(coming):
    lost = linked(coming, "gnn", **{"tracking.detection_probability": 0.15})
    assert all(shares["trials"] > 20 for shares in lost.values())
    assert all(shares["hits"] <= shares["linkable"] < 0.5 for shares in lost.values())


def test_cells_of_tracks_call_no_loop_that_is_not_compiled_ahead(coming, monkeypatch):
    called, call = {}, compiling.Loop.__call__

    def noted(loop, *arguments):
        name = f"{loop.function.__module__}:{loop.function.__name__}"
        called.setdefault(current_cell.names, set()).add(name)
        return call(loop, *arguments)

    monkeypatch.setattr(compiling.Loop, "__call__", noted)
    settings = smoke(
        coming,
        mechanisms=("raw",),
        predictors=("kalman_cv",),
        policies=("state",),
        tasks=(TASK,),
        attacks=("kinematic",),
        stages=LINKED | {"patrol.segment_s": 40.0},
    )
    plan = make_plan(settings)
    (work,) = (
        work for work in cut_work(plan.units, plan) if isinstance(work, TrackingWork)
    )
    for _ in compute_cells(
        work, tracks=plan.scene_tracks, stages=settings.stages, seed=0
    ):
        pass
    listed = {
        (cell.mechanism.spec, cell.consumer.label): list_loops(
            [(cell.mechanism, cell.consumer)]
        )
        for cell in planned_cells(work)
    }
    named = {names: called[names] for names in listed.keys() & called.keys()}
    assert named
    for names, loops in named.items():
        assert loops <= {*listed[names]}, names


@pytest.mark.slow
def test_rows_of_linkers_of_tracks_stand_beside_those_of_the_task(coming):
    made = run(
        coming,
        coming.parent / "run",
        mechanisms=("raw",),
        predictors=(),
        tasks=(TASK,),
        attacks=("kinematic",),
        stages=LINKED,
    )
    links = made.tracks[made.tracks["consumer"].str.startswith(f"{TASK}/")]
    assert set(links["metric"]) == {"rank1", "chance", "linkable_share"}
    assert set(links["policy"]) == {"tracks:oracle", "tracks:gnn"}
    assert {f"{TASK}/kinematic", f"{TASK}/control-random"} < set(links["consumer"])
    assert (made.without_policy["consumer"] == f"{TASK}/kinematic").any()


def test_noise_acts_after_tracking_or_before_it_on_detections(made, recording):
    out = recording.parent / "before"
    before = {"tracking.noise": "before"}
    noisy = run(recording, out, stages=FEW | before)
    detections = run(
        recording, out, stages=FEW | before | {"tracking.release": "detections"}
    )
    after = values(made.tracks, "tracks:gnn", "purity")
    assert after.loc[:, "raw"].item() == after.loc[:, "fixed"].item()
    oracle, gnn = (
        values(made.tracks, f"tracks:{name}", "hota").loc[:, "raw"].item()
        for name in ("oracle", "gnn")
    )
    assert 0.0 < gnn < oracle < 1.0
    purity = values(noisy.tracks, "tracks:gnn,noise=before", "purity")
    assert purity.loc[:, "fixed"].item() < purity.loc[:, "raw"].item()
    assert purity.loc[:, "raw"].item() == after.loc[:, "raw"].item()
    # Both releases stay in the folder: the recipient tracks as the network does.
    shared = detections.tracks
    assert set(shared["policy"]) == {
        f"{form}:{tracker}{end}"
        for tracker in ("oracle", "gnn")
        for form, end in (("tracks", ",noise=before"), ("detections", ""))
    }
    for metric, consumer in (
        ("purity", "tracker"),
        ("missed_future_rate", "kalman_cv"),
    ):
        pd.testing.assert_series_equal(
            *(
                values(shared, release, metric, consumer)
                for release in ("detections:gnn", "tracks:gnn,noise=before")
            )
        )
    # The reference has no rival.
    pd.testing.assert_series_equal(
        values(shared, "detections:oracle", "known_share"),
        values(shared, "tracks:oracle,noise=before", "known_share"),
    )


def made_up(known, followed_s):
    """Tables of a tracker: what each of four blocks, a person each, reveals."""
    block, none = np.arange(4), np.zeros(4)
    return {
        "rows": {"block": block, "purity_sum": known, "instants": np.full(4, 9.0)}
        | {name: none for name in TRACK_COLUMNS if name.startswith(("known", "rejoin"))}
        | {"known_smooth": np.array(known, dtype=float)},
        "followed": dict.fromkeys(FOLLOWED_COLUMNS, none)
        | {"block": block, "followed_s": np.array(followed_s, dtype=float)},
    }


def test_the_strongest_tracker_is_chosen_on_one_half_and_scored_on_the_other():
    first = made_up([9, 0, 1, 1], [5, 5, 0, 0])
    second = made_up([2, 2, 3, 3], [1, 1, 9, 9])
    made = strongest([first, second], n_blocks=4)
    # The second knows more in the late half: it is scored in the early half, where it
    # knows less. The first knows more in the early half, and is scored in the late one.
    assert made["rows"]["known_smooth"].tolist() == [2, 2, 1, 1]
    assert made["followed"]["followed_s"].tolist() == [1, 1, 0, 0]
    # Other metrics stay those of the first.
    assert made["rows"]["purity_sum"] == [9, 0, 1, 1]
    alone = strongest([first], n_blocks=4)
    np.testing.assert_array_equal(alone["rows"]["known_smooth"], [9, 0, 1, 1])
    assert first["rows"]["known_smooth"].tolist() == [9, 0, 1, 1]


def test_the_table_and_the_first_screen_compare_with_perfect_association(made):
    table = tracking_table(made)
    heads = [column.name for column in table.columns]
    assert heads[:4] == ["release", "mechanism", "known", "purity"]
    rows = {(row[0].text, row[1].text): row for row in table.rows}
    assert len(rows) == 4
    known = values(made.tracks, "tracks:gnn", "known_share").loc[:, "raw"].item()
    assert rows["tracks:gnn", "raw positions"][2].value == pytest.approx(100 * known)
    assert any("conditional on this recording" in note for note in table.notes)
    sentence = tracking_sentence(made)
    assert sentence.startswith(f"Raw tracks of gnn reveal {100 * known:.0f} % of")
    lines = first_screen(made)
    assert any(line.startswith("Tracking: Raw tracks of gnn") for line in lines)
    assert not any(line.startswith("On patrol:") for line in lines)
    assert len(lines) <= 24


def test_other_detections_replace_rows_of_a_folder_and_a_tracker_is_added(recording):
    out = recording.parent / "again"
    single = FEW | {"tracking.seeds": 1}
    first = run(recording, out, mechanisms=("raw",), stages=single)
    more = run(
        recording, out, mechanisms=("raw",), stages=single | {"tracking.method": "jpda"}
    )
    assert set(more.tracks["policy"]) == {
        "tracks:oracle",
        "tracks:gnn",
        "tracks:jpda",
    }
    kept = indexed(more.tracks).loc[indexed(first.tracks).index]
    pd.testing.assert_frame_equal(kept, indexed(first.tracks), check_exact=True)
    linked = single | {"tracking.detection_probability": "link"}
    again = run(recording, out, mechanisms=("raw",), stages=linked)
    assert set(again.tracks["policy"]) == {"tracks:oracle", "tracks:gnn"}
    purity = [values(each.tracks, "tracks:gnn", "purity") for each in (first, again)]
    assert purity[0].item() != purity[1].item()


@pytest.mark.usefixtures("single_process")
def test_a_tracker_that_fails_is_named_and_fails_alone(recording):
    out, spec = recording.parent / "failing", "helpers.bad_plugins:Shifted"
    longer = {"tracking.seeds": 1, "patrol.segment_s": 30.0}
    changed = FEW | {"tracking.method": spec} | longer
    with pytest.warns(FailedCellsWarning, match="do not fit"):
        results = run(recording, out, mechanisms=("raw",), stages=changed)
    assert set(results.tracks["policy"]) == {"tracks:oracle"}
    failed = pd.read_csv(out / "failed.csv", keep_default_na=False)
    assert set(failed["policy"]) == {f"tracks:{spec}"}
    assert failed["why"].str.contains(f"tracker '{spec}'", regex=False).all()


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        (
            "tracking.method=gmm",
            "unknown tracker 'gmm'; known: genie, gnn, jpda, oracle",
        ),
        ("tracking.method=gnn:confirm_hits=9", "confirmed at 1 to 5 detections"),
        ("tracking.detection_probability=most", "must be a number, or be link"),
        ("tracking.detection_probability=2", "must lie within 0 to 1, or be link"),
        ("tracking.noise=never", "tracking.noise must be one of after, before"),
        ("tracking.release=detections", "add --set tracking.noise=before"),
        ("tracking.seeds=0", "tracking.seeds must lie within 1 to 100"),
    ],
)
def test_a_wrong_value_is_one_line(ran, recording, setting, says):
    words = ["--preset", "smoke", "--dataset", recording, "--out", "never"]
    assert_refused(ran(matrix, *words, "--set", setting), says)


@pytest.fixture(scope="module")
def counted(recording):
    """A function from settings to the rows of raw tracks of gnn."""
    recorded = datasets.load(str(recording)).tracks

    def count(changes):
        brief = FEW | {"patrol.segment_s": 6.0, "tracking.seeds": 1}
        stages = StageSettings().changed(brief | changes)
        setup = make_tracking_setup(recorded, stages=stages, seed=0)
        raw, gnn = parse("mechanisms", "raw")[0], parse("trackers", "gnn")[0]
        return track_rows(share_tracked(raw, gnn, setup), setup)

    return count


@pytest.mark.parametrize(
    ("changes", "least"),
    [
        ({"tracking.detection_probability": 0.6}, {}),
        ({"tracking.clutter_per_scan": 9.0}, {}),
        ({"tracking.seeds": 2}, {}),
        ({"tracking.block_s": 0.9}, {}),
        (
            {"tracking.p_false_alarm": 1e-9},
            {"tracking.detection_probability": "link"},
        ),
    ],
)
def test_every_setting_changes_the_rows(counted, changes, least):
    usual, other = counted(least), counted(least | changes)
    assert any(
        not np.array_equal(values, other[name]) for name, values in usual.items()
    )


def test_a_mechanism_that_leaves_samples_out_has_no_tracks():
    settings = smoke("plaza", mechanisms=("raw", "window:2"), stages=FEW)
    assert [plugin.spec for plugin in expand_axes(settings).tracks.mechanisms] == [
        "raw"
    ]
    with pytest.raises(SettingsError, match="unknown tracker"):
        expand_axes(smoke("plaza", stages=FEW | {"tracking.method": "nobody"}))
