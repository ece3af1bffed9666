"""Where a linker scores some candidates alone: what it computes, refuses and loses."""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
from helpers.cells import STAGES, linked, make_task_windows, parsed, result_numbers
from helpers.small_runs import smoke
from helpers.walkers import walkers, write_walkers

import evaluation
from evaluation.compute import candidates
from evaluation.compute.candidates import among_candidates
from evaluation.reporting import notices
from evaluation.store.manifest import read_manifest
from isac_track.linkability import rank1
from isac_track.linkability.scales import METRICS
from isac_track.rng import stream

REFUSED = (*METRICS, "d_sys_corrected", "rank1_assigned", "false_link_rate")


def few(n):
    return STAGES.changed({"linkage.candidates": n})


@dataclass(frozen=True)
class Length:
    """Who went as far? It keeps how many walks it was shown at a time."""

    requires: ClassVar[frozenset] = frozenset()
    uses: ClassVar[frozenset] = frozenset()
    kind: ClassVar[str] = "linkage"
    seen: list = field(default_factory=list, compare=False)

    def fit(self, _context):
        def score(probe, gallery):
            self.seen.append((len(probe), len(gallery)))
            ways = [
                [np.hypot(*(w.xy[-1] - w.xy[0])) for w in item]
                for item in (probe, gallery)
            ]
            return -np.abs(np.subtract.outer(*ways))

        return score


class TestScores:
    @pytest.mark.parametrize("task", ["rerelease", "handover-2s"])
    def test_with_as_many_as_the_gallery_all_is_as_without(self, task):
        task_windows, linker = make_task_windows(task), parsed("attacks", "shape")
        largest = int(np.bincount(task_windows.gallery.search).max())
        exact, _ = linked(task_windows, "raw", linker, controls=True)
        for n in (0, largest, 10_000):
            results, _ = linked(
                task_windows, "raw", linker, controls=True, stages=few(n)
            )
            assert results.keys() == exact.keys()
            for key, expected in exact.items():
                np.testing.assert_array_equal(
                    result_numbers(results[key]), result_numbers(expected)
                )

    @pytest.mark.parametrize("task", ["rerelease", "handover-2s"])
    def test_the_first_few_of_the_first_stage_are_scored_and_others_follow_in_order(
        self, task
    ):
        n, task_windows, spy = 4, make_task_windows(task), Length()
        exact, level = linked(task_windows, "raw", Length())
        results, _ = linked(task_windows, "raw", spy, stages=few(n))
        ((key, cell),) = results.items()
        pairings = {
            number: pairing
            for fold in level.setup.folds
            for number, pairing in fold.searches.items()
        }
        for number, (search, whole) in enumerate(
            zip(cell.searches, exact[key].searches, strict=True)
        ):
            rows = pairings[number].probe, pairings[number].gallery
            sides = [
                side.tracks(side_rows)
                for side, side_rows in zip(level.blind.releases, rows, strict=True)
            ]
            stage = candidates.first_stage(task_windows.task)
            context = type("Context", (), {"granted": stage.requires})()
            first = stage.fit(context)(*sides)
            result = [np.argsort(-score) for score in search.scores]
            chosen = np.array([order[:n] for order in result])
            computed = np.take_along_axis(whole.scores, chosen, axis=1)
            assert np.array_equal(
                np.take_along_axis(search.scores, chosen, axis=1), computed
            )
            for row, order in enumerate(result):
                assert (search.scores[row, order[n:]] < computed.min()).all()
                ranked = first[row, order]
                # Up to rounding: another numpy sums in another order.
                assert (np.diff(ranked[n:]) <= 1e-12).all()
                assert ranked[:n].min() >= ranked[n:].max(initial=-np.inf) - 1e-12
        # A stranger is asked about one probe at a time; some are searched in full as
        # well.
        asked = [size for probes, size in spy.seen if probes == 1 and size <= n]
        assert len(asked) >= len(task_windows.probe)

    @pytest.mark.parametrize("worst", [-3e38, -1e-30, 0.0, 5.0, 3e38])
    def test_others_are_below_whatever_was_scored(self, worst):
        _, level = linked(make_task_windows("rerelease"), "raw", Length())
        release, worst = level.seen.releases[0], float(np.float32(worst))
        n, first = len(release), stream(0, "test", "first").random((len(release),) * 2)
        result = among_candidates(
            lambda p, g: np.full((len(p), len(g)), worst),
            release,
            release,
            mate=np.arange(n),
            first_scores=first,
            n_candidates=3,
            n_checked=0,
            n_at_once=64,
            rng=stream(0, "test", "below"),
        ).scores
        assert np.isfinite(result).all()
        order = np.argsort(-first, axis=1)
        ranked = np.take_along_axis(result, order, axis=1)
        assert (ranked[:, :3] == worst).all()
        assert (np.diff(ranked[:, 2:], axis=1) < 0).all()


