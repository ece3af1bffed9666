"""The kits: built-ins pass them, and each mistake fails the check about it."""

import re
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers import broken_attacks, broken_linkers, broken_plugins
from helpers.broken_attacks import MECHANISM, SCENE, SIGMA, TRAIN, Jitters, attack
from helpers.broken_linkers import BASE, linker
from helpers.broken_plugins import Noise, Stand, plugin
from helpers.commands import run
from helpers.processes import ROOT

from attacks.linkage.kinematic import Kinematic
from attacks.testing import (
    CHECKS,
    LINKAGE_CHECKS,
    MECHANISM_CHECKS,
    POLICY_CHECKS,
    PREDICTOR_CHECKS,
    CheckResult,
    _rows,
    checks_for,
    kit_test,
    list_adversaries,
    parametrize_attack_checks,
    parametrize_mechanism_checks,
    parametrize_policy_checks,
    parametrize_predictor_checks,
    parametrize_tracker_checks,
    run_checks,
)
from attacks.testing._attack_cases import LinkageCase, ReconstructionCase
from attacks.testing._releases import RAW_SIGMA_M, map_releases
from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.tracking import GNN, JPDA
from isac_track.types import Knowledge

KITS = (CHECKS, LINKAGE_CHECKS, MECHANISM_CHECKS, PREDICTOR_CHECKS, POLICY_CHECKS)
BROKEN = [*broken_attacks.BROKEN, *broken_linkers.BROKEN, *broken_plugins.BROKEN]


TRAINS = "corrector"


def built_in(kind):
    names = plugins.names(kind).items()
    ours = [
        name
        for name, origin in names
        if origin.startswith(f"{kind}.") and name != TRAINS
    ]
    return [plugins.parse(kind, name)[0].instance for name in ours]


MECHANISMS = [
    plugins.parse("mechanisms", spec)[0]
    for spec in (
        "raw",
        "clean",
        "offset:0.3",
        "thin:3",
        "thin:3,d_sigma=0.5,adding=independent",
        "fixed:0",
        "fixed:0.5",
        "fixed:0.5,adding=independent",
        "fixed:0,adding=independent",
        "fixed:0.5,adding=independent,law=isotropic",
        "fid:100",
        "fid:1000,adding=independent",
        "correlated:0.5",
        "correlated:0.5,tau_s=9,adding=independent",
        "ou:1",
        "ou:1,tau_s=0.5,reuse=session",
        "ou_fid:100",
        "laplace:0.7",
        "forecast:0.3",
        "qclm:0.7",
        "gp_prior:0.7,reuse=session",
        "fourier:0.7",
        "least_information:0.7",
        "remap:0.7",
        "shaped:0.3",
        "window:0.7",
        "window:0.7,d_sigma=0.5",
    )
]


@parametrize_attack_checks([*built_in("attacks"), Jitters(), *broken_linkers.HONEST])
def test_a_fair_attack_passes(attack, check):
    check(attack)


@pytest.mark.slow
@parametrize_attack_checks([plugins.parse("attacks", f"{TRAINS}:trees=4")[0].instance])
def test_an_attack_that_trains_long_passes(attack, check):
    check(attack)


@parametrize_mechanism_checks([*(plugin.instance for plugin in MECHANISMS), Noise()])
def test_a_fair_mechanism_passes(mechanism, check):
    check(mechanism)


@parametrize_predictor_checks([*built_in("predictors"), Stand()])
def test_a_fair_predictor_passes(predictor, check):
    check(predictor)


POLICIES = [
    plugins.parse("policies", spec)[0]
    for spec in (
        "everything",
        "window:1.3",
        "near:3.5",
        "near:3.5,select_on=shared",
        "ahead:2",
        "ahead:2,window_s=none,stds=1",
        "random:0.4",
        "state",
        "state:2",
        "flag",
    )
]


@parametrize_policy_checks([plugin.instance for plugin in POLICIES])
def test_a_fair_policy_passes(policy, check):
    check(policy)


def test_every_policy_is_among_them():
    assert {spec.family for spec in POLICIES} == set(plugins.names("policies"))


