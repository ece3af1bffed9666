"""What an attack is shown of a block, what it is not, and what its rows say."""

import contextlib
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pandas as pd
import pytest
from helpers.runs import arrays, rows_of

import evaluation
from attacks.reconstruction.kalman_rts import KalmanRTS
from evaluation.cells import reconstruction
from evaluation.cells.descriptors import descriptors
from evaluation.cells.reconstruction import TRAINING_PEOPLE, attacked_block, benchmark, folds
from evaluation.cells.work import Block, cells
from evaluation.experiment.axes import Axes
from evaluation.experiment.settings import Settings
from isac_track import plugins
from isac_track.config import StageSettings
from isac_track.errors import DataError, PluginError
from isac_track.plugins import Plugin
from isac_track.protocols import grants
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import fisher_information_density, sense_scenes
from isac_track.sharing import Clean, Fixed, Raw
from isac_track.types import Knowledge, Reconstruction, Sensed

STAGES = StageSettings()
N_SCENES = 12
ONE_PASS = 3
"""Scenes whose four agents each are the twelve people, once."""
MECHANISM, SIGMA, TRAIN, SCENE, REPEATS = (
    Knowledge.MECHANISM,
    Knowledge.SIGMA,
    Knowledge.TRAIN,
    Knowledge.SCENE,
    Knowledge.REPEATS,
)


@dataclass(frozen=True)
class Spy:
    """Keeps what it was shown, and takes it at its word."""

    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    seen: list = field(default_factory=list, compare=False)

    def fit(self, context):
        drawn = context.rng.random(3)

        def reconstruct(release):
            self.seen.append((context, release, drawn))
            return Reconstruction(release.xy)

        return reconstruct


class SlowSpy(Spy):
    slow: ClassVar[bool] = True


@dataclass(frozen=True)
class Moves:
    """Returns what a function makes of the positions."""

    move: object
    requires: frozenset = frozenset()
    uses: frozenset = frozenset()

    def fit(self, context):
        del context
        return lambda release: Reconstruction(self.move(release.xy))


@dataclass(frozen=True)
class Undeclared:
    """Shares the raw estimates and says nothing of their uncertainty."""

    def share(self, sensed, rng):
        return Raw().share(sensed, rng).without_sigma()


def plugin(instance, name="spy"):
    return Plugin(name=name, level=None, spec=name, origin=f"here:{name}", instance=instance)


def blocks_of(known, *, n_scenes=N_SCENES, size=None, levels, seed=0):
    order = track_order(n_tracks=len(known), n_scenes=n_scenes, agents=4, seed=seed)
    size = size or n_scenes
    return [
        Block(number=number, first_scene=first, order=order[first : first + size], levels=levels)
        for number, first in enumerate(range(0, n_scenes, size))
    ]


def computed(tracks, *attacks, mechanisms=("raw",), n_scenes=N_SCENES, size=None, seed=0):
    """Rows of every cell of some scenes by (mechanism, consumer, adversary), blocks in a list."""
    known = cut(tracks, settings=STAGES, seed=seed)
    attacks = tuple(
        one if isinstance(one, Plugin) else plugins.parse("attacks", one)[0] for one in attacks
    )
    mechanisms = tuple(
        one if isinstance(one, Plugin) else plugins.parse("mechanisms", one)[0]
        for one in mechanisms
    )
    consumers = Axes(mechanisms=mechanisms, predictors=(), attacks=attacks).consumers
    levels = tuple((mechanism, consumers) for mechanism in mechanisms)
    found = {}
    for block in blocks_of(known, n_scenes=n_scenes, size=size, levels=levels, seed=seed):
        for _, mechanism, consumer, tables in cells(block, tracks=known, stages=STAGES, seed=seed):
            key = (mechanism.spec, consumer.spec, consumer.knowledge)
            found.setdefault(key, []).append(arrays(tables, tracks=known))
    return found


def same(a, b):
    assert a.keys() >= b.keys()
    for name in b:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)


class World:
    """The block that `computed` makes, built from the parts that the cells are built of."""

    def __init__(self, tracks, *, mechanism="raw", n_scenes=N_SCENES, seed=0):
        self.tracks = cut(tracks, settings=STAGES, seed=seed)
        (block,) = blocks_of(self.tracks, n_scenes=n_scenes, levels=())
        self.scenes = make_scenes(
            self.tracks, order=block.order, first=0, settings=STAGES, seed=seed
        )
        self.sensed = sense_scenes(self.scenes, settings=STAGES.sensing, seed=seed)
        (plugin,) = plugins.parse("mechanisms", mechanism)
        self.release = plugin.instance.share(self.sensed, stream(seed, "sharing", "block", 0))
        self.half = folds(self.tracks.group, seed=seed)

    def rows(self, fold):
        """Tracks of the block whose people belong to that half."""
        return np.flatnonzero(self.half[self.scenes.track] == fold)

    def samples(self, fold):
        offsets = self.scenes.offsets
        return np.concatenate([np.arange(*offsets[row : row + 2]) for row in self.rows(fold)])

    def attacked(self, *, repeats=False):
        return attacked_block(
            scenes=self.scenes,
            sensed=self.sensed,
            tracks=self.tracks,
            repeats=repeats,
            stages=STAGES,
            seed=0,
        )


