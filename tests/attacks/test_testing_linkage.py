"""The attack kit for linkers: honest ones pass it, and each broken one fails the right check."""

import re
import sys
from pathlib import Path
from typing import ClassVar

import broken_attacks
import numpy as np
import pytest
from broken_linkers import BROKEN, Base, Continues, Jitters, Learns, NeedsRepeats

from attacks.testing import (
    CHECKS,
    LINKAGE_CHECKS,
    CheckResult,
    adversaries_of,
    checks_for,
    parametrize_attack_checks,
    run_checks,
)
from attacks.testing import _linkage_cases as cases
from attacks.testing._linkage_kit import hits, log_ranks, rows
from isac_track.errors import PluginError, SettingsError
from isac_track.types import Knowledge


@parametrize_attack_checks([Base(), Learns(), Continues(), Jitters()])
def test_honest_linker(attack, check):
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
    assert {name for _, name, _ in BROKEN} == LINKAGE_CHECKS.keys()


def failed(attack):
    return {result.name: result.message for result in run_checks(attack) if not result.passed}


DOCS = Path(__file__).parents[2] / "docs"
ABOUT_SUCCESS = {"easy_case_beats_chance", "success_falls_with_noise"}


class TestMistakesWithoutEnd:
    """What spoils every run is reported by every check, and ends none."""

    def test_turned_round(self):
        class Turned(Base):
            def link(self, probe, gallery):
                return super().link(probe, gallery).T

        message = failed(Turned())["result_is_a_score_matrix"]
        assert "scores of shape (9, 7), expected (P, G) = (7, 9)" in message
        assert "(turned round?)" in message

    def test_not_finite(self):
        class Lost(Base):
            def link(self, probe, gallery):
                return super().link(probe, gallery) - np.inf

        messages = failed(Lost())
        about_something_else = {"inputs_are_not_mutated", "only_granted_knowledge_is_touched"}
        assert messages.keys() == LINKAGE_CHECKS.keys() - about_something_else
        assert "576 of 576 scores are not finite" in messages["null_stays_at_chance"]

    @pytest.mark.parametrize(
        ("result", "shown"),
        [
            (None, "got NoneType"),
            ("same", "got str"),
            ([[1.0], [2.0, 3.0]], "got list"),
            (np.full((7, 9), 1j), "got an array of complex128"),
        ],
    )
    def test_no_real_numbers(self, result, shown):
        class Odd(Base):
            def link(self, probe, gallery):
                del probe, gallery
                return result

        message = failed(Odd())["order_of_tracks_does_not_matter"]
        assert "expected real numbers of shape (P, G) = (7, 9), " + shown in message

    def test_leaving(self):
        class Leaves(Base):
            def fit(self, context):
                del context
                sys.exit("enough")

        assert "fit(context) raised SystemExit: enough" in failed(Leaves())["null_stays_at_chance"]

    def test_nothing_to_call(self):
        class Eager(Base):
            def fit(self, context):
                del context

        message = failed(Eager())["null_stays_at_chance"]
        assert "fit must return a function from two releases, probe and gallery, to a" in message

    def test_the_other_kind(self):
        class Reconstructs(broken_attacks.Base):
            kind = "linkage"

        class Links(Base):
            kind = "reconstruction"

        message = failed(Reconstructs())["null_stays_at_chance"]
        assert message.endswith("to a matrix of scores: which `kind` is the attack?")
        message = failed(Links())["null_stays_at_chance"]
        assert message.endswith("from a release to a reconstruction: which `kind` is the attack?")