@dataclass(frozen=True)
class Faulty:
    """A policy with a fault of one's choice."""

    fault: str
    form: str = "samples"

    def select(self, query):
        everybody = np.ones(query.n_people, dtype=bool)
        sent = query.recent_samples(everybody)
        if self.fault == "numbers":
            return sent.astype(int)
        if self.fault == "short":
            return sent[1:]
        if self.fault == "draws":
            return np.random.default_rng().random(query.t.size) < 0.5
        if self.fault == "alone":
            return sent & (query.offsets[1] > 2)
        return sent


@pytest.mark.parametrize(
    ("policy", "name", "message"),
    [
        (Faulty("numbers"), "result_is_a_mask", "must return a mask"),
        (Faulty("short"), "result_is_a_mask", "must return a mask"),
        (Faulty("draws"), "same_query_same_answer", "differ in"),
        (Faulty("alone"), "odd_queries_are_answered", "IndexError"),
        (
            Faulty("", form="flag"),
            "form_stays_the_same",
            "a flag, which sends no sample",
        ),
        (Faulty("", form="state"), "form_stays_the_same", "a state, which is of now"),
    ],
)
def test_a_faulty_policy_fails_where_it_should(policy, name, message):
    results = {result.name: result for result in run_checks(policy)}
    assert results[name].status == "failed"
    assert message in results[name].message


TRACKERS = [GNN(), JPDA(), GNN(confirm_hits=2, confirm_scans=4, q=0.1)]


@parametrize_tracker_checks(TRACKERS)
def test_a_fair_tracker_passes(tracker, check):
    check(tracker)


@dataclass(frozen=True)
class FaultyTracker:
    """A tracker with a fault of one's choice."""

    fault: str

    def track(self, detections, likelihood):
        tracked = GNN().track(detections, likelihood)
        if self.fault == "list":
            return [tracked]
        if self.fault == "late":
            # It joins what goes on elsewhere, as a smoother would.
            shift = 0.01 * float(detections.scan_s.size)
            return replace(tracked, xy=tracked.xy + shift)
        if self.fault == "drops":
            return GNN(confirm_hits=60, confirm_scans=60).track(detections, likelihood)
        if self.fault == "draws":
            drawn = np.random.default_rng().random(tracked.xy.shape)
            return replace(tracked, xy=tracked.xy + drawn)
        if self.fault == "empty" and not len(detections):
            raise ValueError("nobody")
        return tracked


@pytest.mark.parametrize(
    ("fault", "name", "message"),
    [
        ("list", "result_is_tracks", "must return a Tracked, got list"),
        ("late", "later_scans_do_not_matter", "a robot gets tracks as they grow"),
        ("drops", "people_far_apart_are_tracked", "has 0% of the person's"),
        ("draws", "same_detections_same_tracks", "differ in"),
        ("empty", "odd_scans_are_tracked", "nobody"),
    ],
)
def test_a_faulty_tracker_fails_where_it_should(fault, name, message):
    results = {result.name: result for result in run_checks(FaultyTracker(fault))}
    assert results[name].status == "failed"
    assert message in results[name].message


def test_every_mechanism_is_among_them():
    assert {spec.family for spec in MECHANISMS} == set(plugins.names("mechanisms"))


@pytest.mark.parametrize(
    ("broken", "name", "message"),
    [pytest.param(*case, id=f"{case[0].__name__}-{case[1]}") for case in BROKEN],
)
def test_a_mistake_fails_the_one_check_about_it(broken, name, message):
    failed = [result for result in run_checks(broken()) if result.status == "failed"]
    assert [result.name for result in failed] == [name]
    pattern = re.escape(message).replace(r"\.\*", ".*")
    assert re.search(pattern, failed[0].message)
    assert failed[0].message.startswith(
        (f"{broken.__name__} as ", f"{broken.__name__}, ")
    )


def test_every_check_catches_a_mistake():
    caught = {name for _, name, _ in broken_attacks.BROKEN}
    assert caught == CHECKS.keys()
    # Some checks of the two kits are one.
    both = {"same_seed_same_result", "only_granted_knowledge_is_touched"}
    assert {
        name for _, name, _ in broken_linkers.BROKEN
    } == LINKAGE_CHECKS.keys() - both
    caught = {name for _, name, _ in broken_plugins.BROKEN}
    assert caught == MECHANISM_CHECKS.keys() | PREDICTOR_CHECKS.keys()


