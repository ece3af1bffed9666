"""The attack kit: what is built in passes it, and each broken attack fails the right check."""

import re
import sys
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from helpers import broken_attacks, broken_linkers
from helpers.broken_attacks import SIGMA, TRAIN, attack
from helpers.broken_linkers import Continues, Learns, NeedsRepeats, linker
from helpers.processes import ROOT, run_python

from attacks.testing import (
    CHECKS,
    LINKAGE_CHECKS,
    CheckResult,
    _rows,
    adversaries_of,
    checks_for,
    parametrize_attack_checks,
    run_checks,
)
from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.types import Knowledge, Reconstruction

BUILT_IN = [
    plugins.parse("attacks", name)[0].instance
    for name, origin in plugins.names("attacks").items()
    if origin.startswith("attacks.")
]
HONEST = [broken_linkers.Base(), Learns(), Continues(), broken_linkers.Jitters()]
BROKEN = [*broken_attacks.BROKEN, *broken_linkers.BROKEN]
DOCS = ROOT / "docs"
SCENE = frozenset({Knowledge.SCENE})
ABOUT_OTHER_THINGS = {"inputs_are_not_mutated", "only_granted_knowledge_is_touched"}


@parametrize_attack_checks([*BUILT_IN, *HONEST])
def test_what_is_fair_passes(attack, check):
    check(attack)


@pytest.mark.parametrize(
    ("broken", "name", "message"),
    [pytest.param(*case, id=f"{case[0].__name__}-{case[1]}") for case in BROKEN],
)
def test_a_mistake_fails_the_one_check_about_it(broken, name, message):
    failed = [result for result in run_checks(broken()) if result.status == "failed"]
    assert [result.name for result in failed] == [name]
    pattern = re.escape(message).replace(r"\.\*", ".*")
    assert re.search(pattern, failed[0].message)
    assert f"{broken.__name__} as " in failed[0].message


def test_every_check_catches_a_mistake():
    assert {name for _, name, _ in broken_attacks.BROKEN} == CHECKS.keys()
    assert {name for _, name, _ in broken_linkers.BROKEN} == LINKAGE_CHECKS.keys()


@dataclass(frozen=True)
class Jitters(broken_attacks.Base):
    """Draws, from the stream that it was given."""

    sigma_m: float = 0.05

    def fit(self, context):
        return lambda release: Reconstruction(
            release.xy + context.rng.normal(0.0, self.sigma_m, release.xy.shape)
        )


def failed(made):
    """Return the messages of what does not pass, of an attack or the class of one."""
    subject = made() if isinstance(made, type) else made
    return {result.name: result.message for result in run_checks(subject) if not result.passed}


def returning(answer):
    """An attack of which the function from fit is this."""
    return attack(lambda context: answer)  # noqa: ARG005


class TestMistakesWithoutEnd:
    """What spoils every run is reported by every check, and ends none."""

    def test_the_wrong_number_of_positions(self):
        messages = failed(
            attack(lambda release: release.xy[1:] if len(release.t) > 1 else [[0, 0]] * 2)
        )
        assert messages.keys() == CHECKS.keys() - ABOUT_OTHER_THINGS
        assert "shape (271, 2), expected (272, 2)" in messages["result_is_a_reconstruction"]

    def test_positions_that_are_not_finite(self):
        messages = failed(attack(lambda release: release.xy * np.nan))
        assert messages.keys() == CHECKS.keys()
        assert "ValueError: a reconstructed position is not finite" in next(iter(messages.values()))
        message = failed(returning(lambda release: release.xy * np.nan))["null_stays_at_chance"]
        assert "3096 of 3096 positions are not finite" in message

    def test_scores_that_are_not_finite(self):
        messages = failed(
            linker(lambda probe, gallery: np.full((len(probe), len(gallery)), np.nan))
        )
        assert messages.keys() == LINKAGE_CHECKS.keys() - ABOUT_OTHER_THINGS
        assert "576 of 576 scores are not finite" in messages["null_stays_at_chance"]

    def test_scores_turned_round(self):
        turned = linker(lambda probe, gallery: broken_linkers.HONEST.link(probe, gallery).T)
        message = failed(turned)["result_is_a_score_matrix"]
        assert "scores of shape (9, 7), expected (P, G) = (7, 9)" in message
        assert "(turned round?)" in message

    @pytest.mark.parametrize(
        ("result", "shown"),
        [
            (None, "got NoneType"),
            (np.full((7, 9), 1j), "got an array of complex128"),
        ],
    )
    def test_scores_that_are_no_real_numbers(self, result, shown):
        message = failed(linker(lambda probe, gallery: result))["order_of_tracks_does_not_matter"]  # noqa: ARG005
        assert "expected real numbers of shape (P, G) = (7, 9), " + shown in message

    @pytest.mark.parametrize(
        ("answer", "message"),
        [
            (print, "positions of shape (), expected (1, 2)"),
            (lambda release: [["here", "there"]] * len(release.xy), "Reconstruction, got list"),
        ],
    )
    def test_no_positions(self, answer, message):
        assert message in failed(returning(answer))["short_tracks_are_handled"]

    @pytest.mark.parametrize(
        ("make", "gives"),
        [(attack, "a release to a rec"), (linker, "two releases, probe and gallery, to a matrix")],
    )
    def test_nothing_to_call(self, make, gives):
        eager = make(lambda context: 3)  # noqa: ARG005
        message = failed(eager)["null_stays_at_chance"]
        assert f"fit must return a function from {gives}" in message

    @pytest.mark.parametrize("make", [attack, linker])
    def test_leaving(self, make):
        message = failed(make(lambda context: sys.exit("enough")))["null_stays_at_chance"]  # noqa: ARG005
        assert "fit(context) raised SystemExit: enough" in message

    def test_writing_to_the_release(self):
        message = failed(attack(lambda release: release.xy.fill(0.0)))["inputs_are_not_mutated"]
        assert re.search(r"read-only \(test_testing\.py, line \d+\)$", message)

    @pytest.mark.parametrize(
        ("base", "kind", "gives"),
        [
            (broken_attacks.Base, "linkage", "to a matrix of scores"),
            (broken_linkers.Base, "reconstruction", "from a release to a reconstruction"),
        ],
    )
    def test_the_other_kind(self, base, kind, gives):
        message = failed(type("Other", (base,), {"kind": kind}))["null_stays_at_chance"]
        assert message.endswith(f"{gives}: which `kind` is the attack?")


