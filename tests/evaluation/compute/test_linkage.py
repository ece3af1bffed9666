"""Linkage: what an adversary is given, which scores follow, and what stays fixed."""

import json
import shutil
from collections import defaultdict
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from helpers.addresses import entry_at
from helpers.bad_plugins import spoilt
from helpers.cells import (
    STAGES,
    Spy,
    linked,
    make_task_windows,
    parsed,
    plugin,
    result_numbers,
)
from helpers.small_runs import smoke
from helpers.walkers import runs, walkers, write_walkers
from scipy.stats import binomtest

import evaluation
from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from attacks.tasks.window_circumstances import CIRCUMSTANCE_COLUMNS
from evaluation import matrix
from evaluation.compute.link_setup import sense_task
from evaluation.compute.link_tables import DERIVED, linkage_tables
from evaluation.estimates import linkability, recordings
from evaluation.plan.axes import expand_axes
from evaluation.plan.consumer import Consumer
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from evaluation.store import cell_files, linkage_outcomes
from isac_track.errors import DataError, PluginError, SettingsError
from isac_track.intervals import Estimate, cluster_weights
from isac_track.linkability import rank1
from isac_track.protocols import ADVERSARIES, USUAL, LinkageTrainingSet
from isac_track.types import Knowledge

SHAPE = parsed("attacks", "shape")
SPY = ("rerelease/spy", "blind")
LEVELS = ("fixed", "raw", "clean")


def by_length(probe, gallery):
    """Scores by how far each walk leads."""
    ways = (
        [np.hypot(*(item.xy[-1] - item.xy[0])) for item in side]
        for side in (probe, gallery)
    )
    return -np.abs(np.subtract.outer(*ways))


@dataclass(frozen=True)
class Linker:
    """Links as it is told, and keeps what it was shown."""

    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    score: object = by_length
    seen: list = field(default_factory=list, compare=False)
    kind: ClassVar[str] = "linkage"

    def fit(self, context):
        def score(probe, gallery):
            self.seen.append((context, probe, gallery))
            return self.score(probe, gallery)

        return score


def behind(linker, reconstruction):
    return Consumer(
        "linkage", plugin(linker), reconstruction=plugin(reconstruction, "rounds")
    )


def task_links(task, *links, by="raw", **options):
    """What is linked in a task, by consumer and adversary."""
    return linked(make_task_windows(task), by, *links, **options)[0]


def equal(first, second):
    return all(
        np.array_equal(a.scores, b.scores)
        for a, b in zip(first.searches, second.searches, strict=True)
    )


def samples(windows, rows):
    return np.concatenate([np.arange(*windows.offsets[row : row + 2]) for row in rows])


@pytest.fixture(scope="module", params=["rerelease", "handover-2s"])
def watched(request):
    """The releases that a linker sees in a task of raw walks, with all knowledge.

    Sessions, level, adversaries, and context, probe and gallery of each search.
    """
    spy, task_windows = (
        Linker(uses=frozenset(Knowledge)),
        make_task_windows(request.param),
    )
    results, level = linked(task_windows, "clean", spy)
    return task_windows, level, {knowledge for _, knowledge in results}, spy.seen