class TestMoreMistakes:
    def test_the_wrong_sign(self):
        class Distance(Base):
            def link(self, probe, gallery):
                return -super().link(probe, gallery)

        messages = failed(Distance())
        assert messages.keys() == ABOUT_SUCCESS
        assert "is the sign right?" in messages["easy_case_beats_chance"]

    def test_one_score_for_all(self):
        class Shrugs(Base):
            def link(self, probe, gallery):
                return 0.0 * super().link(probe, gallery)

        messages = failed(Shrugs())
        assert messages.keys() == ABOUT_SUCCESS
        assert "1 of 24 mates come first, expected at least 6" in messages["easy_case_beats_chance"]

    def test_frames_where_the_scene_may_be_shown_or_not(self):
        class AlwaysContinues(Continues):
            requires: ClassVar[frozenset[Knowledge]] = frozenset()
            uses = frozenset({Knowledge.SCENE})

        messages = failed(AlwaysContinues())
        assert "frames_and_clocks_do_not_matter" in messages
        assert all("AlwaysContinues as blind (granted nothing)" in one for one in messages.values())

    def test_repeats_are_nobodys(self):
        class Hopes(Base):
            def fit(self, context):
                assert context.repeats
                return super().fit(context)

        assert "REPEATS was not granted" in failed(Hopes())["only_granted_knowledge_is_touched"]

    def test_knowledge_that_is_missing_from_one_adversary_only(self):
        class Half(Base):
            uses = frozenset({Knowledge.TRAIN, Knowledge.SIGMA})

            def link(self, probe, gallery):
                assert probe.sigma.min() > 0
                return super().link(probe, gallery)

            def fit(self, context):
                return self.link if context.granted == {Knowledge.TRAIN} else super().link

        (message,) = failed(Half()).values()
        assert "Half as informed (granted TRAIN)" in message


class TestWhatIsFair:
    def test_both_scene_shown_and_hidden(self):
        class Both(Base):
            uses = frozenset({Knowledge.SCENE})

            def fit(self, context):
                if Knowledge.SCENE in context.granted:
                    return Continues().fit(context)
                return super().fit(context)

        assert failed(Both()) == {}
        assert [row.scene for row in rows(Both())] == [False, True]
        assert adversaries_of(Both()) == ("blind",)

    def test_any_scale(self):
        class Small(Base):
            def link(self, probe, gallery):
                return 1e-200 * super().link(probe, gallery) - 1e-195

        assert failed(Small()) == {}


class TestMeasures:
    SCORES = np.array([[3.0, 2.0, 1.0], [1.0, 1.0, 1.0], [0.0, 5.0, 5.0]])

    def test_hits_are_shared_among_equals(self):
        assert hits(self.SCORES, np.array([0, 2, 1])) == pytest.approx(1 + 1 / 3 + 1 / 2)
        assert hits(self.SCORES, np.array([1, 0, 0])) == pytest.approx(1 / 3)

    def test_a_mate_is_in_the_middle_of_its_equals(self):
        np.testing.assert_allclose(
            np.exp(log_ranks(self.SCORES, np.array([2, 0, 2]))), [3.0, 2.0, 1.5]
        )