def failed(made, names=None):
    """Return the messages of what does not pass, of an attack or the class of one."""
    subject = made() if isinstance(made, type) else made
    return {
        result.name: result.message
        for result in run_checks(subject, names=names)
        if not result.passed
    }


def fitted(function):
    """An attack of which the function from fit is this."""
    return attack(lambda _context: function)


def fails(_context):
    raise RuntimeError("of its own")


def hopes(context):
    assert context.repeats


NULL, SHORT = "null_stays_at_chance", "odd_tracks_are_handled"
ORDER, MATRIX = "order_of_tracks_does_not_matter", "result_is_a_score_matrix"
MUTATED, GRANTED = "inputs_are_not_mutated", "only_granted_knowledge_is_touched"
FRAME = "frame_and_clock_do_not_matter"


class TestMistakesWithoutEnd:
    """What spoils every run is reported by every check, and ends none."""

    @pytest.mark.parametrize(
        ("made", "spared", "message"),
        [
            (
                attack(lambda release: release.xy * np.nan),
                set(),
                "ValueError: a reconstructed position is not finite",
            ),
            (
                linker(
                    lambda probe, gallery: np.full((len(probe), len(gallery)), np.nan)
                ),
                {MUTATED, GRANTED},
                "63 of 63 scores are not finite",
            ),
        ],
    )
    def test_of_whatever_it_answers(self, made, spared, message):
        messages = failed(made)
        assert messages.keys() == checks_for(made()).keys() - spared
        assert message in next(iter(messages.values()))

    @pytest.mark.parametrize(
        ("made", "message"),
        [
            (
                lambda sensed, rng: Noise().share(sensed, rng).tracks([0]),
                "of 24 tracks it retu",
            ),
            (
                lambda sensed, _rng: sensed.xy,
                "share must return a Release, got ndarray",
            ),
            (
                lambda _release, _t_future: np.zeros((1, 2)),
                "must return a Prediction, got ndarray",
            ),
            (broken_plugins.skewed, "a predicted covariance is not symmetric"),
        ],
    )
    def test_of_whatever_is_shared_or_predicted(self, made, message):
        results = run_checks(plugin(made))
        assert len(results) == len(checks_for(plugin(made)))
        assert results[0].status == "failed"
        assert message in results[0].message

    @pytest.mark.parametrize(
        ("made", "name", "message"),
        [
            (
                fitted(lambda release: release.xy[1:]),
                ORDER,
                "shape (271, 2), expected (272, 2)",
            ),
            (
                fitted(lambda release: release.xy * np.nan),
                NULL,
                "reconstructed position is not fi",
            ),
            (
                fitted(lambda release: [["a", "b"]] * len(release.t)),
                SHORT,
                "struction, got list",
            ),
            (
                fitted(3),
                NULL,
                "asked for release, it raised TypeError: 'int' object is not",
            ),
            (
                attack(lambda release: release.xy.fill(0.0)),
                MUTATED,
                "read-only (broken_attac",
            ),
            (
                linker(lambda probe, gallery: BASE.link(probe, gallery).T),
                MATRIX,
                "(turned round?)",
            ),
            (
                linker(lambda _probe, _gallery: None),
                ORDER,
                "(P, G) = (7, 9), got NoneType",
            ),
            (
                linker(lambda _probe, _gallery: np.full((7, 9), 1j)),
                ORDER,
                "ndarray of complex128",
            ),
            (
                linker(lambda _context: sys.exit("no")),
                NULL,
                "fit(context) raised SystemExit: no",
            ),
            (linker(hopes), GRANTED, "REPEATS was not granted"),
            (attack(fails), GRANTED, "RuntimeError: of its own (broken_attacks.py, "),
        ],
    )
    def test_in_words(self, made, name, message):
        (text,) = failed(made, names=[name]).values()
        assert message in text
        # A fault of its own is not blamed on knowledge.
        assert "given all knowledge it runs" not in text