class TestWhatAnAdversarySees:
    def test_every_walk_has_a_frame_and_a_clock_of_its_own_unless_the_scene_shows(
        self, watched
    ):
        task_windows, level, _, ((_, probe, _), *_) = watched
        rows = next(iter(level.setup.folds[0].searches.values())).probe
        if task_windows.task.shows_scene:  # the true frame and clock, to everyone
            own = samples(task_windows.probe, rows)
            assert np.allclose(probe.xy, task_windows.probe.xy[own], atol=1e-9)
            assert np.array_equal(probe.t, task_windows.probe.t[own])
            return
        angles, starts = [], []
        for track, row in zip(probe, rows, strict=True):
            own = samples(task_windows.probe, [row])
            truth, t = task_windows.probe.xy[own], task_windows.probe.t[own]
            # The same walk, by its distances, but neither where nor when it was.
            near = np.linalg.norm(track.xy - track.xy[0], axis=1)
            assert np.allclose(
                near, np.linalg.norm(truth - truth[0], axis=1), atol=1e-6
            )
            assert np.allclose(np.diff(track.t), np.diff(t), atol=1e-6)
            way, shown = truth[-1] - truth[0], track.xy[-1] - track.xy[0]
            angles.append(np.angle(complex(*shown) / complex(*way)))
            starts.append(track.t[0] - t[0])
        for values in (angles, starts):
            assert np.unique(np.round(values, 3)).size == len(values)

    def test_sigma_shows_where_it_is_granted_frame_and_repeats_where_the_task_does(
        self, watched
    ):
        task_windows, _, adversaries, seen = watched
        for context, *sides in seen:
            assert (Knowledge.SCENE in context.granted) == task_windows.task.shows_scene
            assert Knowledge.REPEATS not in context.granted
            for side in sides:
                assert (side.sigma is not None) == (Knowledge.SIGMA in context.granted)
            # Pseudonyms are fresh on either side.
            assert set.isdisjoint(*(set(side.pseudonym) for side in sides))
        assert adversaries == {"blind", "informed", "oracle"}

    def test_who_trains_is_somebody_else(self, watched):
        task_windows, level, _, seen = watched
        context, probe, _ = next(
            item for item in seen if Knowledge.TRAIN in item[0].granted
        )
        train = context.train
        assert isinstance(train, LinkageTrainingSet)
        assert (train.mate >= 0).all()
        shapes = [
            {tuple(np.round(np.diff(track.t), 6)[:5]) for track in release}
            for release in (train.probe, probe)
        ]
        assert shapes[0].isdisjoint(shapes[1])
        learns = level.setup.folds[0].training
        taught = task_windows.probe.person[learns.probe]
        assert set(taught) <= set(np.flatnonzero(task_windows.trained_on[0]))
        assert (
            task_windows.task.shows_scene
            or len(set(taught)) == task_windows.trained_on[0].sum()
        )
        # The mates of the training set are mates.
        assert (
            task_windows.gallery.person[learns.gallery][learns.mate] == taught
        ).all()

    def test_the_clock_hides_the_day_as_well(self):
        tracks = walkers()
        days = np.repeat(86_400.0 * np.arange(len(tracks)), np.diff(tracks.offsets))
        spy, crowd = Linker(), replace(tracks, t=tracks.t + days)
        linked(make_task_windows("rerelease", tracks=crowd), "raw", spy)
        _, probe, _ = spy.seen[0]
        assert probe.t[probe.offsets[:-1]].max() <= 86_400.0

    def test_an_attack_is_fitted_anew_for_every_mechanism_and_fold(self):
        contexts = []
        for mechanism in ("raw", "fixed:1"):
            spy = Linker(uses=frozenset({Knowledge.TRAIN, Knowledge.MECHANISM}))
            task_links("rerelease", spy, by=mechanism)
            contexts += [
                seen_context
                for seen_context, *_ in spy.seen
                if Knowledge.TRAIN in seen_context.granted
            ]
        distinct = {id(context): context for context in contexts}.values()
        assert len(distinct) == 4
        assert len({context.train.probe.xy.tobytes() for context in distinct}) == 4
        assert {type(context.mechanism).__name__ for context in distinct} == {
            "Raw",
            "Fixed",
        }

    def test_a_linker_behind_a_reconstruction_sees_what_that_makes(self):
        spy, rounds = Linker(uses=frozenset({Knowledge.TRAIN})), Spy(move=np.rint)
        result = task_links("rerelease", behind(spy, rounds))
        assert {spec for spec, _ in result} == {"rerelease/spy@rounds"}
        for context, *sides in spy.seen:
            shown = [*sides]
            if Knowledge.TRAIN in context.granted:
                shown += [context.train.probe, context.train.gallery]
            assert all((item.xy == np.rint(item.xy)).all() for item in shown)
        assert not any(
            (linker_probe.xy == np.rint(linker_probe.xy)).all()
            for _, linker_probe, _ in rounds.seen
        )

    def test_a_reconstruction_in_front_learns_where_its_people_truly_were(self):
        rounds, task_windows = (
            Spy(uses=frozenset({Knowledge.TRAIN})),
            make_task_windows("rerelease"),
        )
        linked(task_windows, "clean", behind(Linker(), rounds))
        informed = [
            context.train
            for context, *_ in rounds.seen
            if Knowledge.TRAIN in context.granted
        ]
        assert len(informed[0].release) == task_windows.trained_on[0].sum()
        for train in informed:
            assert np.allclose(train.truth, train.release.xy, atol=1e-6)

    def test_a_stranger_that_writes_to_its_input_harms_nobody(self):
        def vandal(probe, gallery):
            spoilt(probe.xy)
            spoilt(gallery.xy)
            return np.zeros((len(probe), len(gallery)))

        alone = task_links("rerelease", Linker())
        after = task_links(
            "rerelease", plugin(Linker(score=vandal), "vandal"), Linker()
        )
        assert equal(alone[SPY], after[SPY])


