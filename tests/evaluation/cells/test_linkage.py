"""What an adversary is given of a linkage task, what is read off, and what stays fixed."""

import json
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from helpers.runs import linked_level_of
from helpers.walkers import walkers, write_walkers

import evaluation
from attacks.tasks.build import build
from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation import matrix
from evaluation.analysis import linkability
from evaluation.cells.link_setup import sensed_sessions
from evaluation.cells.link_tables import DERIVED, linkage_tables
from evaluation.experiment.axes import Axes, Consumer, Link, axes
from evaluation.experiment.settings import Settings
from evaluation.runs import cell_files
from isac_track import plugins as registry
from isac_track.config import StageSettings
from isac_track.errors import DataError, PluginError, SettingsError
from isac_track.intervals import cluster_weights
from isac_track.linkability import rank1
from isac_track.plugins import Plugin
from isac_track.protocols import LinkageTrainingSet
from isac_track.types import Knowledge, Reconstruction

STAGES = StageSettings()
EPSILON_M = STAGES.privacy.epsilon_m


@dataclass(frozen=True)
class Spy:
    """Links by the mean speed, and keeps what it was shown."""

    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    seen: list = field(default_factory=list, compare=False)
    kind: ClassVar[str] = "linkage"

    def fit(self, context):
        def score(probe, gallery):
            self.seen.append((context, probe, gallery))
            first, second = ([len_of(one) for one in side] for side in (probe, gallery))
            return -np.abs(np.subtract.outer(first, second))

        return score


def len_of(track):
    """Return the way from the first second to the last, over time."""
    late, early = track.t > track.t[-1] - 2, track.t < track.t[0] + 2
    return np.hypot(*(track.xy[late].mean(axis=0) - track.xy[early].mean(axis=0)))


@dataclass(frozen=True)
class Returns:
    """Returns whatever a function makes of two releases."""

    make: object
    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    kind: ClassVar[str] = "linkage"

    def fit(self, context):
        del context
        return self.make


@dataclass(frozen=True)
class Rounds:
    """A reconstruction that one recognises: whole metres."""

    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    seen: list = field(default_factory=list, compare=False)

    def fit(self, context):
        def reconstruct(release):
            self.seen.append((context, release))
            return Reconstruction(np.rint(release.xy))

        return reconstruct


def plugin(instance, name="spy"):
    return Plugin(name=name, level=None, spec=name, origin=f"here:{name}", instance=instance)


def link(linker, behind=None):
    linker = linker if isinstance(linker, Plugin) else plugin(linker)
    return Link(linker, None if behind is None else plugin(behind, "rounds"))


def linked(*links, task="rerelease", mechanism="raw", tracks=None, controls=False, seed=0):
    """Outcome of every consumer by (consumer, adversary), and the sessions."""
    tracks = tracks or walkers()
    sessions = build(TASKS[task], tracks=tracks, later=None, settings=STAGES, seed=seed)
    known = sensed_sessions(sessions, groups=sorted(set(tracks.group)), stages=STAGES, seed=seed)
    crossed = Axes(
        mechanisms=(), predictors=(), attacks=(), links=tuple((TASKS[task], one) for one in links)
    )
    consumers = [one for one in crossed.linkers(TASKS[task]) if controls or one.kind != "control"]
    (shared_by,) = registry.parse("mechanisms", mechanism)
    found, _ = linked_level_of(shared_by, consumers, known=known, epsilon_m=EPSILON_M, seed=seed)
    return found, known


def scores(result):
    return [search.scores for search in result.searches]


def equal(one, other):
    return all(np.array_equal(a, b) for a, b in zip(scores(one), scores(other), strict=True))