class TestMoreMistakes:
    def test_std_that_comes_and_goes(self):
        def certain(release):
            return np.ones(len(release.t)) if release.pseudonym[0] < "p" else None

        moody = returning(lambda release: Reconstruction(release.xy, certain(release)))
        messages = failed(moody)
        assert messages.keys() == {"pseudonyms_do_not_matter"}
        assert "differ by inf m" in messages["pseudonyms_do_not_matter"]

    def test_knowledge_that_is_missing_from_one_adversary_only(self):
        def half(context):
            if Knowledge.TRAIN in context.granted:
                assert context.repeats

        (message,) = failed(attack(half, uses=TRAIN | {Knowledge.REPEATS})).values()
        assert "half as informed (granted TRAIN)" in message

    def test_repeats_are_not_for_those_who_link(self):
        def hopes(context):
            assert context.repeats

        message = failed(linker(hopes))["only_granted_knowledge_is_touched"]
        assert "REPEATS was not granted" in message

    def test_a_fault_of_its_own_is_not_blamed_on_knowledge(self):
        def fails(context):  # noqa: ARG001
            raise RuntimeError("of its own")

        message = failed(attack(fails))["only_granted_knowledge_is_touched"]
        assert "RuntimeError: of its own" in message
        assert "given all knowledge" not in message

    def test_frames_where_the_scene_may_be_shown_or_not(self):
        always = type("Always", (Continues,), {"requires": frozenset(), "uses": SCENE})
        messages = failed(always)
        assert "frames_and_clocks_do_not_matter" in messages
        assert all("Always as blind (granted nothing)" in one for one in messages.values())


class TestWhatIsFair:
    def test_drawing_from_the_stream_given(self):
        assert failed(Jitters()) == {}

    def test_but_not_more_of_it_in_another_frame(self):
        def leans(context):
            def reconstruct(release):
                drawn = context.rng.normal(0.0, 0.05, release.xy.shape)
                return Reconstruction(release.xy + drawn * (1.0 + 10.0 * (release.t[:1] > 100.0)))

            return reconstruct

        messages = failed(attack(leans))
        assert messages.keys() == {"frame_and_clock_do_not_matter"}
        assert "two seeds differ by" in messages["frame_and_clock_do_not_matter"]

    def test_scene_exempts_from_another_frame_as_long_as_it_is_granted(self):
        def walls(track):
            return np.round(track.xy, 1)

        for knows, check in (
            (attack(walls, requires=SCENE), "frame_and_clock_do_not_matter"),
            (Continues, "frames_and_clocks_do_not_matter"),
        ):
            (skipped,) = [one for one in run_checks(knows()) if not one.passed]
            assert (skipped.name, skipped.status) == (check, "skipped")
            assert "granted SCENE in every row" in skipped.message
        (message,) = failed(attack(walls, uses=SCENE)).values()
        assert "walls as blind" in message

    def test_both_scene_shown_and_hidden(self):
        def both(context):
            return Continues().fit(context) if Knowledge.SCENE in context.granted else None

        made = linker(both, uses=SCENE)()
        assert failed(made) == {}
        assert [row.scene for row in _rows(made)] == [False, True]
        assert adversaries_of(made) == ("blind",)

    def test_any_scale(self):
        link = broken_linkers.HONEST.link
        assert failed(linker(lambda probe, gallery: 1e-200 * link(probe, gallery) - 1e-195)) == {}


