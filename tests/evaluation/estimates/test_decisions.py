"""Miss against false-alarm curves, against scikit-learn and by hand."""

import numpy as np
import pytest
from helpers.small_runs import smoke
from sklearn.metrics import roc_auc_score, roc_curve

import evaluation
from evaluation.estimates.decisions import (
    DECISION_COLUMNS,
    N_BINS,
    _beside_reference,
    _interval_columns,
    _missed_at,
    decision_curve,
    decisions,
)
from evaluation.estimates.summary import SceneNumbers
from isac_track.intervals import Estimate, cluster_weights
from isac_track.rng import stream


def cases(n_scenes, *, decimals=2):
    rng = stream(0, "test", "curve", n_scenes)
    conflict = rng.random(n_scenes) < 0.5
    score = np.round(rng.normal(conflict * 1.0), decimals)
    return score, conflict, rng.integers(0, 20, n_scenes)


WEIGHTS = cluster_weights(n_clusters=20, n_replicates=30, seed=0)


def test_few_scores_are_sklearns_curve_and_area():
    score, conflict, cluster = cases(90)
    result = decision_curve(
        score=score, conflict=conflict, cluster=cluster, weights=WEIGHTS
    )
    alarm, hit, _ = roc_curve(conflict, score, drop_intermediate=False)
    assert np.allclose(result.false_alarm[0], alarm)
    assert np.allclose(result.missed[0], 1 - hit)
    # The ends are never and always.
    for rates, ends in ((result.missed, [1, 0]), (result.false_alarm, [0, 1])):
        assert np.allclose(rates[:, [0, -1]], ends)
    assert (np.diff(result.missed, axis=1) <= 1e-12).all()
    areas = result.areas()
    assert areas[0] == pytest.approx(1 - roc_auc_score(conflict, score))
    for row in range(5):  # a replicate is the weighted curve
        weight = WEIGHTS[row][cluster]
        expected = 1 - roc_auc_score(conflict, score, sample_weight=weight)
        assert areas[1 + row] == pytest.approx(expected)


def test_many_scores_are_binned_without_moving_the_area():
    score, conflict, cluster = cases(6000, decimals=9)
    result = decision_curve(
        score=score, conflict=conflict, cluster=cluster, weights=WEIGHTS
    )
    assert result.missed.shape[1] <= N_BINS + 1
    assert result.areas()[0] == pytest.approx(
        1 - roc_auc_score(conflict, score), abs=5e-4
    )


def test_missed_at_by_hand():
    # Scores 4 3 2 1 with labels conflict, none, conflict, none.
    result = decision_curve(
        score=np.array([4.0, 3.0, 2.0, 1.0]),
        conflict=np.array([True, False, True, False]),
        cluster=np.zeros(4, dtype=int),
        weights=np.ones((1, 1)),
    )
    assert result.false_alarm[0].tolist() == [0, 0, 0.5, 0.5, 1]
    assert result.missed[0].tolist() == [1, 0.5, 0.5, 0, 0]
    for at, expected in ((0.0, 0.5), (0.25, 0.5), (0.5, 0.0), (0.75, 0.0), (1.0, 0.0)):
        assert result.missed_at(np.full(2, at)).tolist() == [expected, expected]


@pytest.mark.parametrize(("n_clusters", "has_ends"), [(6, False), (20, True)])
def test_few_clusters_of_people_have_no_interval(n_clusters, has_ends):
    score, conflict, _ = cases(400)
    cluster = np.arange(400) % n_clusters
    weights = cluster_weights(n_clusters=n_clusters, n_replicates=30, seed=0)
    result = decision_curve(
        score=score, conflict=conflict, cluster=cluster, weights=weights
    )
    alarms = np.full(31, 0.2)
    row = _beside_reference(result, result, alarms, np.zeros(31))
    for name in ("missed", "ci", "future"):
        assert np.isfinite(row[f"{name}_low"]) == has_ends
    area = _interval_columns("area", "area", result.areas(), effective=result.effective)
    assert (0 <= area["area_low"] <= area["area"] <= area["area_high"] <= 1) == has_ends
    raw_alarm = Estimate(0.2, n=50, replicates=alarms[1:])
    assert np.isfinite(_missed_at(result, raw_alarm).ci_low) == has_ends


def test_one_label_alone_has_no_curve_and_nan_is_refused():
    score, conflict, cluster = cases(10)
    same = {"score": score, "cluster": cluster, "weights": WEIGHTS}
    assert decision_curve(conflict=np.ones(10, dtype=bool), **same) is None
    with pytest.raises(ValueError, match="NaN"):
        decision_curve(**(same | {"score": np.full(10, np.nan)}), conflict=conflict)


def test_a_run_leaves_curves_and_compares_with_the_first_predictor(
    csv_recording, tmp_path
):
    two = ("least_squares", "least_squares:4")
    settings = smoke(
        csv_recording,
        tmp_path / "run",
        scenes=40,
        predictors=two,
        stages={"conflict.horizons_s": 3},
    )
    results = evaluation.run(settings, pictures=False)
    own = results.decisions[results.decisions["dataset"] == results.dataset]
    rows = own.set_index(["mechanism", "consumer"])
    assert set(results.decisions["reference"]) == {"least_squares"}
    assert (rows.xs("least_squares", level="consumer")["difference"] == 0).all()
    short = rows.loc["fixed", "least_squares:window=4"]
    assert (
        short["area"] > rows.loc["fixed", "least_squares"]["area"]
    )  # less data, worse
    # 12 people: too few for an interval.
    ends = [name for name in DECISION_COLUMNS if name.endswith(("_low", "_high"))]
    assert rows[ends].isna().all(axis=None)
    assert (
        short["false_alarm_rate"]
        == rows.loc["fixed", "least_squares"]["false_alarm_rate"]
    )
    assert len(results.curves) == 2 * 4 * 51  # at two horizons
    later = results.decisions[results.decisions["dataset"] != results.dataset]
    assert set(later["dataset"]) == {f"{results.dataset}:horizon=3s"}
    assert len(later) == len(own) == 4
    assert decisions(
        SceneNumbers({}, (), {}), results.manifest, dataset="walks"
    ).decided.empty
