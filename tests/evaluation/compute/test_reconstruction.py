"""What an attack is shown of a block, what it is not, and what its rows say."""

import sys
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from helpers.bad_plugins import spoilt
from helpers.cells import EPSILON_M, SlowSpy, Spy, World, parsed, plugin
from helpers.runs import stored_rows
from helpers.small_runs import smoke

import evaluation
from attacks.reconstruction.kalman_rts import KalmanRTS
from evaluation.compute import reconstruction
from evaluation.compute.reconstruction import draw_halves
from evaluation.compute.walk_bounds import benchmark
from evaluation.plan.scene_axes import SceneAxes
from isac_track.errors import DataError, PluginError
from isac_track.plugins import Plugin
from isac_track.protocols import grants
from isac_track.rng import stream
from isac_track.sensing import fisher_information_density
from isac_track.sharing import Clean, Fixed, Raw
from isac_track.types import Knowledge, Reconstruction, Sensed

N_SCENES = 12
SINGLE_PASS = 3
"""Scenes whose four agents each are the twelve people, once."""
MECHANISM, SIGMA, TRAIN, SCENE, REPEATS = (
    Knowledge[name] for name in ("MECHANISM", "SIGMA", "TRAIN", "SCENE", "REPEATS")
)


def computed(tracks, *attacks, mechanisms=("raw",), n_scenes=N_SCENES, size=None):
    """Rows of every cell of scenes by (mechanism, consumer, adversary), in blocks."""
    attacks = tuple(parsed("attacks", attack) for attack in attacks)
    consumers = SceneAxes(attacks=attacks).consumers
    result = {}
    for level, consumer, rows in World(tracks, n_scenes=n_scenes).cells(
        mechanisms, consumers, size=size
    ):
        result.setdefault((level.spec, consumer.spec, consumer.adversary), []).append(
            rows
        )
    return result


def assert_same(a, b, rows=slice(None)):
    """All that `b` holds is in `a`, of which these are the rows."""
    for name, values in b.items():
        np.testing.assert_array_equal(a[name][rows], values, err_msg=name)


def in_groups(tracks, n_groups):
    return replace(
        tracks, group=tuple(f"g{row % n_groups}" for row in range(len(tracks)))
    )


def lengths(xy, offsets):
    """Distances of each track's samples from its first: what no frame changes."""
    return [np.hypot(*(xy[lo:hi] - xy[lo]).T) for lo, hi in pairwise(offsets)]


def test_walking_groups_stay_together_and_are_halved_by_the_seed_alone():
    groups = tuple(f"g{row // 3}" for row in range(33))
    half = draw_halves(groups, seed=0)
    members = {group: set(half[np.array(groups) == group]) for group in groups}
    assert all(len(halves) == 1 for halves in members.values())
    n_groups = [sum(halves == {fold} for halves in members.values()) for fold in (0, 1)]
    assert sorted(n_groups) == [5, 6]
    order = stream(0, "test", "order").permutation(
        33
    )  # that of the tracks does not matter
    turned = draw_halves(tuple(groups[row] for row in order), seed=0)
    assert turned.tolist() == half[order].tolist()
    assert len({tuple(draw_halves(groups, seed=seed)) for seed in range(5)}) > 1
    assert len(set(draw_halves(("g",) * 5, seed=0))) == 1