class TestRows:
    @pytest.mark.parametrize(
        ("made", "check"),
        [
            (attack(lambda track: np.round(track.xy, 1), requires=SCENE), FRAME),
            (Kinematic, "frames_and_clocks_do_not_matter"),
        ],
    )
    def test_scene_exempts_from_another_frame(self, made, check):
        (skipped,) = [result for result in run_checks(made()) if not result.passed]
        assert (skipped.name, skipped.status) == (check, "skipped")
        assert "granted SCENE in every row" in skipped.message

    def test_are_those_of_tasks_that_show_what_it_requires(self):
        learns = linker(lambda _context: None, uses=TRAIN | MECHANISM | SIGMA)()
        assert list_adversaries(BASE) == ("blind",)
        assert list_adversaries(Kinematic()) == ("blind", "informed")
        assert list_adversaries(learns) == ("blind", "informed", "oracle")
        assert list_adversaries(broken_attacks.common_frame()) == ("oracle",)
        granted = [row.granted for row in _rows(learns)]
        assert granted[1:] == [TRAIN | MECHANISM, learns.uses]

    def test_both_with_the_scene_shown_and_hidden(self):
        both = broken_linkers.ContinuesWhereShown()
        assert [row.granted for row in _rows(both)] == [frozenset(), SCENE]
        assert list_adversaries(both) == ("blind",)


class TestRunning:
    @pytest.mark.parametrize(
        ("made", "checks"), [(Jitters(), CHECKS), (BASE, LINKAGE_CHECKS)]
    )
    def test_checks_go_by_the_kind_in_order_and_by_name(self, made, checks):
        assert list(checks_for(made)) == list(checks)
        assert run_checks(made, names=[NULL]) == (CheckResult(NULL, "passed"),)

    @pytest.mark.parametrize(
        ("made", "name", "message"),
        [
            (broken_attacks.Base(), "xyzzy", "known: result_is_a_reconstruction, "),
            (BASE, FRAME, "of a linkage attack; did you mean 'frames_and_clocks_do_"),
            (
                Noise(),
                "sigma_is_declarde",
                "of a mechanism; did you mean 'sigma_is_declared'",
            ),
        ],
    )
    def test_a_wrong_name_is_answered_with_the_nearest(self, made, name, message):
        with pytest.raises(SettingsError, match=message):
            run_checks(made, names=[name])

    @pytest.mark.parametrize("checks", KITS)
    def test_every_check_states_what_it_shows_and_is_in_the_guide(self, checks):
        assert all(check.statement.endswith(".") for check in checks.values())
        pages = (ROOT / "docs").rglob("*.md")
        guide = "".join(path.read_text(encoding="utf-8") for path in pages)
        assert [name for name in checks if f"`{name}`" not in guide] == []

    def test_neither_kit_needs_pytest_or_hypothesis(self, tmp_path):
        code = (
            "import sys, attacks.testing, isac_track.testing.__main__\n"
            "sys.exit(', '.join({'pytest', 'hypothesis'} & sys.modules.keys()) or 0)"
        )
        done = run(tmp_path, "-c", code)
        assert done.code == 0, done


def test_sigma_is_granted_where_it_is_required():
    base = type(plugin(broken_plugins.takes_sigma))
    asks = type("Asks", (base,), {"requires": frozenset({Knowledge.SIGMA})})()
    outcomes = {result.name: result.status for result in run_checks(asks)}
    assert {name for name, status in outcomes.items() if status != "passed"} == {
        "track_is_causal"
    }
    assert outcomes["track_is_causal"] == "skipped"


def altered(**attributes):
    return type("Odd", (broken_attacks.Base,), attributes)()