class TestWhatIsReadOff:
    def test_rank_1_is_that_of_the_raw_scores(self):
        result = task_links("rerelease", Linker(), by="fixed:0.3")[SPY]
        hits = np.concatenate(
            [
                rank1(scores=search.scores, mate=search.mate)
                for search in result.searches
            ]
        )
        assert result.scorecard.estimates["rank1"].value == pytest.approx(
            hits.mean(), abs=1e-12
        )
        assert result.scorecard.n_mated == hits.size

    def test_without_groups_neither_probes_nor_candidates_are_of_one(self):
        results, level = linked(make_task_windows("rerelease"), "clean", Linker())
        result, task_windows, alone = (
            results[SPY],
            level.setup.task_windows,
            level.setup.task_windows.alone,
        )
        hits = []
        for search, (_, pairing) in zip(
            result.searches, sorted(level.setup.searches.items()), strict=True
        ):
            candidates = np.flatnonzero(
                alone[task_windows.gallery.person[pairing.gallery]]
            )
            for row in np.flatnonzero(alone[task_windows.probe.person[pairing.probe]]):
                best = candidates[search.scores[row, candidates].argmax()]
                hits.append(best == search.mate[row])
        part = result.cohorts["without_groups"]
        assert part["n_mated"] == len(hits) == alone.sum()
        assert part["rank1"] == pytest.approx(np.mean(hits), abs=1e-12)
        assert part["chance"] > result.scorecard.estimates["chance"].value

    def test_who_is_in_the_scenes_too_is_drawn_alike(self):
        task_windows = make_task_windows("rerelease")
        ours = sorted(set(task_windows.group))
        groups = ours[5:]
        known = sense_task(task_windows, groups=groups, stages=STAGES, seed=0)
        drawn = cluster_weights(n_clusters=len(groups), n_replicates=1000, seed=0)
        assert np.array_equal(known.weights[:, 5:], drawn)
        assert (known.weights[:, :5].sum(axis=1) == 5).all()

    def test_who_has_no_mate_is_left_alone_in_a_handover(self):
        task_windows = make_task_windows("handover-2s", tracks=walkers(80))
        results, *_ = linked(task_windows, "clean", parsed("attacks", "kinematic"))
        estimates = results["handover-2s/kinematic", "informed"].scorecard.estimates
        assert (task_windows.mate < 0).any()
        assert estimates["rank1"].value > 0.9
        assert estimates["rank1_assigned"].value > 0.8
        assert estimates["false_link_rate"].value < 0.6


class TestControls:
    @pytest.mark.parametrize(
        ("task", "without"),
        [
            ("rerelease", {*CIRCUMSTANCE_COLUMNS}),
            ("handover-1s", {*CIRCUMSTANCE_COLUMNS, "frame", "clock"}),
        ],
    )
    def test_every_task_has_its_controls(self, task, without):
        result = task_links(task, Linker(), controls=True)
        names = {
            spec.partition("control-")[2] for spec, _ in result if "control" in spec
        }
        assert names == CONTROLS.keys() - without

    @pytest.mark.parametrize(
        "most_pairs", [2**19, 1]
    )  # beyond, scores are in single precision
    def test_shuffled_mates_are_those_of_a_real_attack(self, monkeypatch, most_pairs):
        monkeypatch.setattr("attacks.linkage.learning.MOST_PAIRS", most_pairs)
        result = task_links("rerelease", SHAPE, by="clean", controls=True)
        real = result["rerelease/shape", "blind"]
        shuffled = result["rerelease/control-shuffled", ""]
        for search, other in zip(real.searches, shuffled.searches, strict=True):
            assert np.allclose(np.sort(search.scores), np.sort(other.scores), rtol=1e-5)
            assert (search.mate == other.mate).all()
        # That it is rejected as often as it should be takes many seeds: see below.
        assert real.scorecard.p_value <= 0.001 < shuffled.scorecard.p_value

    def test_what_sees_times_alone_is_alike_at_every_level(self):
        raw, fixed = (
            task_links("rerelease", Linker(), by=spec, controls=True)
            for spec in ("raw", "fixed:1")
        )
        for name, control in (
            (item, CONTROLS[item])
            for item in CONTROLS
            if item not in CIRCUMSTANCE_COLUMNS
        ):
            key = f"rerelease/control-{name}", ""
            assert equal(raw[key], fixed[key]) == control.sees_times_only

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["random", "shuffled"])
    def test_a_control_is_rejected_as_often_as_the_test_says(self, name):
        rejected = []
        for seed in range(300):
            task_windows = make_task_windows("rerelease", seed=seed)
            results, *_ = linked(
                task_windows, "raw", Linker(), controls=True, seed=seed
            )
            rejected.append(
                results[f"rerelease/control-{name}", ""].scorecard.p_value <= 0.05
            )
        assert (
            0.02 <= np.mean(rejected) <= 0.085
        )  # 300 draws at 5 %: three standard errors