class TestCases:
    @pytest.mark.parametrize("scene", [False, True])
    def test_noise_is_as_announced(self, scene):
        for sigma_m in (0.3, 10.0):
            less, more = (
                cases.noisy(size, "isotropic", scene=scene) for size in (sigma_m, 2 * sigma_m)
            )
            for side in ("probe", "gallery"):
                gap = getattr(more, side).xy - getattr(less, side).xy
                rms = np.sqrt(np.mean(gap**2))
                assert rms == pytest.approx(sigma_m, rel=0.05)
            np.testing.assert_allclose(less.train.gallery.sigma, sigma_m)
            assert less.mechanism.d_sigma == pytest.approx(sigma_m - 0.05)

    def test_walks_are_those_of_people(self):
        case = cases.noisy(0.05, "radial", scene=False)
        speeds = []
        for track in case.probe:
            steps = np.diff(track.t)
            assert 8.0 - 1e-6 <= 1 / steps.max() < 1 / steps.min() <= 16.0 + 1e-6
            assert track.t[-1] - track.t[0] == pytest.approx(12.0, abs=1.0)
            speeds.append(Base().trait(track))
        assert np.min(speeds) == pytest.approx(0.6, abs=0.1)
        assert np.max(speeds) == pytest.approx(2.0, abs=0.2)
        assert np.diff(np.sort(speeds)).max() < 0.2

    def test_hidden_walks_are_recorded_twice_each_in_a_frame_of_its_own(self):
        case = cases.noisy(0.05, "radial", scene=False)
        for track, mate in zip(case.probe, case.mate, strict=True):
            other = case.gallery[mate]
            # The same walk: turned and shifted upon each other they differ by the noise alone.
            at = track.t[-1] - other.t[-1]
            shared_t = np.linspace(track.t[0] + 1.0, track.t[-1], 100)
            one = complexes(track.t, track.xy, shared_t)
            two = complexes(other.t + at, other.xy, shared_t)
            turn = np.vdot(two, one) / abs(np.vdot(two, one))
            assert np.sqrt(np.mean(abs(one - turn * two) ** 2)) < 0.1
            assert abs(turn - 1) > 1e-3
            assert np.hypot(*(track.xy[-1] - other.xy[-1])) > 0.1

    def test_a_shown_walk_goes_on_after_the_gap(self):
        case = cases.noisy(0.05, "radial", scene=True)
        ends = {float(track.t[-1]) for track in case.probe}
        assert len({round(end, 6) for end in ends}) == 1
        for track, mate in zip(case.probe, case.mate, strict=True):
            other = case.gallery[mate]
            silence_s = other.t[0] - track.t[-1]
            assert 1.0 < silence_s <= 1.125 + 1e-9
            assert np.hypot(*(other.xy[0] - track.xy[-1])) / silence_s < 3.0

    def test_the_training_set_is_other_people_made_alike(self):
        case = cases.noisy(0.05, "radial", scene=False)
        train = case.train
        assert (len(train.probe), len(train.gallery)) == (20, 20)
        assert sorted(train.mate) == list(range(20))
        assert not np.isin(train.probe.xy, case.probe.xy).any()
        own = Base().link(train.probe, train.gallery)
        assert hits(own, train.mate) > 6

    def test_mates_are_not_where_the_probes_are(self):
        case = cases.noisy(0.05, "radial", scene=False)
        assert sorted(case.mate) == list(range(24))
        assert np.count_nonzero(case.mate == np.arange(24)) < 5
        assert cases.sized(9, 7, scene=False).mate.tolist().count(-1) == 2

    def test_null_people_are_not_in_the_gallery(self):
        for scene in (False, True):
            case = cases.unrelated(scene=scene)
            assert hits(Base().link(case.probe, case.gallery), case.mate) < 6
            assert (case.mate.min() >= 0) & (case.mate.max() < 24)

    def test_without_mates(self):
        case = cases.without_mates(cases.ordinary(scene=False))
        train, whole = case.train, cases.ordinary(scene=False).train
        assert np.flatnonzero(train.mate < 0).tolist() == list(range(0, 20, 3))
        assert (len(train.probe), len(train.gallery)) == (20, 16)
        for row in np.flatnonzero(train.mate >= 0):
            np.testing.assert_array_equal(
                train.gallery[int(train.mate[row])].xy, whole.gallery[int(whole.mate[row])].xy
            )
        back = cases.with_others_reordered(case).train
        np.testing.assert_array_equal(back.gallery[0].xy, train.gallery[15].xy)
        np.testing.assert_array_equal(
            back.gallery[int(back.mate[1])].xy, train.gallery[int(train.mate[1])].xy
        )

    def test_changed_cases_change_what_they_say(self):
        case = cases.ordinary(scene=False)
        other = cases.reordered(case, [6, 5, 4, 3, 2, 1, 0], [8, 7, 6, 5, 4, 3, 2, 1, 0])
        np.testing.assert_array_equal(other.probe[0].xy, case.probe[6].xy)
        np.testing.assert_array_equal(
            other.gallery[int(other.mate[0])].xy, case.gallery[int(case.mate[6])].xy
        )
        renamed = cases.renamed(case)
        assert set(renamed.probe.pseudonym) <= set(renamed.gallery.pseudonym)
        assert not set(renamed.gallery.pseudonym) & set(case.gallery.pseudonym)
        elsewhere = cases.in_other_frames(case)
        for one, two in zip(case.train.gallery, elsewhere.train.gallery, strict=True):
            np.testing.assert_allclose(np.diff(one.t), np.diff(two.t), atol=1e-9)
            np.testing.assert_allclose(
                np.hypot(*np.diff(one.xy, axis=0).T), np.hypot(*np.diff(two.xy, axis=0).T)
            )
            assert np.hypot(*(one.xy[0] - two.xy[0])) > 0.1
        assert cases.without_sigma(case).train.probe.sigma is None

    def test_irregular_steps_cover_the_range(self):
        case = cases.irregular(scene=False)
        step_s = np.concatenate([np.diff(track.t) for track in case.gallery])
        assert step_s.min() < 0.01
        assert 10.0 < step_s.max() <= 30.0 + 1e-9