class TestBlock:
    def test_an_overlap_or_a_walk_that_is_twice_in_a_pass_stops_the_run(
        self, tracks, monkeypatch
    ):
        world = World(tracks, n_scenes=SINGLE_PASS)
        track = np.roll(world.scenes.track, 1)
        track[0] = track[1]
        world.scenes = replace(world.scenes, track=track)
        with pytest.raises(AssertionError, match="a walk occurs twice in one pass"):
            world.attacked()
        # One person of the victims' half, who need not be a victim: their group is
        # enough.
        monkeypatch.setattr(
            reconstruction,
            "_training_people",
            lambda half, *, fold, seed: np.flatnonzero(half == 1 - fold)[-1:],  # noqa: ARG005 - called so
        )
        for n_groups in (12, 4):
            world = World(in_groups(tracks, n_groups), n_scenes=N_SCENES)
            with pytest.raises(
                AssertionError, match="group is among the training people"
            ):
                world.attacked()

    def test_the_walks_are_sensed_anew_for_repeats_alone(self, tracks):
        world = World(tracks, n_scenes=N_SCENES)
        assert world.attacked().sensed_again == ()
        again = world.attacked(repeats=True).sensed_again
        assert len(again) == 2
        for item in again:
            truth = item.xy - item.sigma_raw[:, None] * item.unit_error
            np.testing.assert_allclose(truth, world.scenes.xy, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(item.t, world.scenes.t)
        errors = [item.unit_error[:, 0] for item in (world.sensed, *again)]
        apart = np.corrcoef(errors)[np.triu_indices(len(errors), k=1)]
        assert np.abs(apart).max() < 5 / np.sqrt(errors[0].size)


class TestIdentity:
    def test_its_rows_are_those_as_shared_to_the_last_bit(self, tracks):
        specs = ("raw", "clean", "fid:100", "fixed:0.5", "fixed:0.5,adding=independent")
        result = computed(
            tracks, "identity", mechanisms=specs, n_scenes=2 * SINGLE_PASS
        )
        for spec in specs:
            (shared,), (attacked,) = (
                result[spec, "shared", ""],
                result[spec, "identity", "blind"],
            )
            assert {"plr", "ael_s", "mse_m2", "track", "scene"} <= shared.keys()
            assert shared.pop("speed_mps").shape == shared["plr"].shape  # of the truth
            assert_same(attacked, shared)


class TestWhatIsShown:
    def spied(
        self, tracks, *, granted=(), requires=(), mechanism="fixed:0.5", slow=False
    ):
        """What a spy saw of both halves, as the adversary who is granted so much."""
        spy = (SlowSpy if slow else Spy)(
            requires=frozenset(requires), uses=frozenset(granted)
        )
        computed(tracks, plugin(spy), mechanisms=(mechanism,), n_scenes=SINGLE_PASS)
        seen = [
            item
            for item in spy.seen
            if item[0].granted == frozenset((*granted, *requires))
        ]
        assert len(seen) == 2
        return World(tracks, mechanism=mechanism, n_scenes=SINGLE_PASS), seen

    @pytest.mark.parametrize("granted", [(), (SCENE,), (SIGMA,), (SCENE, SIGMA)])
    def test_scene_and_sigma_show_what_they_say_and_no_more(self, tracks, granted):
        world, seen = self.spied(tracks, requires=granted)
        for fold, (context, release, _) in enumerate(seen):
            xy, t, sigma = (
                getattr(world.release, name)[world.samples(fold)]
                for name in ("xy", "t", "sigma")
            )
            assert context.granted == frozenset(granted)
            if SIGMA in granted:
                np.testing.assert_array_equal(release.sigma, sigma)
            else:
                assert release.sigma is None
            if SCENE in granted:
                np.testing.assert_array_equal(release.xy, xy)
                np.testing.assert_array_equal(release.t, t)
                continue
            # Rigid: the same walks, so that all there is to see is there to be seen.
            truth = lengths(xy, release.offsets)
            for ours, theirs in zip(
                lengths(release.xy, release.offsets), truth, strict=True
            ):
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
            np.testing.assert_allclose(
                np.diff(release.t), np.diff(t), rtol=0, atol=1e-9
            )
            assert np.hypot(*(release.xy - xy).T).min() > 1.0
            assert abs(release.t[0] - t[0]) > 1.0
            last = release.offsets[1] - 1
            shown, true = (
                complex(*(item[last] - item[0])) for item in (release.xy, xy)
            )
            assert abs(np.angle(shown / true)) > 0.01

    @pytest.mark.parametrize("slow", [False, True])
    def test_the_training_set_is_of_other_people(self, tracks, slow):
        world, seen = self.spied(tracks, granted=(TRAIN,), mechanism="clean", slow=slow)
        known = lengths(world.tracks.xy, world.tracks.offsets)
        for fold, (context, release, _) in enumerate(seen):
            train = context.train
            assert train.release.sigma is None
            assert not train.truth.flags.writeable
            taught = [
                row
                for length in lengths(train.truth, train.release.offsets)
                for row, other in enumerate(known)
                if length.shape == other.shape
                and np.allclose(length, other, rtol=0, atol=1e-9)
            ]
            assert sorted(taught) == np.flatnonzero(world.half != fold).tolist()
            # Under clean sharing it is shared as it is, in a frame that is not the
            # victims'.
            np.testing.assert_allclose(train.release.xy, train.truth, rtol=0, atol=1e-9)
            nearest = (
                np.abs(train.truth[:, None] - release.xy[None, ::50]).sum(axis=2).min()
            )
            assert nearest > 1.0

    @pytest.mark.parametrize("mechanism", ["fixed:5", "fixed:5,adding=independent"])
    def test_the_training_set_is_perturbed_by_the_same_mechanism_with_noise_of_its_own(
        self, tracks, mechanism
    ):
        world, seen = self.spied(
            tracks, requires=(TRAIN, SIGMA, SCENE), mechanism=mechanism
        )
        for fold, (context, release, _) in enumerate(seen):
            train, truth = context.train.release, context.train.truth
            other = train.xy - truth
            # The length of a radial error is |N(0, sigma)|; a fresh one makes it a sum
            # of two.
            assert np.mean((np.hypot(*other.T) / train.sigma) ** 2) == pytest.approx(
                1.0, abs=0.1
            )
            assert train.sigma.min() >= 5
            # The noise of the release, by sample number, tells nothing of the training
            # set's.
            error = release.xy - world.scenes.xy[world.samples(fold)]
            n = min(len(error), len(other))
            between = np.corrcoef(error[:n, 0], other[:n, 0])[0, 1]
            assert abs(between) < 5 / np.sqrt(n)

    def test_the_mechanism_is_the_very_object(self, tracks):
        spy = Spy(uses=frozenset({MECHANISM}))
        fixed = Plugin("mine", 0.5, "mine:0.5", "here:Mine", Fixed(0.5))
        computed(tracks, plugin(spy), mechanisms=(fixed,), n_scenes=SINGLE_PASS)
        granted = [context for context, *_ in spy.seen if MECHANISM in context.granted]
        assert len(granted) == 2
        assert all(context.mechanism is fixed.instance for context in granted)

    @pytest.mark.parametrize("granted", [(REPEATS,), (REPEATS, SCENE)])
    def test_repeats_are_the_same_walks_and_instants_with_other_errors(
        self, tracks, granted
    ):
        # Noise of the mechanism's own, far above that of sensing: see above for the
        # latter.
        world, seen = self.spied(
            tracks, requires=granted, mechanism="fixed:9,adding=independent"
        )
        for fold, (context, release, _) in enumerate(seen):
            releases = (release, *context.repeats)
            assert len(context.repeats) == 2
            for repeat in context.repeats:
                np.testing.assert_allclose(
                    np.diff(repeat.t), np.diff(release.t), rtol=0, atol=1e-9
                )
                np.testing.assert_array_equal(repeat.offsets, release.offsets)
                assert repeat.sigma is None
                assert set(repeat.pseudonym).isdisjoint(release.pseudonym)
            clocks = {round(item.t[0], 3) for item in releases}
            assert len(clocks) == (
                1 if SCENE in granted else 3
            )  # or each has one of its own
            if SCENE in granted:
                assert all(
                    np.array_equal(repeat.t, release.t) for repeat in context.repeats
                )
                truth = world.scenes.xy[world.samples(fold)]
                errors = [(item.xy - truth)[:, 0] for item in releases]
                assert np.abs(np.corrcoef(errors)[np.triu_indices(3, k=1)]).max() < 0.1

    def test_its_random_numbers_are_its_own_whatever_else_runs(self, tracks):
        alone, among = (Spy(uses=frozenset({MECHANISM})) for _ in range(2))
        computed(
            tracks, plugin(alone), mechanisms=("raw", "fixed:0.5"), n_scenes=SINGLE_PASS
        )
        others = (
            "moving_average",
            "averaging",
            plugin(Spy(uses=frozenset(Knowledge)), "other"),
        )
        mechanisms = ("clean", "fixed:0.5", "raw")
        computed(
            tracks, *others, plugin(among), mechanisms=mechanisms, n_scenes=SINGLE_PASS
        )
        # The release's first clock, a frame's own, names the level and the half.
        first, second = (
            {
                (context.granted, release.t[0].round(3)): tuple(drawn)
                for context, release, drawn in spy.seen
            }
            for spy in (alone, among)
        )
        assert len(first) == 2 * 2 * 2  # adversaries, levels, halves
        assert first.items() <= second.items()
        assert len(set(first.values())) == 8


QUICK = (
    "identity",
    "moving_average",
    "savgol",
    "kalman_rts",
    "radial_rts",
    "averaging",
)


class Vandal:
    """Overwrites what it is given."""

    requires = frozenset()
    uses = frozenset({TRAIN})

    def fit(self, context):
        if TRAIN in context.granted:
            spoilt(context.train.truth)
            spoilt(context.train.release.xy)

        def reconstruct(release):
            spoilt(release.xy)
            return Reconstruction(release.xy)

        return reconstruct


class TestStrangers:
    """A user's attack gets each walk once per release, and copies of it."""

    def test_no_release_shows_a_walk_twice(self, tracks):
        # Four passes over 12 people: a copy would have the sampling instants of its
        # twin.
        spy = Spy()
        computed(tracks, plugin(spy))
        for _, release, _ in spy.seen:
            rhythms = [tuple(np.diff(track.t).round(9)) for track in release]
            assert len(set(rhythms)) == len(rhythms)
        assert len(spy.seen) == 2 * N_SCENES / SINGLE_PASS
        assert sum(len(release) for _, release, _ in spy.seen) == 4 * N_SCENES
        assert len({round(release.t[0], 3) for _, release, _ in spy.seen}) == len(
            spy.seen
        )

    @pytest.mark.parametrize("name", QUICK)
    def test_the_built_in_attacks_gain_nothing_by_seeing_all_passes_at_once(
        self, tracks, name
    ):
        own = parsed("attacks", name)
        mechanisms = ("fid:1000,adding=independent",)
        result = computed(
            tracks, own, plugin(own.instance, "foreign"), mechanisms=mechanisms
        )
        compared = 0
        for (mechanism, consumer, knowledge), (rows,) in result.items():
            if consumer == "foreign":
                (own_rows,) = result[mechanism, name, knowledge]
                np.testing.assert_allclose(
                    rows["mse_m2"], own_rows["mse_m2"], rtol=1e-6
                )
                np.testing.assert_array_equal(rows["plr"], own_rows["plr"])
                compared += 1
        assert compared == len(grants(own.instance))

    def test_what_one_overwrites_the_next_does_not_see(self, tracks):
        vandal, other = plugin(Vandal(), "vandal"), plugin(KalmanRTS(), "other")
        rest = (other, "kalman_rts", "identity")
        among = computed(tracks, vandal, *rest, mechanisms=("fixed:0.5",))
        for key, (rows,) in computed(tracks, *rest, mechanisms=("fixed:0.5",)).items():
            assert_same(among[key][0], rows)
        # What it overwrote is what it said, and what it is judged by.
        (its_own,) = among["fixed:0.5", "vandal", "blind"]
        assert np.sqrt(its_own["mse_m2"]).min() > 1000.0


def test_positions_elsewhere_in_its_frame_are_found_there_in_the_true_one(tracks):
    """Every other sample backwards through each half: a wrong turn would show."""

    def move(xy):
        is_odd = np.arange(len(xy))[:, None] % 2 == 1
        return np.where(is_odd, xy, xy[::-1])

    # Not clean: about the truth itself a turn of the correction would change no
    # distance.
    spec = "fixed:0.3"
    rows = computed(
        tracks, plugin(Spy(move=move)), mechanisms=(spec,), n_scenes=SINGLE_PASS
    )
    (rows,) = rows[spec, "spy", "blind"]
    world = World(tracks, mechanism=spec, n_scenes=SINGLE_PASS)
    for fold in (0, 1):
        own, half_tracks = world.samples(fold), world.rows(fold)
        square = ((move(world.release.xy[own]) - world.scenes.xy[own]) ** 2).sum(axis=1)
        parts = np.split(
            square, np.cumsum(np.diff(world.scenes.offsets)[half_tracks])[:-1]
        )
        np.testing.assert_allclose(
            rows["mse_m2"][half_tracks], [part.mean() for part in parts], rtol=1e-9
        )
        leaked = [np.mean(part < EPSILON_M**2) for part in parts]
        np.testing.assert_allclose(rows["plr"][half_tracks], leaked, rtol=1e-9)
        assert 0 < np.mean(leaked) < 0.6


@pytest.fixture(scope="module")
def slow_and_quick(tracks):
    """Rows of a slow and of a quick attack, block by block."""
    # 12 people on 4 * 4 seats, two blocks: the second has 4 of them for the first time.
    slow, quick = plugin(SlowSpy(), "slow"), plugin(Spy(), "quick")
    rows = computed(tracks, slow, quick, n_scenes=4, size=2)
    return rows["raw", "slow", "blind"], rows["raw", "quick", "blind"]


class TestSlowAttacks:
    def test_they_see_one_release_of_each_source_track(self, slow_and_quick):
        slow, quick = slow_and_quick
        assert [len(item["track"]) for item in slow] == [8, 4]
        assert sorted(np.concatenate([item["track"] for item in slow])) == list(
            range(12)
        )
        assert [len(item["track"]) for item in quick] == [8, 8]

    def test_their_rows_are_those_of_the_same_walks_in_a_quick_attack(
        self, slow_and_quick
    ):
        for few, all_rows in zip(*slow_and_quick, strict=True):
            place = list(zip(all_rows["scene"], all_rows["agent"], strict=True))
            rows = [
                place.index(item)
                for item in zip(few["scene"], few["agent"], strict=True)
            ]
            assert_same(all_rows, few, rows)


def expected_benchmark(
    mechanism, *, n_samples=1, sigma_raw=0.3, law="radial", step_s=0.1, name="mine"
):
    """What the benchmark expects of one track at the origin: squared error and PLR."""
    t, offsets = step_s * np.arange(float(n_samples)), np.array([0, n_samples])
    information = np.full(n_samples, sigma_raw**-2.0)
    sensed = Sensed(
        t=t,
        xy=np.zeros((n_samples, 2)),
        unit_error=np.zeros((n_samples, 2)),
        sigma_raw=np.full(n_samples, sigma_raw),
        information=information,
        fid=fisher_information_density(information=information, t=t, offsets=offsets),
        offsets=offsets,
        law=law,
    )
    release = mechanism.share(sensed, stream(0, "test", "benchmark"))
    by = plugin(mechanism, name)
    (mse,), (plr,) = benchmark(
        release, sensed=sensed, mechanism=by, epsilon_m=0.3
    ).values()
    return mse, plr


class TestBenchmark:
    """P in closed form: of a single sample, and of a walk too short to turn."""

    @pytest.mark.parametrize(
        ("mechanism", "law", "variance"),
        [
            (Raw(), "radial", 0.09 / 2),
            (Raw(), "isotropic", 0.09),
            (Raw(), "fixed_direction", 0.09 / 2),
            (Fixed(0.5), "radial", 0.64 / 2),
            (Fixed(0.5), "isotropic", 0.64),
            (Fixed(0.4, adding="independent"), "radial", 0.25 / 2),
            (Fixed(0.4, adding="independent"), "isotropic", 0.25),
            (Fixed(0.4, adding="independent", law="isotropic"), "radial", 0.045 + 0.16),
            (Fixed(0.4, adding="independent", law="radial"), "isotropic", 0.09 + 0.08),
        ],
    )
    def test_of_one_sample_it_is_the_error_itself(self, mechanism, law, variance):
        mse, plr = expected_benchmark(mechanism, law=law)
        assert mse == pytest.approx(2 * variance, rel=1e-4)
        assert plr == pytest.approx(1 - np.exp(-(0.3**2) / (2 * variance)), rel=1e-4)

    def test_of_a_short_walk_it_is_that_of_the_line_through_its_samples(self):
        # A line through n samples of variance r: r / n at its middle, 4 r / n at its
        # ends, 2 r / n on average. Per axis r is 2 m^2, on two axes 4; in 0.5 s nobody
        # turns by as much.
        mse, _ = expected_benchmark(Raw(), n_samples=50, step_s=0.01, sigma_raw=2.0)
        assert mse == pytest.approx(4.0 * 2 / 50, rel=0.05)

    @pytest.mark.parametrize("name", ["clean", "here:Clean"])
    def test_what_takes_error_away_is_judged_by_what_it_left_whatever_its_name(
        self, name
    ):
        mse, plr = expected_benchmark(Clean(), n_samples=5, name=name)
        assert mse < 1e-10
        assert plr == 1.0

    def test_it_is_the_same_whatever_was_drawn(self, tracks):
        result = computed(tracks, "identity", "kalman_rts", mechanisms=("raw",))
        results = [
            rows for key, (rows,) in result.items() if key[1] not in {"shared", "bound"}
        ]
        for rows in results[1:]:
            np.testing.assert_array_equal(
                rows["benchmark_mse_m2"], results[0]["benchmark_mse_m2"]
            )
        assert (results[0]["benchmark_mse_m2"] < results[0]["mse_m2"]).all()


@dataclass(frozen=True)
class Bad:
    """Breaks its contract in the way that it is told."""

    fit: object
    requires: frozenset = frozenset()
    uses: frozenset = frozenset({MECHANISM})


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (lambda _: 1 / 0, "failed: ZeroDivisionError: division by zero"),
        (lambda _: sys.exit(3), "failed: SystemExit: 3"),
        (lambda _: None, "failed: TypeError: 'NoneType' object is not callable"),
        (
            lambda _: lambda release: release.xy,
            "must return a Reconstruction with xy .* got",
        ),
        (
            lambda _: lambda _: None,
            "must return a Reconstruction with xy .* got NoneType",
        ),
        (
            lambda _: lambda release: Reconstruction(release.xy[1:]),
            "must return .* with xy",
        ),
        (
            lambda _: lambda release: Reconstruction(release.xy * np.nan),
            "failed: ValueError: a reconstructed position is not finite",
        ),
        (
            lambda context: context.train.truth,
            "failed: KnowledgeDenied: TRAIN was not granted",
        ),
        (
            lambda _: lambda release: release.xy + release.sigma[:, None],
            "failed: TypeError",
        ),
        (
            lambda _: lambda release: release.xy.__setitem__(0, 0),
            "failed: ValueError: assignment dest",
        ),
    ],
)
def test_an_attack_that_breaks_its_contract_is_named_with_its_adversary(
    tracks, how, message
):
    def later(context):
        return how(context) if MECHANISM in context.granted else Spy().fit(context)

    for bad, knowledge in ((how, "blind"), (later, "informed")):
        with pytest.raises(
            PluginError, match=rf"attack mine \({knowledge}\) {message}"
        ):
            computed(tracks, plugin(Bad(bad), "mine"), n_scenes=SINGLE_PASS)