class TestDeterminism:
    def test_who_else_is_there_changes_nothing(self):
        alone = task_links("rerelease", Linker(), by="fid:1")[SPY]
        others = (SHAPE, behind(Linker(), Spy(move=np.rint)))
        among = task_links("rerelease", *others, Linker(), by="fid:1", controls=True)[
            SPY
        ]
        np.testing.assert_array_equal(result_numbers(alone), result_numbers(among))

    def test_errors_are_common_to_all_mechanisms(self):
        shown = {}
        for spec in ("clean", "raw", "fixed:0.2", "fixed:0.4"):
            spy = Linker()
            task_links("rerelease", spy, by=spec)
            shown[spec] = spy.seen[0][1].xy
        few, many = (shown[spec] - shown["raw"] for spec in ("fixed:0.2", "fixed:0.4"))
        assert np.allclose(2 * few, many, atol=1e-6)
        assert not np.allclose(shown["raw"], shown["clean"], atol=1e-3)


class TestBreaches:
    @pytest.mark.parametrize(
        ("score", "message"),
        [
            (
                lambda p, g: np.ma.zeros((len(p), len(g))),
                "for every pair, got a masked array",
            ),
            (
                lambda p, g: np.zeros((len(g), len(p) + 1)),
                r"must return scores \(\d+, \d+\)",
            ),
            (
                lambda p, g: np.full((len(p), len(g)), np.nan),
                "score that is not finite",
            ),
            (lambda p, g: np.full((len(p), len(g)), 1e300), "score that is not finite"),
            (lambda p, g: np.zeros((len(p), len(g)), dtype=bool), "of bool"),
            (lambda *_: None, r"got \(\) of object"),
            (lambda *_: 1 / 0, "failed: ZeroDivisionError"),
            (lambda release: release, "failed: TypeError"),
        ],
    )
    def test_a_plugin_that_breaks_its_contract_is_named(self, score, message):
        with pytest.raises(
            PluginError, match=rf"attack rerelease/spy \(blind\) .*{message}"
        ):
            task_links("rerelease", Linker(score=score))

    def test_a_reconstruction_in_front_is_named_as_well(self):
        cuts = Spy(move=lambda xy: xy[:-1])
        with pytest.raises(
            PluginError, match=r"attack rounds \(behind rerelease/spy@rounds"
        ):
            task_links("rerelease", behind(Linker(), cuts))

    def test_who_requires_sigma_is_the_oracle(self):
        (key,) = task_links("split", Linker(requires=frozenset({Knowledge.SIGMA})))
        assert key == ("split/spy", "oracle")


def written(out, task, *, control="", keep_scores=False):
    """Result and setup of a linker or control, its tables, and its manifest entry."""
    results, level = linked(
        make_task_windows(task), "raw", Linker(), controls=bool(control)
    )
    consumer = Consumer("linkage", plugin(Linker()), "blind", task=task)
    if control:
        consumer = Consumer("control", task=task, control=control)
    result = results[consumer.spec, consumer.adversary]
    tables = linkage_tables(result, level.setup, keep_scores=keep_scores)
    (out / "cells").mkdir()
    cell = cell_files.ComputedCell(consumer.label, "key", {}, tables)
    content = cell_files.pack_units([cell_files.ComputedUnit("raw", "", {}, [cell])])
    (out / "cells" / "one.parquet").write_bytes(content)
    where = entry_at(
        consumer.spec, consumer.adversary, kind=consumer.kind, files=("one.parquet",)
    )
    return result, level.setup, tables, where