def in_groups(tracks, n_groups):
    return replace(tracks, group=tuple(f"g{row % n_groups}" for row in range(len(tracks))))


def lengths(xy, offsets):
    """Distances of each track's samples from its first: what no frame changes."""
    return [np.hypot(*(xy[lo:hi] - xy[lo]).T) for lo, hi in pairwise(offsets)]


class TestFolds:
    GROUPS = tuple(f"g{row // 3}" for row in range(33))

    def test_groups_stay_together_and_are_halved(self):
        half = folds(self.GROUPS, seed=0)
        of_group = {group: set(half[np.array(self.GROUPS) == group]) for group in self.GROUPS}
        assert all(len(halves) == 1 for halves in of_group.values())
        assert sorted(sum(halves == {fold} for halves in of_group.values()) for fold in (0, 1)) == [
            5,
            6,
        ]

    def test_the_order_of_the_tracks_does_not_matter(self):
        half = folds(self.GROUPS, seed=0)
        order = stream(0, "test", "order").permutation(33)
        turned = folds(tuple(self.GROUPS[row] for row in order), seed=0)
        assert turned.tolist() == half[order].tolist()

    def test_the_seed_splits_them(self):
        splits = {tuple(folds(self.GROUPS, seed=seed)) for seed in range(5)}
        assert len(splits) > 1

    def test_one_group_is_one_half(self):
        assert len(set(folds(("g",) * 5, seed=0))) == 1