def complexes(t, xy, at):
    """Positions at other instants about their mean, as complex numbers."""
    found = np.interp(at, t, xy[:, 0]) + 1j * np.interp(at, t, xy[:, 1])
    return found - found.mean()


class TestKinds:
    def test_checks_go_by_the_kind(self):
        assert list(checks_for(Base())) == list(LINKAGE_CHECKS)
        assert list(checks_for(broken_attacks.Base())) == list(CHECKS)
        assert [one.name for one in run_checks(Base())] == list(LINKAGE_CHECKS)
        ids = [
            case.id
            for case in parametrize_attack_checks([Jitters(0.1), broken_attacks.Base()]).mark.args[
                1
            ]
        ]
        assert ids == [
            *(f"Jitters(sigma=0.1)-{name}" for name in LINKAGE_CHECKS),
            *(f"Base-{name}" for name in CHECKS),
        ]

    def test_by_name(self):
        (one,) = run_checks(Base(), names=["null_stays_at_chance"])
        assert one == CheckResult("null_stays_at_chance", "passed")
        with pytest.raises(SettingsError, match="of a linkage attack; did you mean 'frames_and_cl"):
            run_checks(Base(), names=["frame_and_clock_do_not_matter"])

    def test_rows_are_those_of_tasks_that_show_what_it_requires(self):
        assert adversaries_of(Base()) == ("blind",)
        assert adversaries_of(Continues()) == ("blind",)
        assert adversaries_of(Learns()) == ("blind", "informed", "oracle")
        assert adversaries_of(broken_attacks.OneFrameForAll()) == ("oracle",)
        granted = [row.granted for row in rows(Learns())]
        assert granted[1:] == [Learns.uses - {Knowledge.SIGMA}, Learns.uses]

    def test_the_scene_is_a_reason_to_skip(self):
        (skipped,) = [one for one in run_checks(Continues()) if not one.passed]
        assert (skipped.name, skipped.status) == ("frames_and_clocks_do_not_matter", "skipped")

    def test_what_cannot_be(self):
        class Odd(Base):
            kind = "linking"

        with pytest.raises(PluginError, match='attack Odd: kind must be "reconstruction" or "li'):
            run_checks(Odd())
        with pytest.raises(PluginError, match="requires REPEATS, which nobody who links is grant"):
            parametrize_attack_checks([NeedsRepeats()])

    def test_every_check_states_what_it_shows(self):
        first = [(check.__doc__ or "").splitlines()[0] for check in LINKAGE_CHECKS.values()]
        assert all(line.endswith(".") for line in first)

    def test_every_check_is_in_the_guide(self):
        guide = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
        assert [name for name in LINKAGE_CHECKS if f"`{name}`" not in guide] == []