class TestWhatAnAdversarySees:
    def test_every_walk_is_in_a_frame_and_on_a_clock_of_its_own(self):
        spy = Spy()
        _, known = linked(link(spy), mechanism="clean")
        half, sessions = known.halves[0], known.sessions
        part = half.searches[0][1]
        _, probe, _ = spy.seen[0]
        angles, starts = [], []
        for track, row in zip(probe, part.probe, strict=True):
            lo, hi = sessions.probe.offsets[row], sessions.probe.offsets[row + 1]
            truth, t = sessions.probe.xy[lo:hi], sessions.probe.t[lo:hi]
            # The same walk, by its distances, but neither where nor when it was.
            assert np.allclose(
                np.linalg.norm(track.xy - track.xy[0], axis=1),
                np.linalg.norm(truth - truth[0], axis=1),
                atol=1e-6,
            )
            assert np.allclose(np.diff(track.t), np.diff(t), atol=1e-6)
            way, shown = truth[-1] - truth[0], track.xy[-1] - track.xy[0]
            angles.append(np.angle(complex(*shown) / complex(*way)))
            starts.append(track.t[0] - t[0])
        for values in (angles, starts):
            assert np.unique(np.round(values, 3)).size == len(values)

    def test_a_handover_shows_the_true_frame_and_clock_to_everyone(self):
        spy = Spy()
        _, known = linked(link(spy), task="handover-2s", mechanism="clean")
        part = known.halves[0].searches[0][1]
        sessions = known.sessions
        samples = np.concatenate(
            [
                np.arange(sessions.probe.offsets[row], sessions.probe.offsets[row + 1])
                for row in part.probe
            ]
        )
        _, probe, _ = spy.seen[0]
        assert np.allclose(probe.xy, sessions.probe.xy[samples], atol=1e-9)
        assert np.array_equal(probe.t, sessions.probe.t[samples])

    def test_sigma_shows_only_where_it_was_granted(self):
        blind, oracle = Spy(), Spy(uses=frozenset({Knowledge.SIGMA}))
        linked(link(plugin(blind, "blind")), link(plugin(oracle, "oracle")))
        assert all(one.sigma is None for _, *sides in blind.seen for one in sides)
        by_grant = {
            Knowledge.SIGMA in context.granted: probe.sigma for context, probe, _ in oracle.seen
        }
        assert by_grant[False] is None
        assert by_grant[True] is not None

    @pytest.mark.parametrize("task", ["rerelease", "handover-2s"])
    def test_frame_and_repeats_are_the_tasks_to_grant(self, task):
        spy = Spy(uses=frozenset(Knowledge))
        found, _ = linked(link(spy), task=task)
        granted = {context.granted for context, *_ in spy.seen}
        assert all((Knowledge.SCENE in one) == TASKS[task].shows_scene for one in granted)
        assert not any(Knowledge.REPEATS in one for one in granted)
        assert {knowledge for _, knowledge in found} == {"blind", "informed", "oracle"}

    def test_pseudonyms_are_fresh_on_either_side(self):
        spy = Spy()
        linked(link(spy))
        _, probe, gallery = spy.seen[0]
        assert not set(probe.pseudonym) & set(gallery.pseudonym)

    def test_the_clock_hides_the_day_as_well(self):
        tracks = walkers()
        days = np.repeat(86_400.0 * np.arange(len(tracks)), np.diff(tracks.offsets))
        spy = Spy()
        linked(link(spy), tracks=replace(tracks, t=tracks.t + days))
        _, probe, _ = spy.seen[0]
        starts = probe.t[probe.offsets[:-1]]
        assert starts.max() <= 86_400.0

    def test_who_trains_is_somebody_else(self):
        spy = Spy(uses=frozenset({Knowledge.TRAIN}))
        _, known = linked(link(spy), mechanism="clean")
        informed = [one for one in spy.seen if Knowledge.TRAIN in one[0].granted]
        context, probe, _ = informed[0]
        train = context.train
        assert isinstance(train, LinkageTrainingSet)
        assert (train.mate >= 0).all()

        def shapes(release):
            return {tuple(np.round(np.diff(track.t), 6)[:5]) for track in release}

        assert not shapes(train.probe) & shapes(probe)
        sessions, half = known.sessions, known.halves[0]
        taught = sessions.probe.person[half.learns.probe]
        assert set(taught) == set(np.flatnonzero(sessions.learns[0]))
        # The mates of the training set are mates.
        gallery = sessions.gallery.person[half.learns.gallery]
        assert (gallery[half.learns.mate] == taught).all()

    def test_an_attack_is_fitted_anew_for_every_mechanism_and_fold(self):
        contexts = []
        for mechanism in ("raw", "fixed:1"):
            spy = Spy(uses=frozenset({Knowledge.TRAIN, Knowledge.MECHANISM}))
            linked(link(spy), mechanism=mechanism)
            contexts += [one for one, *_ in spy.seen if Knowledge.TRAIN in one.granted]
        distinct = {id(context): context for context in contexts}.values()
        assert len(distinct) == 4
        assert len({context.train.probe.xy.tobytes() for context in distinct}) == 4
        assert {type(context.mechanism).__name__ for context in distinct} == {"Raw", "Fixed"}

    def test_a_linker_behind_a_reconstruction_sees_what_that_makes(self):
        spy, rounds = Spy(uses=frozenset({Knowledge.TRAIN})), Rounds()
        found, _ = linked(link(spy, rounds))
        assert {spec for spec, _ in found} == {"rerelease/spy@rounds"}
        for context, *sides in spy.seen:
            shown = [*sides]
            if Knowledge.TRAIN in context.granted:
                shown += [context.train.probe, context.train.gallery]
            assert all((one.xy == np.rint(one.xy)).all() for one in shown)
        assert not any((one.xy == np.rint(one.xy)).all() for _, one in rounds.seen)

    def test_a_reconstruction_in_front_learns_where_its_people_truly_were(self):
        rounds = Rounds(uses=frozenset({Knowledge.TRAIN}))
        _, known = linked(link(Spy(), rounds), mechanism="clean")
        informed = [one for one, _ in rounds.seen if Knowledge.TRAIN in one.granted]
        assert informed
        for context in informed:
            train = context.train
            assert np.allclose(train.truth, train.release.xy, atol=1e-6)
        people = known.sessions.learns[0].sum()
        assert len(informed[0].train.release) == people

    def test_a_stranger_that_writes_to_its_input_harms_nobody(self):
        def vandal(probe, gallery):
            for one in (probe, gallery):
                one.xy.flags.writeable = True
                one.xy[:] = 0.0
            return np.zeros((len(probe), len(gallery)))

        alone, _ = linked(link(Spy()))
        after, _ = linked(link(plugin(Returns(vandal), "vandal")), link(Spy()))
        key = ("rerelease/spy", "blind")
        assert equal(alone[key], after[key])