class TestWhatIsNoAttack:
    @pytest.mark.parametrize(
        ("attack", "message"),
        [
            (
                broken_linkers.NeedsRepeats(),
                "requires REPEATS, which nobody who links is grant",
            ),
            (
                altered(kind="linking"),
                'attack Odd: kind must be "reconstruction" or "li',
            ),
            (Jitters, r"got its class: write Jitters\(\)"),
            (
                altered(uses=[Knowledge.TRAIN]),
                "attack Odd.uses must be a frozenset of Knowl",
            ),
            (altered(fit=None), r"attack Odd has no method fit\(\)"),
            (
                None,
                (
                    r"attack NoneType must be a frozen dataclass:"
                    r" @dataclass\(frozen=True\)"
                ),
            ),
        ],
    )
    def test_is_answered_with_what_to_write(self, attack, message):
        with pytest.raises(PluginError, match=message):
            parametrize_attack_checks([attack])
        with pytest.raises(PluginError, match=message):
            run_checks(attack)

    @pytest.mark.parametrize(
        ("call", "message"),
        [
            (lambda: checks_for(Noise), r"got its class: write Noise\(\)"),
            (
                lambda: checks_for(type("Soft", (), {"share": print})()),
                "mechanism Soft must be a",
            ),
        ],
    )
    def test_nor_is_what_is_no_such_plugin(self, call, message):
        with pytest.raises(PluginError, match=message):
            call()

    def test_nor_is_a_list_of_none(self):
        with pytest.raises(SettingsError, match="the list is empty"):
            parametrize_attack_checks([])


class TestWithPytest:
    def test_ids_name_attack_and_check(self):
        given = [Jitters(), replace(Jitters(), sigma_m=0.1), BASE]
        assert [case.id for case in parametrize_attack_checks(given).mark.args[1]] == [
            *(f"Jitters-{name}" for name in CHECKS),
            *(f"Jitters(sigma_m=0.1)-{name}" for name in CHECKS),
            *(f"Base-{name}" for name in LINKAGE_CHECKS),
        ]

    def test_a_kit_test_takes_plugins_of_all_kinds_and_runs_each_check(self):
        test = kit_test(Jitters(), Noise(), Stand())
        (mark,) = test.pytestmark
        assert [case.id for case in mark.args[1]] == [
            *(f"Jitters-{name}" for name in CHECKS),
            *(f"Noise-{name}" for name in MECHANISM_CHECKS),
            *(f"Stand-{name}" for name in PREDICTOR_CHECKS),
        ]
        broken, name, message = broken_plugins.BROKEN[0]
        values = kit_test(broken()).pytestmark[0].args[1]
        ((plugin, check),) = (
            case.values for case in values if case.id.endswith(f"-{name}")
        )
        with pytest.raises(AssertionError, match=message):
            test(plugin, check)

    def test_a_kit_test_of_nothing_is_refused(self):
        with pytest.raises(SettingsError, match="the list is empty"):
            kit_test()


# The cases on which attacks are tried.

whole, _ = ReconstructionCase.ordinary_and_another(frozenset())
hidden, shown = (
    LinkageCase.ordinary_and_another(granted)[0].noisy
    for granted in (frozenset(), SCENE)
)


@pytest.mark.parametrize("noisy", [whole.noisy, hidden, shown])
@pytest.mark.parametrize(
    ("sigma_m", "law", "n"), [(0.3, "radial", 1), (10.0, "isotropic", 2)]
)
def test_levels_differ_in_the_size_of_errors_alone_which_is_as_announced(
    noisy, sigma_m, law, n
):
    less, more = noisy(sigma_m, law), noisy(3 * sigma_m, law)
    for low, high in zip(releases(less), releases(more), strict=True):
        if low.sigma is None:  # a true position
            continue
        added = high.xy - low.xy
        assert np.sqrt((added**2).sum(axis=1).mean() / n) == pytest.approx(
            2 * sigma_m, rel=0.05
        )
        np.testing.assert_allclose(low.sigma, sigma_m)
    assert less.mechanism.d_sigma == pytest.approx(sigma_m - RAW_SIGMA_M)


def releases(case):
    collected = []
    map_releases(case, lambda release: collected.append(release) or release)
    return collected


def test_other_people_and_repeats_are_what_they_should_be():
    case = whole.noisy(0.3, "radial")
    errors = np.stack(
        [shown.xy - case.truth for shown in (case.release, *case.repeats)]
    )
    assert np.sqrt((errors**2).sum(axis=2).mean()) == pytest.approx(0.3, rel=0.05)
    assert np.abs(np.corrcoef(errors.reshape(3, -1)) - np.eye(3)).max() < 0.06
    assert not np.isin(case.train.truth, case.truth).any()
