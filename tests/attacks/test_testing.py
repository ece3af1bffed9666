"""The attack kit: the built-in attacks pass it, and each broken one fails the right check."""

import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from broken_attacks import BROKEN, Base

from attacks.testing import CHECKS, CheckResult, parametrize_attack_checks, run_checks
from attacks.testing import _cases as cases
from attacks.testing._releases import BOX_M, RAW_SIGMA_M, Motion
from isac_track import plugins as registry
from isac_track.errors import PluginError, SettingsError
from isac_track.types import Knowledge, Reconstruction

BUILT_IN = [
    registry.parse("attacks", name)[0].instance
    for name, origin in registry.names("attacks").items()
    if origin.startswith("attacks.reconstruction.")
]
DOCS = Path(__file__).parents[2] / "docs" / "attacks.md"


@parametrize_attack_checks(BUILT_IN)
def test_built_in_attack(attack, check):
    check(attack)


@pytest.mark.parametrize(
    ("broken", "name", "message"), [pytest.param(*case, id=case[0].__name__) for case in BROKEN]
)
def test_a_mistake_fails_the_one_check_about_it(broken, name, message):
    failed = [result for result in run_checks(broken()) if result.status == "failed"]
    assert [result.name for result in failed] == [name]
    pattern = re.escape(message).replace(r"\.\*", ".*")
    assert re.search(pattern, failed[0].message)
    assert f"{broken.__name__} as " in failed[0].message


def test_every_check_catches_a_mistake():
    assert {name for _, name, _ in BROKEN} == CHECKS.keys()


@dataclass(frozen=True)
class Jitters(Base):
    """Draws, from the stream that it was given."""

    sigma_m: float = 0.05

    def fit(self, context):
        return lambda release: Reconstruction(
            release.xy + context.rng.normal(0.0, self.sigma_m, release.xy.shape)
        )


def failed(attack):
    return {result.name: result.message for result in run_checks(attack) if not result.passed}


class TestMistakesWithoutEnd:
    """What spoils every run is reported by every check, and ends none."""

    def test_the_wrong_number_of_positions(self):
        class Short(Base):
            def positions(self, release):
                return release.xy[1:] if len(release.xy) > 1 else np.zeros((2, 2))

        messages = failed(Short())
        about_something_else = {"inputs_are_not_mutated", "only_granted_knowledge_is_touched"}
        assert messages.keys() == CHECKS.keys() - about_something_else
        assert "shape (271, 2), expected (272, 2)" in messages["result_is_a_reconstruction"]

    def test_not_finite(self):
        class Lost(Base):
            def track(self, track):
                return track.xy * np.nan

        class LostAndBare(Lost):
            def fit(self, context):
                del context
                return self.positions

        messages = failed(Lost())
        assert messages.keys() == CHECKS.keys()
        assert "ValueError: a reconstructed position is not finite" in next(iter(messages.values()))
        message = failed(LostAndBare())["null_stays_at_chance"]
        assert "3096 of 3096 positions are not finite" in message

    def test_nothing_to_call(self):
        class Eager(Base):
            def fit(self, context):
                del context

        assert "fit must return a function" in failed(Eager())["null_stays_at_chance"]

    def test_leaving(self):
        class Leaves(Base):
            def fit(self, context):
                del context
                sys.exit("enough")

        assert "fit(context) raised SystemExit: enough" in failed(Leaves())["null_stays_at_chance"]

    def test_nothing_returned(self):
        class Silent(Base):
            def fit(self, context):
                del context
                return print

        message = failed(Silent())["short_tracks_are_handled"]
        assert "positions of shape (), expected (1, 2)" in message

    def test_no_numbers(self):
        class Wordy(Base):
            def positions(self, release):
                return [["here", "there"]] * len(release.xy)

            def fit(self, context):
                del context
                return self.positions

        message = failed(Wordy())["null_stays_at_chance"]
        assert "expected a Reconstruction, got list" in message

    def test_writing_to_the_release(self):
        class Writes(Base):
            def positions(self, release):
                release.xy[:] = 0.0
                return release.xy

        message = failed(Writes())["inputs_are_not_mutated"]
        assert re.search(r"read-only \(test_testing\.py, line \d+\)$", message)