class TestWhatIsReadOff:
    def test_rank_1_is_that_of_the_raw_scores(self):
        found, _ = linked(link(Spy()), mechanism="fixed:0.3")
        result = found["rerelease/spy", "blind"]
        hits = np.concatenate(
            [rank1(scores=search.scores, mate=search.mate) for search in result.searches]
        )
        assert result.scored.estimates["rank1"].value == pytest.approx(hits.mean(), abs=1e-12)
        assert result.scored.n_mated == hits.size

    def test_without_groups_neither_probes_nor_candidates_are_of_one(self):
        found, known = linked(link(Spy()), mechanism="clean")
        result = found["rerelease/spy", "blind"]
        hits = []
        for search, probe, gallery in zip(
            result.searches, result.probe_person, result.gallery_person, strict=True
        ):
            alone = known.sessions.alone
            for row in np.flatnonzero(alone[probe]):
                candidates = np.flatnonzero(alone[gallery])
                best = candidates[search.scores[row, candidates].argmax()]
                hits.append(best == search.mate[row])
        part = result.cohorts["without_groups"]
        assert part.n_mated == len(hits) == known.sessions.alone.sum()
        assert part.rank1.value == pytest.approx(np.mean(hits), abs=1e-12)
        assert part.chance > result.scored.estimates["chance"].value

    def test_who_is_in_the_scenes_too_is_drawn_alike(self):
        tracks = walkers()
        groups = sorted(set(tracks.group))[5:]
        sessions = build(TASKS["rerelease"], tracks=tracks, later=None, settings=STAGES, seed=0)
        known = sensed_sessions(sessions, groups=groups, stages=STAGES, seed=0)
        drawn = cluster_weights(n_clusters=len(groups), n_replicates=1000, seed=0)
        ours = sorted(set(sessions.group))
        for place, name in enumerate(ours):
            if name in groups:
                assert np.array_equal(known.weights[:, place], drawn[:, groups.index(name)])
        others = [place for place, name in enumerate(ours) if name not in groups]
        assert len(others) == 5
        assert (known.weights[:, others].sum(axis=1) == 5).all()

    def test_the_clean_ceiling_is_above_what_was_shared(self):
        shape = registry.parse("attacks", "shape")[0]
        clean, shared = (
            linked(link(shape), mechanism=spec)[0]["rerelease/shape", "blind"]
            for spec in ("clean", "fixed:1")
        )
        assert clean.scored.estimates["rank1"].ci_low > shared.scored.estimates["rank1"].ci_high

    def test_who_has_no_mate_is_left_alone_in_a_handover(self):
        kinematic = registry.parse("attacks", "kinematic")[0]
        found, known = linked(
            link(kinematic), task="handover-2s", mechanism="clean", tracks=walkers(80)
        )
        card = found["handover-2s/kinematic", "informed"].scored
        assert (known.sessions.mate < 0).any()
        assert card.estimates["rank1"].value > 0.9
        assert card.estimates["rank1_assigned"].value > 0.8
        assert card.estimates["false_link_rate"].value < 0.6