class TestRunning:
    @pytest.mark.parametrize(
        ("made", "checks"),
        [(broken_attacks.Base(), CHECKS), (broken_linkers.Base(), LINKAGE_CHECKS)],
    )
    def test_checks_go_by_the_kind_in_order_and_by_name(self, made, checks):
        assert list(checks_for(made)) == [one.name for one in run_checks(made)] == list(checks)
        (one,) = run_checks(made, names=["null_stays_at_chance"])
        assert one == CheckResult("null_stays_at_chance", "passed")

    @pytest.mark.parametrize(
        ("made", "name", "message"),
        [
            (broken_attacks.Base(), "nul_stays_at_chance", "did you mean 'null_stays_at_chance'"),
            (broken_attacks.Base(), "xyzzy", "known: result_is_a_reconstruction, "),
            (
                broken_linkers.Base(),
                "frame_and_clock_do_not_matter",
                "of a linkage attack; did you mean 'frames_and_cl",
            ),
        ],
    )
    def test_a_wrong_name_is_answered_with_the_nearest(self, made, name, message):
        with pytest.raises(SettingsError, match=message):
            run_checks(made, names=[name])

    def test_rows_are_those_of_tasks_that_show_what_it_requires(self):
        assert adversaries_of(broken_linkers.Base()) == ("blind",)
        assert adversaries_of(Continues()) == ("blind",)
        assert adversaries_of(Learns()) == ("blind", "informed", "oracle")
        assert adversaries_of(broken_attacks.one_frame_for_all()) == ("oracle",)
        granted = [row.granted for row in _rows(Learns())]
        assert granted[1:] == [Learns.uses - SIGMA, Learns.uses]

    @pytest.mark.parametrize("checks", [CHECKS, LINKAGE_CHECKS])
    def test_every_check_states_what_it_shows_and_is_in_the_guide(self, checks):
        assert all(check.statement.endswith(".") for check in checks.values())
        guide = "".join(path.read_text(encoding="utf-8") for path in DOCS.glob("*.md"))
        assert [name for name in checks if f"`{name}`" not in guide] == []

    def test_neither_kit_needs_pytest_or_hypothesis(self, tmp_path):
        code = (
            "import sys, attacks.testing, isac_track.testing.__main__\n"
            "sys.exit(', '.join({'pytest', 'hypothesis'} & sys.modules.keys()) or 0)"
        )
        done = run_python(tmp_path, "-c", code)
        assert done.returncode == 0, done.stderr


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
class Listing(broken_attacks.Base):
    uses: ClassVar[list[Knowledge]] = [Knowledge.TRAIN]


class TestWhatIsNoAttack:
    @pytest.mark.parametrize(
        ("attack", "message"),
        [
            (NeedsRepeats(), "requires REPEATS, which nobody who links is grant"),
            (
                type("Odd", (broken_linkers.Base,), {"kind": "linking"})(),
                'attack Odd: kind must be "reconstruction" or "li',
            ),
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
        assert ids([Jitters(), replace(Jitters(), sigma_m=0.1), broken_linkers.Base()]) == [
            *(f"Jitters-{name}" for name in CHECKS),
            *(f"Jitters(sigma_m=0.1)-{name}" for name in CHECKS),
            *(f"Base-{name}" for name in LINKAGE_CHECKS),
        ]

    def test_checks_are_tests_of_their_own(self, pytester):
        pytester.makepyfile(
            "from helpers.broken_attacks import across_tracks\n"
            "from attacks.reconstruction.averaging import Averaging\n"
            "from attacks.testing import parametrize_attack_checks\n\n\n"
            "@parametrize_attack_checks([across_tracks(), Averaging()])\n"
            "def test_attack(attack, check):\n"
            "    check(attack)\n"
        )
        words = ["-rsf", "-v", "-p", "no:cacheprovider", "-k", "order or frame"]
        done = pytester.runpytest_inprocess(*words)
        done.assert_outcomes(failed=1, passed=2, skipped=1, deselected=2 * len(CHECKS) - 4)
        shown = done.stdout.str()
        assert "test_attack[across_tracks-order_of_tracks_does_not_matter]" in shown
        assert "tracks in another order: positions or std differ by" in shown
        assert "granted SCENE in every row" in shown
        assert "test_attack[Averaging-order_of_tracks_does_not_matter] PASSED" in shown