class TestMoreMistakes:
    def test_std_that_comes_and_goes(self):
        class Moody(Base):
            def fit(self, context):
                del context
                return lambda release: Reconstruction(
                    release.xy,
                    np.ones(len(release.t)) if release.pseudonym[0] < "p" else None,
                )

        assert failed(Moody()).keys() == {"pseudonyms_do_not_matter"}
        assert "differ by inf m" in failed(Moody())["pseudonyms_do_not_matter"]

    def test_knowledge_that_is_missing_from_one_adversary_only(self):
        class Half(Base):
            uses = frozenset({Knowledge.TRAIN, Knowledge.REPEATS})

            def fit(self, context):
                if Knowledge.TRAIN in context.granted:
                    assert context.repeats
                return super().fit(context)

        (message,) = failed(Half()).values()
        assert "Half as informed (granted TRAIN)" in message

    def test_a_fault_of_its_own_is_not_blamed_on_knowledge(self):
        class Fails(Base):
            def fit(self, context):
                del context
                raise RuntimeError("of its own")

        message = failed(Fails())["only_granted_knowledge_is_touched"]
        assert "RuntimeError: of its own" in message
        assert "given all knowledge" not in message


class TestWhatIsFair:
    def test_drawing_from_the_stream_given(self):
        assert failed(Jitters()) == {}

    def test_but_not_more_of_it_in_another_frame(self):
        class Leans(Jitters):
            def fit(self, context):
                return lambda release: Reconstruction(
                    release.xy
                    + context.rng.normal(0.0, 0.05, release.xy.shape)
                    * (1.0 + 10.0 * (release.t[:1] > 100.0))
                )

        assert failed(Leans()).keys() == {"frame_and_clock_do_not_matter"}
        (message,) = failed(Leans()).values()
        assert "two seeds differ by" in message

    def test_scene_exempts_from_another_frame_as_long_as_it_is_granted(self):
        class KnowsWalls(Base):
            requires = frozenset({Knowledge.SCENE})

            def track(self, track):
                return np.round(track.xy, 1)

        (skipped,) = [one for one in run_checks(KnowsWalls()) if not one.passed]
        assert (skipped.name, skipped.status) == ("frame_and_clock_do_not_matter", "skipped")
        assert "granted SCENE in every row" in skipped.message

        class WantsWalls(KnowsWalls):
            requires: ClassVar[frozenset[Knowledge]] = frozenset()
            uses = frozenset({Knowledge.SCENE})

        (message,) = failed(WantsWalls()).values()
        assert "WantsWalls as blind" in message