class TestControls:
    def test_every_task_has_its_controls(self):
        found, _ = linked(link(Spy()), controls=True)
        names = {spec.partition("control-")[2] for spec, _ in found if "control" in spec}
        assert names == CONTROLS.keys()
        found, _ = linked(link(Spy()), task="handover-1s", controls=True)
        names = {spec.partition("control-")[2] for spec, _ in found if "control" in spec}
        assert names == CONTROLS.keys() - {"frame", "clock"}

    def test_shuffled_mates_are_those_of_a_real_attack(self):
        shape = registry.parse("attacks", "shape")[0]
        found, _ = linked(link(shape), mechanism="clean", controls=True)
        real = found["rerelease/shape", "blind"]
        shuffled = found["rerelease/control-shuffled", ""]
        for one, other in zip(real.searches, shuffled.searches, strict=True):
            assert np.allclose(np.sort(one.scores), np.sort(other.scores), rtol=1e-5)
            assert (one.mate == other.mate).all()
        # That it is rejected as often as it should be takes many seeds: see below.
        assert real.scored.p_value <= 0.001 < shuffled.scored.p_value

    def test_what_sees_times_alone_is_alike_at_every_level(self):
        raw, fixed = (
            linked(link(Spy()), mechanism=spec, controls=True)[0] for spec in ("raw", "fixed:1")
        )
        for name, control in CONTROLS.items():
            key = f"rerelease/control-{name}", ""
            assert equal(raw[key], fixed[key]) == control.sees_times_only

    @pytest.mark.slow
    @pytest.mark.parametrize("name", ["random", "shuffled"])
    def test_a_control_is_rejected_as_often_as_the_test_says(self, name):
        rejected = []
        for seed in range(300):
            found, _ = linked(link(Spy()), controls=True, seed=seed)
            rejected.append(found[f"rerelease/control-{name}", ""].scored.p_value <= 0.05)
        assert 0.02 <= np.mean(rejected) <= 0.085  # 300 draws at 5 %: three standard errors


class TestDeterminism:
    def test_who_else_is_there_changes_nothing(self):
        alone, _ = linked(link(Spy()), mechanism="fid:1")
        shape = registry.parse("attacks", "shape")[0]
        company, _ = linked(
            link(shape), link(Spy(), Rounds()), link(Spy()), mechanism="fid:1", controls=True
        )
        key = ("rerelease/spy", "blind")
        assert equal(alone[key], company[key])
        one, other = alone[key].scored, company[key].scored
        assert one.p_value == other.p_value
        for name, estimate in one.estimates.items():
            assert np.array_equal(
                estimate.replicates, other.estimates[name].replicates, equal_nan=True
            )

    def test_errors_are_common_to_all_mechanisms(self):
        found = []
        for spec in ("fixed:0.2", "fixed:0.4"):
            spy = Spy()
            linked(link(spy), mechanism=spec)
            found.append(spy.seen[0][1])
        clean = Spy()
        linked(link(clean), mechanism="clean")
        truth = clean.seen[0][1].xy
        raw = Spy()
        linked(link(raw), mechanism="raw")
        added = [one.xy - raw.seen[0][1].xy for one in found]
        assert np.allclose(2 * added[0], added[1], atol=1e-6)
        assert not np.allclose(raw.seen[0][1].xy, truth, atol=1e-3)