class TestCells:
    """What is written of a cell is what is read of it."""

    @pytest.mark.parametrize("task", ["rerelease", "handover-2s"])
    @pytest.mark.parametrize("control", ["", "random"])
    def test_what_is_read_is_what_was_computed(self, tmp_path, task, control):
        result, _, _, where = written(tmp_path, task, control=control)
        (read,) = linkage_outcomes.read_outcomes(tmp_path, [where])
        assert list(read.estimates) == list(result.scorecard.estimates)
        with_draws = 0
        for name, estimate in result.scorecard.estimates.items():
            results = read.estimates[name]
            for field_name in ("value", "ci_low", "ci_high", "n"):
                np.testing.assert_equal(
                    getattr(results, field_name), getattr(estimate, field_name)
                )
            if not results.replicates.size:
                rank_metrics = name in result.scorecard.probes.values()
                assert name in DERIVED or (control and not rank_metrics)
                continue
            with_draws += 1
            expected = estimate.replicates.astype(np.float32)
            np.testing.assert_array_equal(results.replicates, expected)
        assert with_draws == (4 if control else 12) + (task != "rerelease")
        assert read.numbers["p_value"] == result.scorecard.p_value
        assert read.cohorts == result.cohorts

    def test_every_probe_says_how_it_fared(self, tmp_path):
        result, known, tables, where = written(tmp_path, "handover-2s")
        assert "scores" not in tables["rows"].column_names
        columns = ["search", "above", "tied", "chance"]
        table = cell_files.read_rows(tmp_path, where, columns=columns).to_pandas()
        expected = [
            (number, scores, mate)
            for number, search in enumerate(result.searches)
            for scores, mate in zip(search.scores, search.mate, strict=True)
        ]
        for row, (number, scores, mate) in zip(
            table.itertuples(), expected, strict=True
        ):
            assert row.search == known.task_windows.search_names[number]
            assert row.chance == 1 / scores.size
            mate_scores = np.nan if mate < 0 else scores[mate]
            assert row.above == ((scores > mate_scores).sum() if mate >= 0 else -1)
            assert row.tied == (scores == mate_scores).sum()

    def test_raw_scores_stay_where_they_are_asked_for(self, tmp_path):
        result, _, tables, where = written(tmp_path, "handover-2s", keep_scores=True)
        rows = cell_files.read_rows(
            tmp_path, where, columns=["source", "mate", "scores"]
        )
        gallery = json.loads(tables["about"]["about"][0].as_py())["gallery"]
        table, first = rows.to_pandas(), 0
        for number, search in enumerate(result.searches):
            own = table.iloc[first : first + len(search.mate)]
            first += len(search.mate)
            assert np.array_equal(np.stack(own["scores"].to_list()), search.scores)
            for source, mate in zip(own["source"], own["mate"], strict=True):
                assert mate < 0 or gallery[number][mate] == source
        assert first == len(table)

    @pytest.mark.parametrize("drawn", [None, (), ("rank1",)])
    def test_a_cell_without_ranks_of_its_probes_is_refused(self, tmp_path, drawn):
        *_, where = written(tmp_path, "split")
        path = tmp_path / "cells" / "one.parquet"
        table, metadata = pq.read_table(path), pq.read_metadata(path).metadata
        columns = [name for name in table.column_names if name != "above"]
        with pq.ParquetWriter(path, table.select(columns).schema) as writer:
            writer.write_table(table.select(columns))
            index = {b"isac_track.cells": metadata[b"isac_track.cells"]}
            writer.add_key_value_metadata(index)
        with pytest.raises(DataError, match=r"one\.parquet has no column above: "):
            linkage_outcomes.read_outcomes(tmp_path, [where], drawn=drawn)

    @pytest.mark.parametrize("content", [b"", b"PAR1 nonsense", None])
    def test_a_missing_or_broken_file_is_named(self, tmp_path, content):
        (tmp_path / "cells").mkdir()
        if content is not None:
            (tmp_path / "cells" / "cell.parquet").write_bytes(content)
        entry = entry_at("split/x", "blind", kind="linkage", files=("cell.parquet",))
        read_rows = partial(cell_files.read_rows, columns=["source"])
        for read in (
            lambda out, manifest_entry: linkage_outcomes.read_outcomes(
                out, [manifest_entry]
            ),
            read_rows,
        ):
            with pytest.raises(
                DataError, match=r"cell\.parquet .*run the matrix again"
            ):
                read(tmp_path, entry)


KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