class TestCases:
    def test_noise_is_as_announced(self):
        for sigma_m, law, square in ((0.3, "radial", 1.0), (1.0, "isotropic", 2.0)):
            case = cases.noisy(sigma_m, law)
            gap = case.release.xy - case.truth
            mean = np.mean((gap**2).sum(axis=1)) / square
            assert np.sqrt(mean) == pytest.approx(sigma_m, rel=0.05)
            np.testing.assert_allclose(case.release.sigma, sigma_m)
            assert case.mechanism.d_sigma == pytest.approx(sigma_m - RAW_SIGMA_M)

    def test_levels_differ_in_the_size_of_the_errors_alone(self):
        low, high = cases.noisy(0.3, "isotropic"), cases.noisy(3.0, "isotropic")
        np.testing.assert_array_equal(low.truth, high.truth)
        np.testing.assert_allclose(
            10.0 * (low.release.xy - low.truth), high.release.xy - high.truth, atol=1e-9
        )

    def test_walks_are_those_of_people(self):
        case = cases.noisy(0.05, "radial")
        sizes = np.diff(case.release.offsets)
        assert (sizes.min(), sizes.max(), len(sizes)) == (60, 198, 24)
        steps, speeds = [], []
        for first, end in zip(case.release.offsets[:-1], case.release.offsets[1:], strict=True):
            step_s = np.diff(case.release.t[first:end])
            steps.append(step_s)
            speeds.append(np.hypot(*np.diff(case.truth[first:end], axis=0).T) / step_s)
        rate_hz = 1 / np.concatenate(steps)
        assert rate_hz.min() >= 8.0 - 1e-9
        assert rate_hz.max() <= 16.0 + 1e-9
        assert 0.8 < np.mean(np.concatenate(speeds)) < 1.4

    def test_acceleration_is_as_announced(self):
        # Velocity gains q dt of variance per axis: look at long steps, where it dominates.
        case = cases.made_up("test", about="", sizes=(4000,), sigma_m=0.3, sampling="irregular")
        step_s = np.diff(case.release.t)
        velocity = np.diff(case.truth, axis=0) / step_s[:, None]
        # Mean velocities of two neighbouring steps differ by q (dt1 + dt2) / 3 of variance.
        scaled = np.diff(velocity, axis=0) ** 2 / ((step_s[1:] + step_s[:-1]) / 3)[:, None]
        assert scaled.mean() == pytest.approx(cases.ACCELERATION, rel=0.05)

    def test_irregular_steps_cover_the_range(self):
        step_s = np.diff(cases.irregular().release[0].t)
        assert step_s.min() < 0.01
        assert step_s.max() > 10.0
        assert step_s.max() <= 30.0

    def test_other_people_and_repeats_are_what_they_should_be(self):
        case = cases.noisy(0.3, "radial")
        assert len(case.repeats) == 2
        errors = [case.release.xy - case.truth, *(one.xy - case.truth for one in case.repeats)]
        for one, other in ((0, 1), (0, 2), (1, 2)):
            product = (errors[one] * errors[other]).sum(axis=1)
            assert abs(product.mean()) < 5 * product.std() / np.sqrt(product.size)
            assert np.any(errors[one] != errors[other])
        assert not np.isin(case.train.truth, case.truth).any()

    def test_null_truth_has_nothing_to_do_with_the_release(self):
        case = cases.unrelated()
        assert abs(np.corrcoef(case.release.xy[:, 0], case.truth[:, 0])[0, 1]) < 0.1
        assert np.abs(case.truth).max() <= BOX_M / 2
        gap = np.hypot(*(case.release.xy - case.truth).T)
        assert np.mean(gap < 3.0) == pytest.approx(np.pi * 9 / 400, rel=0.2)

    def test_motion_is_rigid(self):
        motion = Motion(angle_rad=0.5 * np.pi, shift_m=(10.0, 20.0), clock_s=3.0)
        np.testing.assert_allclose(motion.of_points(np.array([[1.0, 0.0]])), [[10.0, 21.0]])

    def test_changed_cases_change_what_they_say(self):
        case = cases.ordinary()
        changed, origin = cases.reordered(case, [7, 6, 5, 4, 3, 2, 1, 0])
        np.testing.assert_array_equal(changed.release[0].xy, case.release[7].xy)
        np.testing.assert_array_equal(changed.repeats[1][7].t, case.repeats[1][0].t)
        np.testing.assert_array_equal(changed.truth, case.truth[origin])
        assert changed.release.pseudonym == case.release.pseudonym[::-1]
        renamed = cases.renamed(case).release.pseudonym
        assert not set(renamed) & set(case.release.pseudonym)
        assert np.argmin(renamed) != np.argmin(case.release.pseudonym)
        assert cases.without_sigma(case).repeats[0].sigma is None


class TestRunning:
    def test_results_come_in_order_and_by_name(self):
        assert [one.name for one in run_checks(BUILT_IN[0])] == list(CHECKS)
        (one,) = run_checks(BUILT_IN[0], names=["null_stays_at_chance"])
        assert one == CheckResult("null_stays_at_chance", "passed")

    def test_a_wrong_name_is_answered_with_the_nearest(self):
        with pytest.raises(SettingsError, match="did you mean 'null_stays_at_chance'"):
            run_checks(BUILT_IN[0], names=["nul_stays_at_chance"])
        with pytest.raises(SettingsError, match="known: result_is_a_reconstruction, "):
            run_checks(BUILT_IN[0], names=["xyzzy"])

    def test_every_check_states_what_it_shows(self):
        assert all((check.__doc__ or "").splitlines()[0].endswith(".") for check in CHECKS.values())

    def test_every_check_is_in_the_guide(self):
        guide = DOCS.read_text(encoding="utf-8")
        assert [name for name in CHECKS if f"`{name}`" not in guide] == []

    def test_pytest_is_not_needed(self, tmp_path):
        code = "import sys, attacks.testing; sys.exit('pytest' in sys.modules)"
        assert run_python(tmp_path, "-c", code).returncode == 0