class TestBreaches:
    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda p, g: np.zeros((len(g), len(p) + 1)), r"must return scores \(\d+, \d+\)"),
            (lambda p, g: np.full((len(p), len(g)), np.nan), "score that is not finite"),
            (lambda p, g: np.full((len(p), len(g)), 1e300), "score that is not finite"),
            (lambda p, g: np.zeros((len(p), len(g)), dtype=bool), "of bool"),
            (lambda *_: None, r"got \(\) of object"),
            (lambda *_: 1 / 0, "failed: ZeroDivisionError"),
            (lambda release: release, "failed: TypeError"),
        ],
    )
    def test_a_plugin_that_breaks_its_contract_is_named(self, make, message):
        with pytest.raises(PluginError, match=rf"attack rerelease/spy \(blind\) .*{message}"):
            linked(link(Returns(make)))

    def test_a_reconstruction_in_front_is_named_as_well(self):
        @dataclass(frozen=True)
        class Cuts(Rounds):
            def fit(self, context):
                del context
                return lambda release: Reconstruction(release.xy[:-1])

        with pytest.raises(PluginError, match=r"attack rounds \(behind rerelease/spy@rounds"):
            linked(link(Spy(), Cuts()))

    def test_what_requires_sigma_needs_a_mechanism_that_declares_it(self):
        needs = Spy(requires=frozenset({Knowledge.SIGMA}))

        @dataclass(frozen=True)
        class Silent:
            def share(self, sensed, rng):
                return replace(
                    registry.parse("mechanisms", "raw")[0].instance.share(sensed, rng), sigma=None
                )

        tracks = walkers()
        sessions = build(TASKS["split"], tracks=tracks, later=None, settings=STAGES, seed=0)
        known = sensed_sessions(sessions, groups=(), stages=STAGES, seed=0)
        crossed = Axes((), (), (), links=((TASKS["split"], link(needs)),))
        consumers = [one for one in crossed.linkers(TASKS["split"]) if one.kind == "linkage"]
        assert [one.knowledge for one in consumers] == ["oracle"]
        silent = plugin(Silent(), "silent")
        with pytest.raises(PluginError, match="requires SIGMA, but mechanism 'silent'"):
            linked_level_of(silent, consumers, known=known, epsilon_m=EPSILON_M, seed=0)


class TestCells:
    def entry_of(self, out, tables, consumer):
        content = cell_files.packed([(consumer, "key", {}, tables)], unit="", code={})
        (out / "cells").mkdir()
        (out / "cells" / "one.parquet").write_bytes(content)
        return {
            "files": ["one.parquet"],
            "consumer": consumer.spec,
            "knowledge": consumer.knowledge,
        }

    def link(self, task, *, control=""):
        found, known = linked(link(Spy()), task=task, controls=bool(control))
        consumer = Consumer("linkage", plugin(Spy()), "blind", task=task)
        if control:
            consumer = Consumer("control", task=task, control=control)
        return consumer, found[consumer.spec, consumer.knowledge], known

    @pytest.mark.parametrize("task", ["rerelease", "handover-2s"])
    @pytest.mark.parametrize("control", ["", "random"])
    def test_what_is_read_is_what_was_computed(self, tmp_path, task, control):
        consumer, result, known = self.link(task, control=control)
        tables = linkage_tables(result, known, seed=0, keep_scores=False)
        read = cell_files.read_outcome(tmp_path, self.entry_of(tmp_path, tables, consumer))
        assert list(read.estimates) == list(result.scored.estimates)
        with_draws = 0
        for name, estimate in result.scored.estimates.items():
            found = read.estimates[name]
            assert np.array_equal(
                [found.value, found.ci_low, found.ci_high, found.n],
                [estimate.value, estimate.ci_low, estimate.ci_high, estimate.n],
                equal_nan=True,
            )
            if not found.replicates.size:
                of_ranks = name in result.scored.probes.values()
                assert name in DERIVED or (control and not of_ranks)
                continue
            with_draws += 1
            expected = estimate.replicates.astype(np.float32)
            np.testing.assert_array_equal(found.replicates, expected)
        assert with_draws == (3 if control else 10) + (task != "rerelease")
        assert read.numbers["p_value"] == result.scored.p_value
        assert read.cohorts.keys() == result.cohorts.keys()

    def test_every_probe_says_how_it_fared(self, tmp_path):
        consumer, result, known = self.link("handover-2s")
        tables = linkage_tables(result, known, seed=0, keep_scores=False)
        assert "scores" not in tables["rows"].column_names
        rows = cell_files.read_probes(tmp_path, self.entry_of(tmp_path, tables, consumer))
        expected = [
            (number, scores, mate)
            for number, search in enumerate(result.searches)
            for scores, mate in zip(search.scores, search.mate, strict=True)
        ]
        assert len(rows) == len(expected)
        for row, (number, scores, mate) in zip(rows.itertuples(), expected, strict=True):
            assert row.search == known.sessions.searches[number]
            assert row.chance == 1 / scores.size
            if mate < 0:
                assert (row.above, row.tied) == (-1, 0)
                assert np.isnan(row.mate_score)
                assert row.best_other_score == np.float32(scores.max())
                continue
            assert row.above == (scores > scores[mate]).sum()
            assert row.tied == (scores == scores[mate]).sum()
            assert row.mate_score == np.float32(scores[mate])
            assert row.best_other_score == np.float32(np.delete(scores, mate).max())

    def test_raw_scores_stay_where_they_are_asked_for(self, tmp_path):
        consumer, result, known = self.link("handover-2s")
        tables = linkage_tables(result, known, seed=0, keep_scores=True)
        entry = self.entry_of(tmp_path, tables, consumer)
        rows = cell_files.read_rows(tmp_path, entry, columns=["source", "mate", "scores"])
        gallery = json.loads(tables["about"]["about"][0].as_py())["gallery"]
        table, first = rows.to_pandas(), 0
        for number, search in enumerate(result.searches):
            mine = table.iloc[first : first + len(search.mate)]
            first += len(search.mate)
            assert np.array_equal(np.stack(mine["scores"].to_list()), search.scores)
            for source, mate in zip(mine["source"], mine["mate"], strict=True):
                assert mate < 0 or gallery[number][mate] == source
        assert first == len(table)

    @pytest.mark.parametrize("content", [b"", b"PAR1 nonsense", None])
    def test_a_missing_or_broken_file_is_named(self, tmp_path, content):
        (tmp_path / "cells").mkdir()
        if content is not None:
            (tmp_path / "cells" / "cell.parquet").write_bytes(content)
        entry = {"files": ["cell.parquet"], "consumer": "split/x", "knowledge": "blind"}
        for read in (cell_files.read_outcome, cell_files.read_windows, cell_files.read_probes):
            with pytest.raises(DataError, match=r"cell\.parquet .*run the matrix again"):
                read(tmp_path, entry)