class TestGround:
    @pytest.mark.parametrize("n_groups", [2, 4, 5, 12])
    def test_nobody_is_attacked_by_who_learnt_from_them_or_their_group(self, tracks, n_groups):
        world = World(in_groups(tracks, n_groups))
        made = world.attacked()
        group = np.array(world.tracks.group)
        for part, (scenes, _) in zip(made.halves, made.training, strict=True):
            victims = world.scenes.track[part.rows]
            assert set(group[victims]).isdisjoint(group[scenes.track])
            assert len(set(scenes.track)) == scenes.track.size
            assert set(group[victims]) | set(group[scenes.track]) == set(group)

    def test_the_halves_are_the_block(self, tracks):
        world = World(tracks)
        made = world.attacked()
        rows = np.concatenate([part.rows for part in made.halves])
        assert sorted(rows) == list(range(world.scenes.track.size))
        for fold, part in enumerate(made.halves):
            assert part.rows.tolist() == world.rows(fold).tolist()
            np.testing.assert_array_equal(part.truth, world.scenes.xy[world.samples(fold)])
            np.testing.assert_array_equal(part.t, world.scenes.t[world.samples(fold)])

    def test_no_more_people_train_than_it_takes(self, tracks, monkeypatch):
        assert TRAINING_PEOPLE >= 6  # of the twelve here all do
        full = World(tracks).attacked().training
        assert [scenes.track.size for scenes, _ in full] == [6, 6]
        monkeypatch.setattr(reconstruction, "TRAINING_PEOPLE", 2)
        few = World(tracks).attacked().training
        assert [scenes.track.size for scenes, _ in few] == [2, 2]

    @pytest.mark.parametrize("n_groups", [12, 4])
    def test_an_overlap_stops_the_run(self, tracks, monkeypatch, n_groups):
        world = World(in_groups(tracks, n_groups))
        # One person of the victims' half, who need not be a victim: their group is enough.
        monkeypatch.setattr(
            reconstruction,
            "_people",
            lambda half, *, fold, seed: np.flatnonzero(half == 1 - fold)[-1:],  # noqa: ARG005
        )
        with pytest.raises(AssertionError, match="victim's group is among the training people"):
            world.attacked()

    def test_one_group_has_nobody_to_learn_from(self, tracks):
        made = World(in_groups(tracks, 1)).attacked()
        attacked = [fold for fold, part in enumerate(made.halves) if part.rows.size]
        assert len(attacked) == 1
        assert made.training[attacked[0]] is None

    def test_the_walks_are_sensed_anew_for_repeats_alone(self, tracks):
        world = World(tracks)
        assert world.attacked().again == ()
        again = world.attacked(repeats=True).again
        assert len(again) == reconstruction.N_REPEATS
        truths = [one.xy - one.sigma_raw[:, None] * one.unit_error for one in again]
        for truth, one in zip(truths, again, strict=True):
            np.testing.assert_allclose(truth, world.scenes.xy, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(one.t, world.scenes.t)
        errors = [one.unit_error[:, 0] for one in (world.sensed, *again)]
        apart = np.corrcoef(errors)[np.triu_indices(len(errors), k=1)]
        assert np.abs(apart).max() < 5 / np.sqrt(errors[0].size)


class TestIdentity:
    @pytest.mark.parametrize(
        "mechanism",
        ["raw", "clean"]
        + [
            f"{name}{rule}"
            for name in ("fid:100", "fixed:0.5")
            for rule in ("", ",adding=independent")
        ],
    )
    def test_its_rows_are_those_as_shared_to_the_last_bit(self, tracks, mechanism):
        found = computed(tracks, "identity", mechanisms=(mechanism,))
        (shared,), (attacked,) = (found[key] for key in found if key[1] in ("shared", "identity"))
        assert {"plr", "ael_s", "mel_s", "segments", "mse_m2", "track", "scene"} <= shared.keys()
        same(attacked, shared)

    def test_all_columns_of_an_attack_have_one_row_a_track(self, tracks):
        (rows,) = computed(tracks, "kalman_rts")["raw", "kalman_rts", "blind"]
        assert {name: len(values) for name, values in rows.items()} == dict.fromkeys(
            rows, 4 * N_SCENES
        )
        assert set(rows) == {
            *(
                "scene",
                "agent",
                "track",
                "source",
                "group",
                "n_samples",
                "plr",
                "ael_s",
                "mel_s",
                "segments",
            ),
            *("mse_m2", "benchmark_mse_m2", "benchmark_plr"),
        }


class TestWhatIsShown:
    def spied(self, tracks, *, granted=(), requires=(), mechanism="fixed:0.5", slow=False):
        """What a spy saw of both halves, as the adversary who is granted so much."""
        spy = (SlowSpy if slow else Spy)(requires=frozenset(requires), uses=frozenset(granted))
        computed(tracks, plugin(spy), mechanisms=(mechanism,), n_scenes=ONE_PASS)
        seen = [one for one in spy.seen if one[0].granted == frozenset((*granted, *requires))]
        assert len(seen) == 2
        return World(tracks, mechanism=mechanism, n_scenes=ONE_PASS), seen

    def test_a_blind_adversary_sees_no_sigma_and_no_true_frame_or_clock(self, tracks):
        world, seen = self.spied(tracks)
        for fold, (context, release, _) in enumerate(seen):
            own = world.samples(fold)
            assert context.granted == frozenset()
            assert release.sigma is None
            # Rigid: the same walks, so that all there is to see is there to be seen.
            truth = lengths(world.release.xy[own], release.offsets)
            for ours, theirs in zip(lengths(release.xy, release.offsets), truth, strict=True):
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
            np.testing.assert_allclose(
                np.diff(release.t), np.diff(world.release.t[own]), rtol=0, atol=1e-9
            )
            assert np.hypot(*(release.xy - world.release.xy[own]).T).min() > 1.0
            assert abs(release.t[0] - world.release.t[own][0]) > 1.0
            heading = [
                np.arctan2(*(xy[release.offsets[1] - 1] - xy[0])[::-1])
                for xy in (release.xy, world.release.xy[own])
            ]
            assert abs(heading[0] - heading[1]) > 0.01

    def test_the_frames_of_the_halves_and_of_the_levels_differ(self, tracks):
        spy = Spy()
        computed(tracks, plugin(spy), mechanisms=("raw", "fixed:0.5"), n_scenes=ONE_PASS)
        clocks = [release.t[0] for _, release, _ in spy.seen]
        starts = [release.t[0] for release in (World(tracks).release,)]
        assert len({round(clock, 3) for clock in clocks}) == 4
        assert all(abs(clock - starts[0]) > 1.0 for clock in clocks)

    def test_scene_and_sigma_show_the_release_as_it_is(self, tracks):
        world, seen = self.spied(tracks, requires=(SCENE, SIGMA))
        for fold, (_, release, _) in enumerate(seen):
            own = world.samples(fold)
            np.testing.assert_array_equal(release.xy, world.release.xy[own])
            np.testing.assert_array_equal(release.t, world.release.t[own])
            np.testing.assert_array_equal(release.sigma, world.release.sigma[own])

    def test_sigma_alone_shows_no_frame(self, tracks):
        world, seen = self.spied(tracks, granted=(SIGMA,))
        for fold, (_, release, _) in enumerate(seen):
            own = world.samples(fold)
            np.testing.assert_array_equal(release.sigma, world.release.sigma[own])
            assert np.hypot(*(release.xy - world.release.xy[own]).T).min() > 1.0

    def test_scene_alone_shows_no_sigma(self, tracks):
        world, seen = self.spied(tracks, granted=(SCENE,))
        for fold, (_, release, _) in enumerate(seen):
            np.testing.assert_array_equal(release.xy, world.release.xy[world.samples(fold)])
            assert release.sigma is None

    @pytest.mark.parametrize("slow", [False, True])
    def test_the_training_set_is_of_other_people(self, tracks, slow):
        world, seen = self.spied(tracks, granted=(TRAIN,), mechanism="clean", slow=slow)
        known = lengths(world.tracks.xy, world.tracks.offsets)
        for fold, (context, release, _) in enumerate(seen):
            train = context.train
            assert train.release.sigma is None
            taught = [
                row
                for one in lengths(train.truth, train.release.offsets)
                for row, other in enumerate(known)
                if one.shape == other.shape and np.allclose(one, other, rtol=0, atol=1e-9)
            ]
            assert sorted(taught) == np.flatnonzero(world.half != fold).tolist()
            # Under clean sharing it is shared as it is, in a frame that is not the victims'.
            np.testing.assert_allclose(train.release.xy, train.truth, rtol=0, atol=1e-9)
            nearest = np.abs(train.truth[:, None] - release.xy[None, ::50]).sum(axis=2).min()
            assert nearest > 1.0

    @pytest.mark.parametrize("mechanism", ["fixed:0.5", "fixed:0.5,adding=independent"])
    def test_the_training_set_is_perturbed_by_the_same_mechanism(self, tracks, mechanism):
        _, seen = self.spied(tracks, granted=(TRAIN, SIGMA), mechanism=mechanism)
        for context, _, _ in seen:
            release, truth = context.train.release, context.train.truth
            error = np.hypot(*(release.xy - truth).T) / release.sigma
            # The length of a radial error is |N(0, sigma)|; a fresh one makes it a sum of two.
            assert np.mean(error**2) == pytest.approx(1.0, abs=0.1)
            assert release.sigma.min() >= 0.5

    def test_the_training_set_is_shared_with_noise_of_its_own(self, tracks):
        # The fresh noise of the release, by sample number, tells nothing of the training set's.
        world, seen = self.spied(
            tracks, requires=(TRAIN, SCENE), mechanism="fixed:5,adding=independent"
        )
        for fold, (context, release, _) in enumerate(seen):
            n = min(release.t.size, context.train.truth.shape[0])
            error = release.xy - world.scenes.xy[world.samples(fold)]
            other = context.train.release.xy - context.train.truth
            between = np.corrcoef(error[:n, 0], other[:n, 0])[0, 1]
            assert abs(between) < 5 / np.sqrt(n)

    def test_the_mechanism_is_the_very_object(self, tracks):
        spy = Spy(uses=frozenset({MECHANISM}))
        fixed = Plugin("mine", 0.5, "mine:0.5", "here:Mine", Fixed(0.5))
        computed(tracks, plugin(spy), mechanisms=(fixed,), n_scenes=ONE_PASS)
        granted = [context for context, *_ in spy.seen if MECHANISM in context.granted]
        assert len(granted) == 2
        assert all(context.mechanism is fixed.instance for context in granted)

    def test_repeats_are_the_same_walks_at_the_same_instants_with_other_errors(self, tracks):
        world, seen = self.spied(tracks, requires=(REPEATS, SCENE), mechanism="raw")
        for fold, (context, release, _) in enumerate(seen):
            truth = world.scenes.xy[world.samples(fold)]
            assert len(context.repeats) == reconstruction.N_REPEATS
            errors = [(one.xy - truth)[:, 0] for one in (release, *context.repeats)]
            for one in context.repeats:
                np.testing.assert_array_equal(one.t, release.t)
                np.testing.assert_array_equal(one.offsets, release.offsets)
                assert one.sigma is None
                assert set(one.pseudonym).isdisjoint(release.pseudonym)
            apart = np.corrcoef(errors)[np.triu_indices(3, k=1)]
            assert np.abs(apart).max() < 0.1

    def test_without_scene_each_repeat_has_a_frame_and_clock_of_its_own(self, tracks):
        _, seen = self.spied(tracks, requires=(REPEATS,))
        for context, release, _ in seen:
            clocks = [one.t[0] for one in (release, *context.repeats)]
            assert len({round(clock, 3) for clock in clocks}) == 3
            for one in context.repeats:
                np.testing.assert_allclose(np.diff(one.t), np.diff(release.t), rtol=0, atol=1e-9)

    def test_averaging_repeats_of_independent_errors_thirds_the_square(self, tracks):
        found = computed(
            tracks, "averaging", "identity", mechanisms=("fixed:3,adding=independent",)
        )
        (first,) = found["fixed:3,adding=independent", "identity", "blind"]
        (mean,) = found["fixed:3,adding=independent", "averaging", "oracle"]
        assert mean["mse_m2"].sum() / first["mse_m2"].sum() == pytest.approx(1 / 3, rel=0.05)

    def test_nothing_can_be_written_to(self, tracks):
        _, seen = self.spied(tracks, requires=tuple(Knowledge))
        for context, release, _ in seen:
            for one in (release, context.train.release, *context.repeats):
                for array in (one.t, one.xy, one.sigma, one.offsets):
                    with pytest.raises(ValueError, match="read-only"):
                        array[0] = 0
            with pytest.raises(ValueError, match="read-only"):
                context.train.truth[0] = 0

    def test_its_random_numbers_are_its_own_whatever_else_runs(self, tracks):
        alone, among = (Spy(uses=frozenset({MECHANISM})) for _ in range(2))
        computed(tracks, plugin(alone), mechanisms=("raw", "fixed:0.5"), n_scenes=ONE_PASS)
        others = ("moving_average", "averaging", plugin(Spy(uses=frozenset(Knowledge)), "other"))
        mechanisms = ("clean", "fixed:0.5", "raw")
        computed(tracks, *others, plugin(among), mechanisms=mechanisms, n_scenes=ONE_PASS)
        # The release's first clock names the level and the half.
        drawn = [
            {
                (context.granted, release.t[0]): tuple(numbers)
                for context, release, numbers in spy.seen
            }
            for spy in (alone, among)
        ]
        assert len(drawn[0]) == 2 * 2 * 2  # adversaries, levels, halves
        assert drawn[0].items() <= drawn[1].items()
        assert len(set(drawn[0].values())) == 8


QUICK = ("identity", "moving_average", "savgol", "kalman_rts", "radial_rts", "averaging")


class Vandal:
    """Unlocks what it is given and overwrites it."""

    requires = frozenset()
    uses = frozenset({TRAIN})

    def fit(self, context):
        if TRAIN in context.granted:
            self.spoil(context.train.truth)
            self.spoil(context.train.release.xy)

        def reconstruct(release):
            self.spoil(release.xy)
            return Reconstruction(release.xy)

        return reconstruct

    @staticmethod
    def spoil(array):
        while array is not None:
            with contextlib.suppress(ValueError):
                array.flags.writeable = True
                array[...] = 0.0
            array = array.base


class TestStrangers:
    """Who is not one of the project's own gets each walk once a release, and copies of it."""

    def test_no_release_shows_a_walk_twice(self, tracks):
        # Four passes over 12 people: a copy would have the sampling instants of its twin.
        spy = Spy()
        computed(tracks, plugin(spy))
        for _, release, _ in spy.seen:
            rhythms = [tuple(np.diff(track.t).round(9)) for track in release]
            assert len(set(rhythms)) == len(rhythms)
        assert len(spy.seen) == 2 * N_SCENES / ONE_PASS
        assert sum(len(release) for _, release, _ in spy.seen) == 4 * N_SCENES
        assert len({round(release.t[0], 3) for _, release, _ in spy.seen}) == len(spy.seen)

    @pytest.mark.parametrize("name", QUICK)
    def test_the_built_in_attacks_gain_nothing_by_seeing_all_passes_at_once(self, tracks, name):
        (own,) = plugins.parse("attacks", name)
        mechanisms = ("fid:1000,adding=independent",)
        found = computed(tracks, own, plugin(own.instance, "foreign"), mechanisms=mechanisms)
        compared = 0
        for (mechanism, consumer, knowledge), (rows,) in found.items():
            if consumer == "foreign":
                (mine,) = found[mechanism, name, knowledge]
                np.testing.assert_allclose(rows["mse_m2"], mine["mse_m2"], rtol=1e-6)
                np.testing.assert_array_equal(rows["plr"], mine["plr"])
                compared += 1
        assert compared == len(grants(own.instance))

    def test_what_one_overwrites_the_next_does_not_see(self, tracks):
        vandal = plugin(Vandal(), "vandal")
        other = plugin(KalmanRTS(), "other")
        among = computed(tracks, vandal, other, "kalman_rts", "identity", mechanisms=("fixed:0.5",))
        alone = computed(tracks, other, "kalman_rts", "identity", mechanisms=("fixed:0.5",))
        for key, (rows,) in alone.items():
            same(among[key][0], rows)
        # All zero is what it said, and what it is judged by.
        (spoilt,) = among["fixed:0.5", "vandal", "blind"]
        assert np.sqrt(spoilt["mse_m2"]).min() > 10.0


class TestTheWayBack:
    def test_a_constant_offset_in_its_frame_is_an_error_of_that_length(self, tracks):
        attack = plugin(Moves(lambda xy: xy + np.array([0.3, -0.4])), "aside")
        (rows,) = computed(tracks, attack, mechanisms=("clean",))["clean", "aside", "blind"]
        np.testing.assert_allclose(rows["mse_m2"], 0.25, rtol=1e-9)
        assert (rows["plr"] == 0.0).all()
        near = plugin(Moves(lambda xy: xy + np.array([0.12, -0.16])), "near")
        (rows,) = computed(tracks, near, mechanisms=("clean",))["clean", "near", "blind"]
        assert (rows["plr"] == 1.0).all()

    def test_positions_elsewhere_in_its_frame_are_found_there_in_the_true_one(self, tracks):
        """Backwards through each half's samples: a turn the wrong way round would show."""
        # Not clean: about the truth itself a turn of the correction would change no distance.
        attack = plugin(Moves(lambda xy: xy[::-1]), "backwards")
        found = computed(tracks, attack, mechanisms=("fixed:5",), n_scenes=ONE_PASS)
        (rows,) = found["fixed:5", "backwards", "blind"]
        world = World(tracks, mechanism="fixed:5", n_scenes=ONE_PASS)
        expected = np.empty(world.scenes.track.size)
        for fold in (0, 1):
            own = world.samples(fold)
            square = ((world.release.xy[own][::-1] - world.scenes.xy[own]) ** 2).sum(axis=1)
            sizes = np.diff(world.scenes.offsets)[world.rows(fold)]
            parts = np.split(square, np.cumsum(sizes)[:-1])
            expected[world.rows(fold)] = [part.mean() for part in parts]
        np.testing.assert_allclose(rows["mse_m2"], expected, rtol=1e-9)


class TestSlowAttacks:
    def test_they_see_one_release_of_each_source_track(self, tracks):
        # 12 people on 4 * 4 seats, two blocks: the second has 4 of them for the first time.
        slow, quick = plugin(SlowSpy(), "slow"), plugin(Spy(), "quick")
        found = computed(tracks, slow, quick, n_scenes=4, size=2)
        rows = found["raw", "slow", "blind"]
        assert [len(one["track"]) for one in rows] == [8, 4]
        met = np.concatenate([one["track"] for one in rows])
        assert sorted(met) == list(range(12))
        assert [len(one["track"]) for one in found["raw", "quick", "blind"]] == [8, 8]

    def test_their_rows_are_those_of_the_same_walks_in_a_quick_attack(self, tracks):
        slow, quick = plugin(SlowSpy(), "slow"), plugin(Spy(), "quick")
        found = computed(tracks, slow, quick, n_scenes=4, size=2)
        for few, all_of in zip(
            found["raw", "slow", "blind"], found["raw", "quick", "blind"], strict=True
        ):
            place = list(zip(all_of["scene"], all_of["agent"], strict=True))
            rows = [place.index(one) for one in zip(few["scene"], few["agent"], strict=True)]
            for name in few:
                np.testing.assert_array_equal(few[name], all_of[name][rows], err_msg=name)

    def test_a_block_without_anybody_new_has_no_rows(self, tracks):
        found = computed(tracks, plugin(SlowSpy(), "slow"), n_scenes=6, size=3)
        assert [len(one["track"]) for one in found["raw", "slow", "blind"]] == [12, 0]


def alone(*, sigma_raw=0.3, n_samples=1, law="radial", step_s=0.1):
    """One track as sensed, at the origin."""
    t = step_s * np.arange(float(n_samples))
    offsets = np.array([0, n_samples])
    information = np.full(n_samples, sigma_raw**-2.0)
    return Sensed(
        t=t,
        xy=np.zeros((n_samples, 2)),
        unit_error=np.zeros((n_samples, 2)),
        sigma_raw=np.full(n_samples, sigma_raw),
        information=information,
        fid=fisher_information_density(information=information, t=t, offsets=offsets),
        offsets=offsets,
        law=law,
    )


class TestBenchmark:
    """P in closed form: of a single sample, and of a walk too short to turn."""

    def expected(self, mechanism, name="mine", **sensed):
        sensed = alone(**sensed)
        release = mechanism.share(sensed, stream(0, "test", "benchmark"))
        mse, plr = benchmark(
            release, sensed=sensed, mechanism=plugin(mechanism, name), epsilon_m=0.3
        )
        assert mse.shape == plr.shape == (1,)
        return mse[0], plr[0]

    @pytest.mark.parametrize(
        ("mechanism", "law", "variance"),
        [
            (Raw(), "radial", 0.09 / 2),
            (Raw(), "isotropic", 0.09),
            (Fixed(0.5), "radial", 0.64 / 2),
            (Fixed(0.5), "isotropic", 0.64),
            (Fixed(0.4, adding="independent"), "radial", 0.25 / 2),
            (Fixed(0.4, adding="independent"), "isotropic", 0.25),
            (Fixed(0.4, adding="independent", law="isotropic"), "radial", 0.045 + 0.16),
            (Fixed(0.4, adding="independent", law="radial"), "isotropic", 0.09 + 0.08),
        ],
    )
    def test_of_one_sample_it_is_the_error_itself(self, mechanism, law, variance):
        mse, plr = self.expected(mechanism, law=law)
        assert mse == pytest.approx(2 * variance, rel=1e-4)
        assert plr == pytest.approx(1 - np.exp(-(0.3**2) / (2 * variance)), rel=1e-4)

    def test_of_a_short_walk_it_is_that_of_the_line_through_its_samples(self):
        # A line through n samples of variance r: r / n at its middle, 4 r / n at its ends, 2 r / n
        # on average. Per axis r is 2 m^2, on two axes 4; in 0.5 s nobody turns by as much.
        mse, _ = self.expected(Raw(), n_samples=50, step_s=0.01, sigma_raw=2.0)
        assert mse == pytest.approx(4.0 * 2 / 50, rel=0.05)

    def test_clean_sharing_leaves_nothing_to_gain(self):
        mse, plr = self.expected(Clean(), "clean", n_samples=5)
        assert mse < 1e-10
        assert plr == 1.0

    def test_a_mechanism_that_takes_error_away_is_judged_by_what_it_left(self):
        # `clean` under the name of somebody's own class.
        mse, plr = self.expected(Clean(), "here:Clean", n_samples=5)
        assert mse < 1e-10
        assert plr == 1.0

    def test_what_is_not_declared_has_none(self):
        mse, plr = self.expected(Undeclared(), n_samples=5)
        assert np.isnan(mse)
        assert np.isnan(plr)

    def test_it_is_the_same_whatever_was_drawn(self, tracks):
        found = computed(tracks, "identity", "kalman_rts", mechanisms=("raw",))
        of = [rows for key, (rows,) in found.items() if key[1] != "shared"]
        for rows in of[1:]:
            np.testing.assert_array_equal(rows["benchmark_mse_m2"], of[0]["benchmark_mse_m2"])
        assert (of[0]["benchmark_mse_m2"] < of[0]["mse_m2"]).all()


def test_descriptors_by_hand():
    rows = descriptors(
        xy=np.array([[0.1, 0.0], [0.0, 0.5], [0.0, 0.0], [3.0, 4.0]]),
        truth=np.zeros((4, 2)),
        t=np.array([0.0, 0.5, 1.0, 7.0]),
        offsets=np.array([0, 3, 4]),
        epsilon_m=0.3,
    )
    assert rows["plr"].tolist() == pytest.approx([2 / 3, 0.0])
    assert rows["ael_s"].tolist() == pytest.approx([0.5, 0.0])
    assert rows["mel_s"].tolist() == pytest.approx([0.5, 0.0])
    assert rows["segments"].tolist() == [2, 0]
    assert rows["mse_m2"].tolist() == pytest.approx([(0.01 + 0.25) / 3, 25.0])


@dataclass(frozen=True)
class Bad:
    """Breaks its contract in the way that it is told."""

    how: object
    requires: frozenset = frozenset()
    uses: frozenset = frozenset({MECHANISM})

    def fit(self, context):
        return self.how(context)


def fails(_context):
    raise RuntimeError("no luck")


def exits(_context):
    raise SystemExit(3)


def peeks(context):
    return lambda release: Reconstruction(release.xy + len(context.train.truth))


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (fails, "failed: RuntimeError: no luck"),
        (exits, "failed: SystemExit: 3"),
        (lambda _: None, "failed: TypeError: 'NoneType' object is not callable"),
        (lambda _: lambda release: release.xy, "must return a Reconstruction with xy .* got"),
        (lambda _: lambda _: None, "must return a Reconstruction with xy .* got NoneType"),
        (lambda _: lambda release: Reconstruction(release.xy[1:]), "must return .* with xy"),
        (
            lambda _: lambda release: Reconstruction(release.xy * np.nan),
            "failed: ValueError: a reconstructed position is not finite",
        ),
        (peeks, "failed: KnowledgeDenied: TRAIN was not granted"),
        (
            lambda _: lambda release: Reconstruction(release.xy + release.sigma[:, None]),
            "failed: TypeError",
        ),
        (
            lambda _: lambda release: Reconstruction(release.xy.__setitem__(0, 0)),
            "failed: ValueError: assignment destination is read-only",
        ),
    ],
)
def test_an_attack_that_breaks_its_contract_is_named_with_its_adversary(tracks, how, message):
    with pytest.raises(PluginError, match=rf"attack mine \(blind\) {message}"):
        computed(tracks, plugin(Bad(how), "mine"))
    later = Bad(lambda context: how(context) if MECHANISM in context.granted else _honest)
    with pytest.raises(PluginError, match=rf"attack mine \(informed\) {message}"):
        computed(tracks, plugin(later, "mine"))