@dataclass
class Thawed:
    def fit(self, context): ...


@dataclass(frozen=True)
class Idle:
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()


@dataclass(frozen=True)
class Undeclared:
    def fit(self, context): ...


@dataclass(frozen=True)
class Listing(Base):
    uses: ClassVar[list[Knowledge]] = [Knowledge.TRAIN]


class TestWhatIsNoAttack:
    @pytest.mark.parametrize(
        ("attack", "message"),
        [
            (Jitters, r"got its class: write Jitters\(\)"),
            (Undeclared(), "Undeclared needs a class attribute requires: a frozenset"),
            (Listing(), r"Listing needs a class attribute uses: .*, got \[<Knowledge.TRAIN"),
            (Idle(), r"Idle has no method fit\(context\)"),
            (Thawed(), "Thawed must be a frozen dataclass"),
            (object(), "object must be a frozen dataclass"),
            (None, "NoneType must be a frozen dataclass"),
        ],
    )
    def test_is_answered_with_what_to_write(self, attack, message):
        with pytest.raises(PluginError, match=message):
            parametrize_attack_checks([attack])
        with pytest.raises(PluginError, match=message):
            run_checks(attack)

    def test_one_attack_without_a_list(self):
        with pytest.raises(PluginError, match="expected a list of attacks"):
            parametrize_attack_checks(Jitters())

    def test_an_empty_list(self):
        with pytest.raises(SettingsError, match="the list is empty"):
            parametrize_attack_checks([])


def ids(attacks):
    return [case.id for case in parametrize_attack_checks(attacks).mark.args[1]]


class TestWithPytest:
    def test_ids_name_attack_and_check(self):
        assert ids([Jitters()]) == [f"Jitters-{name}" for name in CHECKS]
        assert ids([Jitters(), replace(Jitters(), sigma_m=0.1)])[-1] == (
            "Jitters(sigma_m=0.1)-success_falls_with_noise"
        )

    @pytest.fixture
    def folder(self, tmp_path):
        (tmp_path / "test_mine.py").write_text(
            "from broken_attacks import AcrossTracks\n"
            "from attacks.reconstruction.averaging import Averaging\n"
            "from attacks.testing import parametrize_attack_checks\n\n\n"
            "@parametrize_attack_checks([AcrossTracks(), Averaging()])\n"
            "def test_attack(attack, check):\n"
            "    check(attack)\n",
            encoding="utf-8",
        )
        tests = Path(__file__).parents[1]
        (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {tests}\n", encoding="utf-8")
        return tmp_path

    def test_checks_are_tests_of_their_own(self, folder):
        done = run_python(folder, "-m", "pytest", "-rsf", "-p", "no:cacheprovider")
        assert done.returncode == 1
        last = done.stdout.splitlines()[-1]
        assert f"1 failed, {2 * len(CHECKS) - 2} passed, 1 skipped" in last
        assert "test_attack[AcrossTracks-order_of_tracks_does_not_matter]" in done.stdout
        assert "tracks in another order: positions or std differ by" in done.stdout
        assert "granted SCENE in every row" in done.stdout

    def test_one_check_is_chosen_by_name(self, folder):
        words = ["-m", "pytest", "-v", "-p", "no:cacheprovider", "-k", "null_stays_at_chance"]
        done = run_python(folder, *words)
        assert done.returncode == 0
        assert "test_attack[Averaging-null_stays_at_chance] PASSED" in done.stdout
        assert f"2 passed, {2 * len(CHECKS) - 2} deselected" in done.stdout


def run_python(folder, *arguments):
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
