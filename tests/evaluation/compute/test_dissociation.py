"""Mechanisms that share fewer samples, and the descriptors of linked windows."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.cells import (
    EPSILON_M,
    STAGES,
    Spy,
    World,
    linked,
    make_task_windows,
    parsed,
    plugin,
)
from helpers.oracles import aligned

from attacks.reconstruction.averaging import Identity
from attacks.reconstruction.kalman_rts import RadialRTS
from attacks.tasks.windows import Windows
from evaluation.compute.link_setup import sense_task
from evaluation.compute.linkage import is_same_at_all_levels
from evaluation.compute.sharing import samples_shared, share, take_samples
from evaluation.compute.window_tables import WINDOW_COLUMNS
from evaluation.compute.work import LinkWork, compute_cells
from evaluation.plan.axes import expand_axes
from evaluation.plan.consumer import Consumer, windows_consumer
from evaluation.plan.presets import DISSOCIATION, PROTECTIONS
from evaluation.plan.settings import Settings
from isac_track import plugins, privacy
from isac_track.config import StageSettings
from isac_track.conflict import minimum_separation
from isac_track.errors import PluginError
from isac_track.protocols import AttackContext, grants
from isac_track.rng import stream
from isac_track.scenes import robot_positions
from isac_track.sharing import Clean, Fixed, Raw
from isac_track.types import Knowledge, Release, Sensed


def taken(release, chosen):
    """The release without the samples that were not chosen, (M,) bool."""
    offsets = np.concatenate(
        [[0], np.cumsum(np.add.reduceat(chosen, release.offsets[:-1]))]
    )
    some = {name: getattr(release, name)[chosen] for name in ("t", "xy", "sigma")}
    return replace(release, offsets=offsets, **some)


def is_odd(sensed):
    """Whether a sample's own time in ms is odd, or it is the last: a user's rule."""
    odd = np.rint(1e3 * sensed.t).astype(int) % 2 == 1
    odd[sensed.offsets[1:] - 1] = True
    return odd


@dataclass(frozen=True)
class Sieve:
    """A user's mechanism: it shares the samples of another's release that `take` leaves."""

    base: object = Raw()
    take: object = lambda release, sensed: taken(release, is_odd(sensed))

    def share(self, sensed, rng):
        return self.take(self.base.share(sensed, rng), sensed)


def attack(instance):
    result = plugin(instance)
    return [
        Consumer("attack", result, adversary=name, granted=granted)
        for name, granted in grants(instance).items()
    ]


def stored_rows(world, by, *consumers):
    """Rows of each consumer of a mechanism."""
    return [rows for *_, rows in world.cells([by], consumers)]


@pytest.fixture(scope="module")
def world(tracks):
    return World(tracks, n_scenes=6)  # two passes over the 12 tracks


class TestSamplesShared:
    SENSED = Sensed(
        t=np.array([0.0, 0.1, 0.2, 5.0, 5.1, 0.1, 0.2]),
        xy=np.arange(14.0).reshape(7, 2),
        unit_error=np.zeros((7, 2)),
        sigma_raw=np.arange(7.0),
        information=10.0 + np.arange(7.0),
        fid=20.0 + np.arange(7.0),
        offsets=np.array([0, 3, 5, 7]),
    )

    def released(self, t, offsets):
        t = np.array(t)
        names = tuple("abcdefg"[: len(offsets) - 1])
        return Release(t, np.zeros((t.size, 2)), None, np.array(offsets), names)

    def test_everything(self):
        assert (
            samples_shared(self.released(self.SENSED.t, [0, 3, 5, 7]), self.SENSED)
            is None
        )

    def test_some_of_each_track(self):
        left = samples_shared(
            self.released([0.0, 0.2, 5.1, 0.1, 0.2], [0, 2, 3, 5]), self.SENSED
        )
        assert left.rows.tolist() == [0, 2, 4, 5, 6]
        assert left.offsets.tolist() == [0, 2, 3, 5]
        known = take_samples(self.SENSED, left)
        for name in ("t", "xy", "sigma_raw", "information", "fid"):
            values = getattr(self.SENSED, name)[[0, 2, 4, 5, 6]]
            assert getattr(known, name).tolist() == values.tolist()

    @pytest.mark.parametrize(
        ("t", "offsets", "message"),
        [
            # The times of all samples are those that were sensed; whose they are is
            # not.
            (SENSED.t, [0, 4, 5, 7], r"in track 0 nothing was sensed at 5 s"),
            *(
                (
                    [0.0, 5.0, at],
                    [0, 1, 2, 3],
                    "in track 2 nothing was sensed at .* left out, not",
                )
                for at in (-1.0, 0.15, 0.2 + 1e-12, 9.0)
            ),
            ([0.0, 5.0], [0, 1, 2], "of 3 tracks it returned 2"),
        ],
    )
    def test_nothing_else(self, t, offsets, message):
        with pytest.raises(ValueError, match=message):
            samples_shared(self.released(t, offsets), self.SENSED)


class TestRefused:
    @pytest.mark.parametrize(
        ("take", "message"),
        [
            (
                lambda release, _: replace(release, t=release.t + 1e-6),
                (
                    r"^mechanism 'mine' changed .* times: in track 0 nothing was sensed"
                    r" at \S+ s; "
                ),
            ),
            (
                lambda release, _: taken(
                    release, np.arange(release.t.size) >= release.offsets[1]
                ),
                (
                    r"^mechanism 'mine' failed: ValueError: every track needs at least"
                    r" one sample"
                ),
            ),
        ],
    )
    def test_what_moves_times_or_leaves_nothing(self, world, take, message):
        with pytest.raises(PluginError, match=message):
            stored_rows(world, Sieve(take=take), Consumer("shared"))

    def test_what_leaves_out_other_samples_when_a_walk_is_shared_again(self, world):
        def by_chance(release, sensed):
            chosen = sensed.unit_error[:, 0] > 0
            chosen[sensed.offsets[1:] - 1] = True
            return taken(release, chosen)

        sieve = Sieve(take=by_chance)
        needs = frozenset({Knowledge.REPEATS})
        with pytest.raises(
            PluginError, match="'mine' leaves out other samples when the same"
        ):
            stored_rows(world, sieve, *attack(Spy(requires=needs)))
        (rows,) = stored_rows(
            world, sieve, Consumer("shared")
        )  # but it may be shared once
        assert (rows["n_samples"] < np.diff(world.scenes.offsets)).all()


class TestScenes:
    def test_the_descriptors_are_those_of_the_samples_that_were_shared(self, world):
        (rows,) = stored_rows(world, Sieve(Fixed(0.3)), Consumer("shared"))
        whole = world.share("fixed:0.3")
        chosen = is_odd(world.sensed)
        for row, (lo, hi) in enumerate(pairwise(whole.offsets)):
            own = np.flatnonzero(chosen[lo:hi]) + lo
            leaked = privacy.leakage_indicator(
                shared_xy=whole.xy[own],
                true_xy=world.scenes.xy[own],
                epsilon_m=EPSILON_M,
            )
            expected = privacy.exposure(
                leaked=leaked, t=whole.t[own], offsets=np.array([0, own.size])
            )
            assert rows["n_samples"][row] == own.size
            for name in ("plr", "ael_s", "mel_s"):
                assert rows[name][row] == getattr(expected, name)[0]
            square = ((whole.xy[own] - world.scenes.xy[own]) ** 2).sum(axis=1)
            assert rows["mse_m2"][row] == pytest.approx(square.mean(), rel=1e-12)

    def test_a_predictor_gets_the_thinned_release_and_the_whole_future(self, world):
        forecaster = parsed("predictors", "least_squares")
        consumer = Consumer("predictor", forecaster)
        (thinned,), (whole,) = (
            stored_rows(world, by, consumer) for by in (Sieve(Clean()), Clean())
        )
        for same in ("scene", "track", "conflict", "separation_m"):
            np.testing.assert_array_equal(thinned[same], whole[same])
        release = world.share(Sieve(Clean())).without_sigma()
        mean = forecaster.instance.predict(release, world.scenes.t_future).mean
        robot = robot_positions(world.scenes, settings=STAGES.conflict)
        expected = minimum_separation(robot=robot, agents=mean.reshape(robot.shape))
        np.testing.assert_array_equal(thinned["predicted_separation_m"], expected)
        assert not np.array_equal(
            thinned["predicted_separation_m"], whole["predicted_separation_m"]
        )

    @pytest.mark.parametrize("granted", [(), tuple(Knowledge)])
    def test_an_attack_is_given_and_measured_on_what_was_shared(self, world, granted):
        spy = Spy(uses=frozenset(granted), requires=frozenset(granted))
        (rows,) = stored_rows(world, Sieve(Clean()), *attack(spy))
        # The truth was shared: whatever is compared with it must be the same to the
        # last sample.
        assert np.abs(rows["mse_m2"]).max() < 1e-12
        assert rows["plr"].tolist() == [1.0] * 24
        odd = is_odd(world.sensed)
        track_rows = np.add.reduceat(odd, world.scenes.offsets[:-1], dtype=int)
        assert rows["n_samples"].tolist() == track_rows.tolist()
        assert sum(release.t.size for _, release, _ in spy.seen) == odd.sum()
        for context, release, _ in spy.seen if granted else ():
            train = context.train
            np.testing.assert_allclose(train.release.xy, train.truth, rtol=0, atol=1e-9)
            assert len(context.repeats) == 2
            for again in context.repeats:
                np.testing.assert_array_equal(again.t, release.t)
                np.testing.assert_allclose(again.xy, release.xy, rtol=0, atol=1e-9)

    @pytest.mark.parametrize("spec", ["correlated:0.5", "offset:0.3"])
    def test_without_independent_errors_there_is_no_linear_benchmark(self, world, spec):
        (rows,) = stored_rows(world, spec, *attack(Identity()))
        assert np.isnan(rows["benchmark_mse_m2"]).all()
        assert np.isnan(rows["benchmark_plr"]).all()
        assert np.isfinite(rows["mse_m2"]).all()


@pytest.fixture(scope="module")
def task_windows():
    return {task: make_task_windows(task) for task in ("rerelease", "handover-1s")}


LINKER = {"rerelease": "shape", "handover-1s": "kinematic"}


def linked_consumers(task, behind):
    """The linker of a task, alone and behind a reconstruction."""
    linker = parsed("attacks", LINKER[task])
    return Consumer("linkage", linker), Consumer(
        "linkage", linker, reconstruction=parsed("attacks", behind)
    )


class TestLinkage:
    @pytest.mark.parametrize("task", LINKER)
    def test_who_smooths_first_learns_on_what_was_shared(self, task_windows, task):
        watching = Spy(requires=frozenset({Knowledge.TRAIN}))
        linked(task_windows[task], Sieve(Clean()), linked_consumers(task, watching)[1])
        assert watching.seen
        for context, *_ in watching.seen:
            train = context.train
            assert train.release.t.size < task_windows[task].probe.t.size
            np.testing.assert_allclose(train.release.xy, train.truth, rtol=0, atol=1e-6)

    def test_what_only_times_tell_is_asked_anew(self, task_windows):
        whole, at_all = linked(task_windows["rerelease"], "raw", "shape", controls=True)
        few, at_none = linked(
            task_windows["rerelease"], "thin:4", "shape", controls=True
        )
        key = "rerelease/control-sample_count", ""
        control = Consumer("control", task="rerelease", control="sample_count")
        assert is_same_at_all_levels(control, at_all)
        assert not is_same_at_all_levels(control, at_none)
        assert not np.array_equal(
            whole[key].searches[0].scores, few[key].searches[0].scores
        )


class TestWindows:
    def frame(self, task_windows, by, stages=STAGES):
        consumer = windows_consumer(task_windows.task.name)
        work = LinkWork(
            task_windows, groups=(), levels=((parsed("mechanisms", by), (consumer,)),)
        )
        ((_, _, reader, tables),) = compute_cells(
            work, tracks=None, stages=stages, seed=0
        )
        assert reader.spec == f"{task_windows.task.name}/windows"
        return tables["rows"].to_pandas()

    @pytest.mark.parametrize(
        "by", ["fixed:0.3,adding=independent", "thin:3,d_sigma=0.3"]
    )
    @pytest.mark.parametrize(("side", "row"), [("probe", 0), ("gallery", 17)])
    def test_a_window_by_hand(self, task_windows, by, side, row):
        task = task_windows["rerelease"]
        stages = StageSettings().changed({"privacy.epsilon_m": 0.6})
        result = self.frame(task, by, stages)
        known = sense_task(task, groups=(), stages=stages, seed=0)
        sensed = known.sensed[("probe", "gallery").index(side)]
        windows = getattr(task, side)
        shared = share(
            parsed("mechanisms", by), sensed, "linkage", "rerelease", side, seed=0
        )
        release, samples = shared[row], slice(*shared.offsets[row : row + 2])
        window = slice(*windows.offsets[row : row + 2])
        t, xy = windows.t[window], windows.xy[window]
        held = np.isin(t, release.t)
        person, length_m = (
            windows.person[row],
            sum(np.hypot(*(b - a)) for a, b in pairwise(xy)),
        )
        leaked = privacy.leakage_indicator(
            shared_xy=release.xy, true_xy=xy[held], epsilon_m=0.6
        )
        exposed = privacy.exposure(leaked=leaked, t=release.t, offsets=release.offsets)
        context = AttackContext(
            rng=stream(0, "test"), epsilon_m=0.6, granted=frozenset()
        )
        after = RadialRTS().fit(context)(shared.without_sigma())
        after_xy = after.xy[samples]
        leaked = privacy.leakage_indicator(
            shared_xy=after_xy, true_xy=xy[held], epsilon_m=0.6
        )
        left = privacy.exposure(leaked=leaked, t=release.t, offsets=release.offsets)
        assert result[result["side"] == side].iloc[row].to_dict() == {
            "side": side,
            "search": task.search_names[windows.search[row]],
            "source": task.source[person],
            "group": task.group[person],
            "n_samples": held.sum(),
            "duration_s": t[-1] - t[0],
            "speed_mps": pytest.approx(length_m / (t[-1] - t[0]), rel=1e-12),
            "sigma_m": pytest.approx(release.sigma.mean()),
            **{name: getattr(exposed, name)[0] for name in ("plr", "ael_s", "mel_s")},
            "plr_attacked": left.plr[0],
            "ael_attacked": pytest.approx(left.ael_s[0]),
            "mel_attacked": pytest.approx(left.mel_s[0]),
            "alignment_error": pytest.approx(aligned(after_xy, xy[held]), abs=1e-6),
            "posterior_std": pytest.approx(after.std[samples].mean()),
        }

    @pytest.mark.parametrize("task", LINKER)
    def test_each_window_of_either_side_has_a_row_and_one_walk_at_every_level(
        self, task_windows, task
    ):
        levels = ("raw", "thin:4", "clean")
        raw, thin, clean = (self.frame(task_windows[task], by) for by in levels)
        sides = {
            side: len(getattr(task_windows[task], side))
            for side in ("probe", "gallery")
        }
        for item in (raw, thin, clean):
            assert tuple(item.columns) == WINDOW_COLUMNS
            assert item["side"].tolist() == [
                side for side, n in sides.items() for _ in range(n)
            ]
            for name in ("source", "search", "duration_s", "speed_mps"):
                assert item[name].tolist() == raw[name].tolist()
        assert (clean["plr"] == 1).all()
        assert (clean["sigma_m"] == 0).all()
        assert (thin["n_samples"] < raw["n_samples"]).all()

    def test_a_walk_of_one_sample_has_no_speed(self, task_windows):
        task = task_windows["rerelease"]
        short = {}
        for side in ("probe", "gallery"):
            windows = getattr(task, side)
            t, xy = (values[windows.offsets[:-1]] for values in (windows.t, windows.xy))
            offsets = np.arange(len(windows) + 1)
            short[side] = Windows(t, xy, offsets, windows.person, windows.search)
        result = self.frame(replace(task, **short), "raw")
        assert result["speed_mps"].isna().all()


def test_the_presets_but_smoke_hold_the_controls():
    controls = [
        item.spec
        for item in plugins.parse_all("mechanisms", DISSOCIATION + PROTECTIONS)
    ]
    for preset in ("paper", "full"):
        bare = Settings(preset=preset, predictors=(), attacks=(), tasks=())
        assert [mechanism.spec for mechanism in expand_axes(bare).mechanisms][
            -len(controls) :
        ] == controls