def test_of_one_group_an_attack_that_learns_is_refused_and_the_others_run(tracks):
    crowd = in_groups(tracks, 1)
    block = World(crowd, n_scenes=N_SCENES).attacked()
    (fold,) = (fold for fold, half in enumerate(block.halves) if half.size)
    assert block.training[fold] is None
    with pytest.raises(
        DataError, match=r"'kalman_rts' needs other people .* leave the attack out"
    ):
        computed(crowd, "kalman_rts")
    result = computed(crowd, "identity", "averaging")
    for key in (("raw", "identity", "blind"), ("raw", "averaging", "oracle")):
        assert len(result[key][0]["plr"]) == 4 * N_SCENES


METRICS = ("mse_m2", "plr")


class TestRuns:
    @pytest.fixture
    def settings(self, csv_recording, tmp_path):
        axes = {"mechanisms": ("raw", "fid:1000", "fixed:0.7,adding=independent")}
        axes |= {"predictors": (), "attacks": ("identity", "kalman_rts", "averaging")}
        return smoke(csv_recording, tmp_path / "run", scenes=N_SCENES, **axes)

    def test_it_says_what_is_shared_and_ratios_are_of_sums_over_tracks(self, settings):
        results = evaluation.run(settings, pictures=False)
        keys = ["mechanism", "consumer", "knowledge", "metric"]
        table = results.summary.set_index(keys)["value"].sort_index()
        shared, attacked = (
            results.summary[results.summary["consumer"] == name].set_index(
                ["mechanism", "metric"]
            )
            for name in ("shared", "identity")
        )
        numbers = ["value", "ci_low", "ci_high", "n"]
        assert len(shared) == 3 * 7
        assert attacked.loc[shared.index, numbers].equals(shared[numbers])
        entries = [cell for cell in results.manifest["cells"] if cell.kind == "attack"]
        assert len(entries) == 3 * (1 + 3 + 1)
        for entry in entries:
            address = entry.address
            rows = stored_rows(
                results.out, entry.spec, address.consumer, address.adversary
            )
            said = table[address.mechanism, address.consumer, address.adversary]
            mse, plr = (
                rows[item].sum() / rows[f"benchmark_{item}"].sum() for item in METRICS
            )
            assert said["rmse_over_benchmark"] == pytest.approx(np.sqrt(mse))
            assert said["plr_over_benchmark"] == pytest.approx(plr)
            assert said["rmse"] == pytest.approx(np.sqrt(rows["mse_m2"].mean()))