@pytest.fixture
def recording(tmp_path):
    write_walkers(tmp_path / "walkers.csv")
    return tmp_path / "walkers.csv"


@pytest.fixture
def settings(recording, tmp_path):
    return Settings(
        preset="smoke",
        dataset=str(recording),
        scenes=8,
        mechanisms=("raw", "fixed:1"),
        predictors=(),
        attacks=("shape", "histogram@kalman_rts", "kinematic"),
        tasks=("rerelease", "handover-2s"),
        out=tmp_path / "run",
        jobs=1,
    )


KEY = ["dataset", "mechanism", "level", "consumer", "knowledge", "metric"]


class TestRuns:
    def test_a_run_has_every_cell_of_every_task_once(self, settings):
        results = evaluation.run(settings, pictures=False)
        summary = results.summary
        assert not summary.duplicated(KEY).any()
        ranks = summary[summary["metric"] == "rank1"]
        assert set(ranks["mechanism"]) == {"raw", "fixed", "clean"}
        consumers = set(ranks["consumer"])
        assert {"rerelease/shape", "rerelease/histogram@kalman_rts", "handover-2s/kinematic"} <= (
            consumers
        )
        # Who needs no frame is not run where it shows, nor the other way round.
        assert not {"handover-2s/shape", "rerelease/kinematic"} & consumers
        assert set(ranks.loc[ranks["consumer"] == "rerelease/shape", "knowledge"]) == {
            "blind",
            "informed",
        }
        assert (ranks["value"].between(0, 1)).all()
        shares = summary[summary["unit"] == "fraction"].dropna(subset=["value"])
        shares = shares[shares["metric"] != "residual_risk"]
        assert shares["value"].between(0, 1).all()
        # The ceiling has no descriptors: nobody shares without error.
        assert set(summary.loc[summary["mechanism"] == "clean", "metric"]).isdisjoint({"plr"})

    def test_few_non_mated_pairs_refuse_an_operating_point(self, settings):
        summary = evaluation.run(settings, pictures=False).summary
        refused = summary[summary["metric"] == "tpr_at_fpr_01pct"]
        assert len(refused)
        assert refused[["value", "ci_low", "ci_high"]].isna().all(axis=None)

    def test_the_file_says_what_every_cell_means(self, settings):
        found = evaluation.run(settings).linkability
        assert list(found.columns) == linkability.COLUMNS
        assert set(found["cohort"]) == {"all", "without_groups", "without_frozen"}
        shape = found[(found["consumer"] == "rerelease/shape") & (found["cohort"] == "all")]
        clean = shape[shape["mechanism"] == "clean"]
        assert (clean["outcome"] == "links").all()
        assert (found["gallery_min"].dropna() >= 1).all()

    def test_it_goes_on_where_it_stopped_and_workers_change_nothing(self, settings):
        evaluation.run(
            replace(
                settings,
                tasks=("rerelease",),
                mechanisms=("raw",),
                attacks=("shape", "histogram@kalman_rts"),
            ),
            pictures=False,
        )
        evaluation.run(settings, pictures=False)
        apart = replace(settings, out=settings.out.with_name("apart"), jobs=2)
        evaluation.run(apart, pictures=False)
        frames = [
            pd.read_csv(out / "summary.csv").sort_values(KEY, ignore_index=True)
            for out in (settings.out, apart.out)
        ]
        pd.testing.assert_frame_equal(*frames, check_exact=True)

    def test_an_earlier_attack_whose_ceiling_is_missing_is_left_out(self, settings):
        evaluation.run(replace(settings, tasks=("rerelease",), attacks=("shape",)), pictures=False)
        for path in (settings.out / "cells").glob("clean*"):
            path.unlink()
        again = replace(settings, tasks=("rerelease",), attacks=("histogram",))
        found = evaluation.run(again, pictures=False).linkability
        attacks = set(found["consumer"])
        assert "rerelease/histogram" in attacks
        assert "rerelease/shape" not in attacks
        assert "rerelease/shape" in set(
            evaluation.run(
                replace(again, attacks=("histogram", "shape")), pictures=False
            ).linkability["consumer"]
        )

    def test_without_a_declared_noise_there_is_no_leak(self, settings):
        results = evaluation.run(
            replace(settings, mechanisms=("raw",), attacks=("kinematic",), tasks=("handover-2s",)),
            pictures=False,
        )
        clean = results.linkability[results.linkability["mechanism"] == "clean"]
        assert (clean["invalid"] == "").all()

    def test_the_manifest_says_who_is_linked(self, settings):
        manifest = evaluation.run(settings, pictures=False).manifest
        tasks = manifest["linkage"]["tasks"]
        assert tasks["rerelease"]["people"] == 40
        assert sum(tasks["rerelease"]["candidates"].values()) == 40
        assert manifest["settings"]["tasks"] == ["rerelease", "handover-2s"]
        assert "shape" in manifest["settings"]["attacks"]

    def test_a_presets_task_without_people_is_left_out_and_said(
        self, csv_recording, tmp_path, capsys
    ):
        words = [
            "--preset",
            "smoke",
            "--dataset",
            csv_recording,
            "--scenes",
            8,
            "--mechanism",
            "raw",
            "--predictor",
            "none",
            "--attack",
            "histogram",
            "--jobs",
            1,
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
        assert set(rows["dataset"]) == {linkability.TWO_SESSIONS}

    def test_a_task_that_was_named_must_be(self, csv_recording, tmp_path):
        words = ["--dataset", csv_recording, "--task", "rerelease", "--out", tmp_path / "run"]
        assert matrix.main([str(word) for word in words]) == 2


class TestAxes:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"tasks": ("rerelese",)}, "did you mean 'rerelease'"),
            ({"attacks": ("shape@dtw",)}, "left of @ stands a linkage attack"),
            ({"attacks": ("kalman_rts@radial_rts",)}, "left of @ stands a linkage attack"),
            ({"attacks": ("shape@kalman_rtss",)}, "did you mean 'kalman_rts'"),
            ({"attacks": ("shape@",)}, "'shape@': expected LINKER@RECONSTRUCTION"),
            ({"attacks": ("@radial_rts",)}, "expected LINKER@RECONSTRUCTION"),
            ({"attacks": ("kinematic",), "tasks": ("split",)}, "'kinematic' has no task"),
            ({"attacks": ("shape@averaging",)}, "has no task to run in.*requires REPEATS"),
            ({"attacks": ("identity",), "tasks": ("split",)}, "task split has no attack"),
            ({"attacks": ("shape",), "tasks": ()}, "'shape' has no task"),
        ],
    )
    def test_what_does_not_fit_is_refused_with_the_way_out(self, given, message):
        with pytest.raises(SettingsError, match=message):
            axes(Settings(**given))

    def test_an_attack_with_no_task_of_its_own_runs_where_it_can(self):
        found = axes(Settings(attacks=("shape",), tasks=("handover-1s",)))
        assert [(task.name, one.spec) for task, one in found.links] == [("handover-1s", "shape")]

    def test_the_default_has_every_task_and_every_linker(self):
        found = axes(Settings())
        assert {task.name for task in found.tasks} == TASKS.keys()
        linkers = {one.linker.name for _, one in found.links}
        assert linkers == {"shape", "profile", "dtw", "behaviour", "histogram", "kinematic"}

    def test_parameters_stay_in_the_name(self):
        found = axes(Settings(attacks=("histogram@savgol:0.5",), tasks=("split",)))
        assert [one.spec for _, one in found.links] == ["histogram@savgol:width_s=0.5"]

    def test_nothing_is_linked_without_tasks(self):
        assert axes(Settings(tasks=())).links == ()
        assert axes(Settings(tasks=())).ceiling is None