class TestWhatIsTold:
    @pytest.mark.parametrize("n", [1, 3, 8])
    def test_the_loss_is_that_of_a_search_in_full(self, n, monkeypatch):
        monkeypatch.setattr("evaluation.compute.linkage.CHECKED", 10_000)
        task_windows = make_task_windows("rerelease")
        exact, _ = linked(task_windows, "raw", parsed("attacks", "shape"))
        results, _ = linked(
            task_windows, "raw", parsed("attacks", "shape"), stages=few(n)
        )
        for key, cell in results.items():
            hits = [
                np.concatenate(
                    [rank1(scores=s.scores, mate=s.mate) for s in item.searches]
                )
                for item in (exact[key], cell)
            ]
            loss = hits[0].mean() - hits[1].mean()
            assert cell.losses.mean() == pytest.approx(loss, abs=1e-12)
            assert cell.scorecard.estimates["rank1"].value == pytest.approx(
                hits[1].mean()
            )

    def test_what_needs_all_pairs_is_refused_and_ranks_are_not(self):
        for task in ("rerelease", "handover-2s"):
            task_windows = make_task_windows(task, tracks=walkers(80))
            results, *_ = linked(
                task_windows, "clean", Length(), controls=True, stages=few(2)
            )
            for cell in results.values():
                for name, estimate in cell.scorecard.estimates.items():
                    known = [estimate.value, estimate.ci_low, estimate.ci_high]
                    is_refused = name in (*REFUSED, "rank1_g100")  # of forty candidates
                    assert np.isnan(known).all() == is_refused, name
                    assert estimate.n > 0
                assert 0 < cell.scorecard.p_value <= 1
                assert 0 < cell.scorecard.p_value_low <= 1
                assert not cell.scorecard.is_inverted
                assert math.isnan(cell.scorecard.realised_fpr_1pct)

    def test_manifest_notice_and_table_say_it(self, tmp_path):
        write_walkers(tmp_path / "walks.csv")
        axes = {"tasks": ("rerelease",), "attacks": ("shape",), "predictors": ()}
        settings = smoke(
            tmp_path / "walks.csv", tmp_path / "run", stages=few(5), **axes
        )
        results = evaluation.run(settings)
        manifest = read_manifest(tmp_path / "run")
        assert manifest["identity"]["linkage.candidates"] == 5
        message = manifest["linkage"]["candidates"]["rerelease"]
        assert message["cells"] == 6  # clean, raw and fixed, blind and informed
        assert message["probes"] == 40
        rank = results.summary[results.summary["metric"] == "rank1"]
        result = rank[(rank["consumer"] == message["consumer"].partition(" (")[0])]
        assert result["value"].between(0, 1).all()
        assert message["loss"] <= message["most"] <= 1
        (line,) = (notice for notice in notices.notices(manifest) if "scored" in notice)
        assert "scored 5 candidates of each probe" in line
        assert "40 probes in each of 6 cells were searched in full" in line
        page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
        assert "scored 5 candidates of each probe" in page
        refused = results.summary[results.summary["metric"].isin(REFUSED)]
        assert len(refused)
        assert refused["value"].isna().all()