def _honest(release):
    return Reconstruction(release.xy)


class TestOneGroup:
    def test_an_attack_that_learns_is_refused_with_a_way_out(self, tracks):
        crowd = in_groups(tracks, 1)
        with pytest.raises(DataError, match=r"'kalman_rts' learns .* leave the attack out"):
            computed(crowd, "kalman_rts")

    def test_the_blind_run_all_the_same(self, tracks):
        found = computed(in_groups(tracks, 1), "identity", "averaging")
        assert len(found["raw", "identity", "blind"][0]["plr"]) == 4 * N_SCENES
        assert len(found["raw", "averaging", "oracle"][0]["plr"]) == 4 * N_SCENES


@pytest.fixture
def settings(csv_recording, tmp_path):
    return Settings(
        preset="smoke",
        dataset=str(csv_recording),
        scenes=N_SCENES,
        mechanisms=("raw", "fid:1000", "fixed:0.7,adding=independent"),
        predictors=(),
        attacks=("identity", "kalman_rts", "averaging"),
        out=tmp_path / "run",
    )


class TestRuns:
    def test_identity_says_what_is_shared_in_the_summary(self, settings):
        summary = evaluation.run(settings, pictures=False).summary
        shared, attacked = (
            summary[summary["consumer"] == name].set_index(["mechanism", "metric"])
            for name in ("shared", "identity")
        )
        numbers = ["value", "ci_low", "ci_high", "n"]
        assert len(shared) == 3 * 4
        pd.testing.assert_frame_equal(
            attacked.loc[shared.index, numbers], shared[numbers], check_exact=True
        )

    def test_adding_attacks_changes_no_other_row(self, settings):
        before = evaluation.run(settings, pictures=False).summary
        more = (*settings.attacks, "radial_rts", "imm_rts", "moving_average")
        after = evaluation.run(replace(settings, attacks=more), pictures=False).summary
        assert len(after) > len(before)
        afresh = evaluation.run(replace(settings, attacks=more, fresh=True), pictures=False).summary
        pd.testing.assert_frame_equal(afresh, after, check_exact=True)
        key = ["mechanism", "level", "consumer", "knowledge", "metric"]
        kept = after[after["consumer"].isin(before["consumer"])]
        pd.testing.assert_frame_equal(
            kept.sort_values(key).reset_index(drop=True),
            before.sort_values(key).reset_index(drop=True),
            check_exact=True,
        )

    def test_workers_change_no_bit(self, settings, tmp_path):
        attacks = ("identity", "kalman_rts", "radial_rts", "averaging", "imm_rts")
        alone = replace(settings, attacks=attacks)
        evaluation.run(alone, pictures=False)
        evaluation.run(replace(alone, jobs=2, out=tmp_path / "two"), pictures=False)
        first, second = (tmp_path / name / "summary.csv" for name in ("run", "two"))
        assert first.read_bytes() == second.read_bytes()

    def test_the_ratio_to_the_benchmark_is_of_sums_over_tracks(self, settings):
        results = evaluation.run(settings, pictures=False)
        table = results.summary.set_index(["mechanism", "consumer", "knowledge", "metric"])["value"]
        seen = 0
        for entry in results.manifest["cells"]:
            if entry["kind"] != "attack":
                continue
            seen += 1
            rows = rows_of(settings.out, entry["spec"], entry["consumer"], entry["knowledge"])
            key = (entry["mechanism"], entry["consumer"], entry["knowledge"])
            assert table[*key, "rmse_over_benchmark"] == pytest.approx(
                np.sqrt(rows["mse_m2"].sum() / rows["benchmark_mse_m2"].sum())
            )
            assert table[*key, "plr_over_benchmark"] == pytest.approx(
                rows["plr"].sum() / rows["benchmark_plr"].sum()
            )
            assert table[*key, "rmse"] == pytest.approx(np.sqrt(rows["mse_m2"].mean()))
        assert seen == 3 * (1 + 3 + 1)

    def test_a_mechanism_that_declares_no_sigma_has_no_benchmark_and_runs(
        self, settings, tmp_path, monkeypatch
    ):
        (tmp_path / "silent_mechanism.py").write_text(SILENT, encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        silent = replace(
            settings, mechanisms=("silent_mechanism:Silent", "raw"), attacks=("identity",)
        )
        table = evaluation.run(silent, pictures=False).summary.set_index(
            ["mechanism", "consumer", "metric"]
        )
        values = table["value"]
        for metric in ("plr", "rmse", "ael", "mel"):
            assert values["silent_mechanism:Silent", "identity", metric] == pytest.approx(
                values["raw", "identity", metric]
            )
        for metric in ("rmse_over_benchmark", "plr_over_benchmark"):
            assert np.isnan(values["silent_mechanism:Silent", "identity", metric])
            assert values["raw", "identity", metric] > 0

    def test_attacks_that_know_sigma_run_where_none_is_declared(
        self, settings, tmp_path, monkeypatch
    ):
        (tmp_path / "silent_mechanism.py").write_text(SILENT, encoding="utf-8")
        monkeypatch.syspath_prepend(str(tmp_path))
        silent = replace(settings, mechanisms=("silent_mechanism:Silent",))
        summary = evaluation.run(silent, pictures=False).summary
        assert "oracle" in set(summary["knowledge"])

    def test_real_people_are_split_by_group(self, students03):
        known = cut(students03.tracks, settings=STAGES, seed=0)
        half = folds(known.group, seed=0)
        groups = np.array(known.group)
        assert set(groups[half == 0]).isdisjoint(groups[half == 1])
        assert abs(len(set(groups[half == 0])) - len(set(groups[half == 1]))) <= 1


SILENT = """
from dataclasses import dataclass
from isac_track.sharing import perturb

@dataclass(frozen=True)
class Silent:
    def share(self, sensed, rng):
        return perturb(sensed, 0.0, rng).without_sigma()
"""