class TestOutcomes:
    @staticmethod
    def entry(consumer, mechanism, p_value, *, low=1.0, kind="linkage"):
        card = type("Card", (), {})()
        estimate = type("E", (), {"value": 0.1, "ci_low": 0.0, "ci_high": 0.2, "n": 5})()
        card.estimates = {"rank1": estimate, "chance": estimate}
        card.numbers = dict.fromkeys(
            (
                "p_rank1",
                "n_probes",
                "n_mated",
                "n_clusters",
                "realised_fpr_1pct",
                "realised_fpr_01pct",
                "d_sys_bins",
                "is_inverted",
                "minimum_detectable_rank1",
            ),
            1,
        ) | {"p_value": p_value, "p_value_low": low, "gallery_sizes": [5, 5, 5.0]}
        card.cohorts = {}
        level = None if mechanism in {"raw", "clean"} else 1.0
        return {
            "consumer": consumer,
            "knowledge": "" if kind == "control" else "blind",
            "mechanism": mechanism,
            "level": level,
            "spec": mechanism,
            "kind": kind,
        }, card

    def outcomes(self, *entries):
        frame = linkability.linkability(entries, dataset="here")
        return frame.set_index(["mechanism", "consumer"])

    @pytest.mark.parametrize(
        ("at_level", "at_ceiling", "expected"),
        [
            (0.01, 0.001, "links"),
            (0.01, 0.5, "links"),
            (0.2, 0.001, "no link detected"),
            (0.2, 0.5, "attack too weak"),
        ],
    )
    def test_three_outcomes(self, at_level, at_ceiling, expected):
        found = self.outcomes(
            self.entry("split/x", "fixed", at_level), self.entry("split/x", "clean", at_ceiling)
        )
        assert found.loc[("fixed", "split/x"), "outcome"] == expected

    def test_a_leak_makes_the_cells_of_its_task_and_level_invalid(self):
        found = self.outcomes(
            self.entry("split/control-duration", "fixed", 0.0004, kind="control"),
            self.entry("split/control-clock", "fixed", 0.02, kind="control"),
            self.entry("split/control-duration", "clean", 0.3, kind="control"),
            self.entry("split/x", "fixed", 0.001),
            self.entry("split/x", "clean", 0.001),
            self.entry("rerelease/x", "fixed", 0.001),
            self.entry("rerelease/x", "clean", 0.001),
        )
        assert found.loc[("fixed", "split/x"), "invalid"] == "duration"
        assert found.loc[("clean", "split/x"), "invalid"] == ""
        assert found.loc[("fixed", "rerelease/x"), "invalid"] == ""
        assert found.loc[("fixed", "split/control-duration"), "outcome"] == "beats chance"

    def test_a_shortcut_that_scores_mates_low_is_a_leak_as_well(self):
        found = self.outcomes(
            self.entry("split/control-duration", "raw", 1.0, low=0.0002, kind="control"),
            self.entry("split/x", "raw", 0.001),
            self.entry("split/x", "clean", 0.001),
        )
        assert found.loc[("raw", "split/x"), "invalid"] == "duration"

    def test_a_random_control_is_no_shortcut(self):
        found = self.outcomes(
            self.entry("split/control-random", "raw", 0.001, kind="control"),
            self.entry("split/x", "raw", 0.001),
            self.entry("split/x", "clean", 0.001),
        )
        assert found.loc[("raw", "split/x"), "invalid"] == ""

    def test_the_simulated_task_has_a_data_set_of_its_own(self):
        assert linkability.dataset_of("new_traversal/x", dataset="here") != "here"
        assert linkability.dataset_of("split/x", dataset="here") == "here"
        assert linkability.dataset_of("least_squares", dataset="here") == "here"