def settings_in(folder):
    write_walkers(folder / "walkers.csv")
    attacks = ("shape", "histogram@kalman_rts", "kinematic", "identity", "kalman_rts")
    axes = {
        "mechanisms": ("raw", "fixed:1", "thin:3"),
        "predictors": (),
        "attacks": attacks,
    }
    axes["tasks"] = ("rerelease", "handover-2s")
    return smoke(folder / "walkers.csv", folder / "run", scenes=8, **axes)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run that nobody changes."""
    return evaluation.run(
        settings_in(tmp_path_factory.mktemp("linked")), pictures=False
    )


class TestRuns:
    def test_a_run_has_every_cell_of_every_task_once(self, finished):
        summary = finished.summary
        assert not summary.duplicated(KEY).any()
        ranks = summary[summary["metric"] == "rank1"]
        assert set(ranks["mechanism"]) == {"raw", "fixed", "thin", "clean"}
        # Who needs no frame is not run where it shows, nor the other way round.
        consumers = ranks.loc[~ranks["consumer"].str.contains("control"), "consumer"]
        everybody = {
            "rerelease/shape",
            "rerelease/histogram@kalman_rts",
            "handover-2s/kinematic",
        }
        assert set(consumers) == everybody
        knowledge = set(ranks.loc[ranks["consumer"] == "rerelease/shape", "knowledge"])
        assert knowledge == {"blind", "informed"}
        shares = summary[summary["unit"] == "fraction"].dropna(subset=["value"])
        shares = shares[shares["metric"] != "residual_risk"]
        assert shares["value"].between(0, 1).all()
        # Few non-mated pairs refuse an operating point.
        refused = summary[summary["metric"] == "tpr_at_fpr_01pct"]
        assert len(refused)
        assert refused[["value", "ci_low", "ci_high"]].isna().all(axis=None)
        # The ceiling has no descriptors: nobody shares without error.
        assert set(summary.loc[summary["mechanism"] == "clean", "metric"]).isdisjoint(
            {"plr"}
        )

    def test_the_file_says_what_every_cell_means(self, finished):
        result = finished.linkability
        assert list(result.columns) == linkability.COLUMNS
        assert set(result["cohort"]) == {"all", "without_groups", "without_frozen"}
        clean = result[(result["mechanism"] == "clean") & (result["cohort"] == "all")]
        assert (
            clean.loc[clean["consumer"] == "rerelease/shape", "outcome"] == "links"
        ).all()
        assert (result["gallery_min"].dropna() >= 1).all()
        # Nothing is declared at the ceiling: noise leaks nothing.
        assert (
            clean.loc[clean["consumer"].str.startswith("handover"), "invalid"] == ""
        ).all()

    def test_the_manifest_says_who_is_linked(self, finished):
        manifest = finished.manifest
        tasks = manifest["linkage"]["tasks"]
        assert tasks["rerelease"]["people"] == 40
        assert sum(tasks["rerelease"]["candidates"].values()) == 40
        assert manifest["settings"]["tasks"] == ["rerelease", "handover-2s"]
        assert "shape" in manifest["settings"]["attacks"]

    def test_the_windows_of_every_level_have_a_cell_and_no_row_of_the_summary(
        self, finished
    ):
        entries = [
            cell for cell in finished.manifest["cells"] if cell.kind == "windows"
        ]
        mean = {}
        for entry in entries:
            assert entry.address.adversary == ""
            rows = cell_files.read_rows(finished.out, entry, columns=["n_samples"])
            mean[entry.address.consumer, entry.spec] = (
                rows["n_samples"].to_numpy().mean()
            )
        assert len(mean) == len(entries) == 2 * 4
        for task in ("rerelease", "handover-2s"):
            clean, raw, few = (
                mean[f"{task}/windows", by] for by in ("clean", "raw", "thin:3")
            )
            assert clean == raw
            assert few / raw == pytest.approx(1 / 3, rel=0.05)
        table = finished.summary.set_index(["mechanism", "consumer", "metric"])["value"]
        assert not finished.summary["consumer"].str.contains("windows").any()
        assert table.sort_index().loc[("thin", "kalman_rts", "plr")].min() > 0

    def test_an_earlier_attack_whose_ceiling_is_missing_is_left_out(
        self, finished, tmp_path
    ):
        settings = settings_in(tmp_path)
        shutil.copytree(finished.out, settings.out)
        for path in (settings.out / "cells").glob("clean*"):
            path.unlink()
        for attacks in (("histogram",), ("histogram", "shape")):
            asked = replace(
                settings, tasks=("rerelease",), attacks=attacks, mechanisms=("raw",)
            )
            consumer = set(
                evaluation.run(asked, pictures=False).linkability["consumer"]
            )
            assert "rerelease/histogram" in consumer
            assert ("rerelease/shape" in consumer) == ("shape" in attacks)

    def test_a_presets_task_without_people_is_left_out_loudly(
        self, csv_recording, tmp_path, capsys, monkeypatch
    ):
        preset = replace(PRESETS["smoke"], tasks=("rerelease", "new_traversal"))
        monkeypatch.setitem(PRESETS, "smoke", preset)
        words = [
            "--preset",
            "smoke",
            "--dataset",
            csv_recording,
            "--scenes",
            8,
            "--jobs",
            1,
        ]
        words += ["--mechanism", "raw", "--predictor", "none", "--attack", "histogram"]
        words += [
            "--verbose",
            "--set",
            "linkage.most_people=30",
            "--out",
            tmp_path / "run",
        ]
        assert matrix.main([str(word) for word in words]) == 0
        shown = capsys.readouterr().err
        assert "task rerelease: 12 of 12 tracks last 12 s, but it takes 24" in shown
        summary = pd.read_csv(tmp_path / "run" / "summary.csv")
        rows = summary[summary["metric"] == "rank1"]
        assert set(rows["consumer"].str.partition("/")[0]) == {"new_traversal"}
        assert set(rows["dataset"]) == {recordings.TWO_SESSIONS}

    def test_a_task_that_was_named_must_be(self, csv_recording, tmp_path):
        words = [
            "--dataset",
            csv_recording,
            "--task",
            "rerelease",
            "--out",
            tmp_path / "run",
        ]
        assert matrix.main([str(word) for word in words]) == 2


def paper(**options):
    """Settings of the widest preset that is run by name alone."""
    return Settings(preset="paper", **options)


class TestAxes:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"tasks": ("rerelese",)}, "did you mean 'rerelease'"),
            ({"attacks": ("shape@dtw",)}, "write a linkage attack left of @"),
            (
                {"attacks": ("kalman_rts@radial_rts",)},
                "write a linkage attack left of @",
            ),
            ({"attacks": ("shape@kalman_rtss",)}, "did you mean 'kalman_rts'"),
            ({"attacks": ("shape@",)}, "'shape@': expected LINKER@RECONSTRUCTION"),
            ({"attacks": ("@radial_rts",)}, "expected LINKER@RECONSTRUCTION"),
            (
                {"attacks": ("kinematic",), "tasks": ("split",)},
                "'kinematic' has no task",
            ),
            (
                {"attacks": ("shape@averaging",)},
                "has no task to run in.*requires REPEATS",
            ),
            (
                {"attacks": ("identity",), "tasks": ("split",)},
                "task split has no attack",
            ),
            ({"attacks": ("shape",), "tasks": ()}, "'shape' has no task"),
            (
                {"attacks": ("kalman_rts",), "adversaries": ("anchor",)},
                "anchor: .*--attack ou_rts",
            ),
        ],
    )
    def test_what_does_not_fit_is_refused_with_the_way_out(self, given, message):
        with pytest.raises(SettingsError, match=message):
            expand_axes(Settings(**given))

    @pytest.mark.parametrize("name", sorted(ADVERSARIES.keys() - USUAL))
    def test_who_is_asked_for_by_name_alone_does_something(self, name):
        rows = {
            consumer.adversary
            for consumer in expand_axes(paper(adversaries=(name,))).consumers
        }
        assert rows == {"", *USUAL, name}

    def test_who_is_in_every_run_adds_nothing_to_it_when_asked_for(self):
        assert (
            expand_axes(paper(adversaries=USUAL)).consumers
            == expand_axes(paper()).consumers
        )

    def test_who_links_where(self):
        for attack, task, spec in (
            (
                "shape",
                "handover-1s",
                "shape",
            ),  # it has no task of its own: it runs where it can
            ("histogram@savgol:0.5", "split", "histogram@savgol:width_s=0.5"),
        ):
            result = expand_axes(Settings(attacks=(attack,), tasks=(task,)))
            assert [(where.name, link.spec) for where, link in result.links] == [
                (task, spec)
            ]

    def test_preset_quick_leaves_out_the_oracle_where_a_lesser_adversary_can_attack(
        self,
    ):
        crossed = expand_axes(
            Settings(preset="quick", attacks=("radial_rts", "averaging"))
        )
        rows = {
            (consumer.spec, consumer.adversary)
            for consumer in crossed.consumers
            if consumer.kind == "attack"
        }
        assert {knowledge for spec, knowledge in rows if spec == "radial_rts"} == {
            "blind",
            "informed",
        }
        assert ("averaging", "oracle") in rows
        asked = expand_axes(Settings(preset="quick", adversaries=("oracle",))).consumers
        assert "oracle" in {item.adversary for item in asked}

    def test_paper_has_every_task_and_every_linker_and_nothing_is_linked_without_tasks(
        self,
    ):
        result = expand_axes(paper())
        assert {task.name for task in result.tasks} == TASKS.keys()
        linkers = {link.plugin.name for _, link in result.links}
        known = {"shape", "profile", "dtw", "behaviour", "histogram", "kinematic"}
        known |= {
            "likelihood_ratio",
            "likelihood_ratio:one_to_one=true",
            "mean_distance",
        }
        assert linkers == known
        assert result.ceiling.spec == "clean"
        nothing = expand_axes(Settings(tasks=()))
        assert (nothing.links, nothing.ceiling) == ((), None)


def entry(consumer, mechanism, p_value, low=1.0):
    """An entry of a manifest, and what was achieved there."""
    result = Estimate(value=0.1, ci_low=0.0, ci_high=0.2, n=5)
    numbers = defaultdict(
        int, p_value=p_value, p_value_low=low, gallery_sizes=[5, 5, 5.0]
    )
    kind, knowledge = ("control", "") if "control" in consumer else ("linkage", "blind")
    level = 1.0 if mechanism == "fixed" else None
    where = entry_at(consumer, knowledge, kind=kind, where=(mechanism, level))
    return where, linkage_outcomes.LinkageOutcome(
        {"rank1": result, "chance": result}, numbers, cohorts={}
    )


class TestOutcomes:
    def test_a_leak_makes_the_cells_of_its_task_and_level_invalid(self):
        entries = (
            ("split/control-duration", "fixed", 0.0004),
            ("split/control-clock", "fixed", 0.02),
            ("split/control-duration", "clean", 0.3),
            # Mates that score low are a leak, and random scores are none.
            ("split/control-duration", "raw", 1.0, 0.0002),
            ("rerelease/control-random", "raw", 0.001),
            ("split/x", "fixed", 0.2),
            ("split/x", "raw", 0.01),
            ("split/x", "clean", 0.001),
            *(("rerelease/x", by, 0.2) for by in LEVELS),
        )
        frame = linkability.linkability(
            [entry(*item) for item in entries], dataset="here"
        )
        result = frame.set_index(["consumer", "mechanism"])
        assert (
            result.loc[("split/control-duration", "fixed"), "outcome"] == "beats chance"
        )
        for task, by, invalid, said in (
            ("split", "fixed", "duration", "no link detected"),
            ("split", "raw", "duration", "links"),
            ("split", "clean", "", "links"),
            *(("rerelease", by, "", "attack too weak") for by in LEVELS),
        ):
            row = result.loc[(f"{task}/x", by)]
            assert (row["invalid"], row["outcome"]) == (invalid, said)

    def test_the_noise_level_makes_cells_invalid_only_where_the_channel_is_another_one(
        self,
    ):
        tasks = ("rerelease", "split", "handover-1s")
        entries = [(f"{task}/control-noise_level", "raw", 0.0004) for task in tasks]
        entries += [
            (f"{task}/x", by, 0.001) for task in tasks for by in ("raw", "clean")
        ]
        frame = linkability.linkability(
            [entry(*each) for each in entries], dataset="here"
        )
        invalid = frame.set_index(["consumer", "mechanism"])["invalid"]
        assert [invalid[f"{task}/x", "raw"] for task in tasks] == [
            "noise_level",
            "",
            "",
        ]

    def test_the_simulated_task_has_a_data_set_of_its_own(self):
        assert recordings.task_recording("new_traversal", dataset="here") != "here"
        assert recordings.task_recording("split", dataset="here") == "here"
        assert recordings.task_recording("", dataset="here") == "here"


def test_who_comes_back_is_linked_by_an_adversary_who_never_saw_them_learning():
    task_windows = make_task_windows("cross_session", tracks=runs())
    spy = Linker(requires=frozenset({Knowledge.TRAIN}))
    results, level = linked(task_windows, "clean", spy, controls=True)
    (result,) = (cell for (spec, _), cell in results.items() if "control" not in spec)
    (pairing,) = level.setup.searches.values()
    assert pairing.probe.tolist() == list(range(10))
    for person, (context, probe, gallery) in enumerate(spy.seen):
        assert (len(probe), len(gallery)) == (1, 10)
        train = context.train
        # Their own walk is neither in what is learnt from nor a candidate there.
        assert (len(train.probe), len(train.gallery)) == (9, 9)
        ways = [np.hypot(*item.xy[0]) for item in train.probe]
        assert np.hypot(*probe[0].xy[0]) not in ways
        assert np.array_equal(
            result.searches[0].scores[person], np.float32(by_length(probe, gallery)[0])
        )
    rank1 = result.scorecard.estimates["rank1"]
    hits = round(10 * rank1.value)
    exact = binomtest(hits, 10).proportion_ci(method="exact")
    np.testing.assert_allclose([rank1.ci_low, rank1.ci_high], exact, rtol=1e-9)
    # A control sees its circumstance alone: there are 20 people in either session, at
    # any time.
    crowd = results["cross_session/control-run_density", ""].searches[0]
    assert (crowd.scores == 0).all()
    times = results["cross_session/control-run_time", ""].searches[0].scores
    gap = np.subtract.outer(
        task_windows.probe.circumstances[:, 4], task_windows.gallery.circumstances[:, 4]
    )
    assert (np.argsort(-np.abs(gap), axis=1) == np.argsort(times, axis=1)).all()
