"""The threat model: the knowledge of each adversary, and that no other is available."""

from dataclasses import dataclass

import numpy as np
import pytest
from helpers.walks import flat_release

from isac_track.errors import KnowledgeDenied
from isac_track.protocols import (
    ADVERSARIES,
    USUAL,
    AttackContext,
    LinkageTrainingSet,
    TrainingSet,
    grants,
)
from isac_track.rng import stream
from isac_track.sharing import Fixed
from isac_track.types import Knowledge

MECHANISM, SIGMA, TRAIN, SCENE, REPEATS, *_ = Knowledge
HELD = {kind: kind.value for kind in Knowledge if kind not in (SIGMA, SCENE)}


@dataclass(frozen=True)
class Attack:
    requires: frozenset = frozenset()
    uses: frozenset = frozenset()

    def fit(self, context):
        """Not called: the tests only read the declarations."""


def release():
    return flat_release(np.array([0.0, 1.0]), np.zeros((2, 2)), np.array([0, 2]))


OFFERED = {
    "mechanism": Fixed(0.5),
    "train": TrainingSet(release(), np.ones((2, 2))),
    "repeats": (release(), release()),
    "anchor": release(),
    "companions": (release(),),
}


def context(*granted, **changes):
    return AttackContext(
        rng=stream(0, "test"),
        epsilon_m=0.3,
        granted=frozenset(granted),
        **OFFERED | changes,
    )


class TestContext:
    @pytest.mark.parametrize("granted", HELD)
    def test_granted_knowledge_is_returned_and_the_rest_is_denied(self, granted):
        given = context(granted)
        assert given.granted == {granted}
        for kind, name in HELD.items():
            if kind is granted:
                assert getattr(given, name) is OFFERED[name]
            else:
                # No AttributeError: hasattr() of an attack must not hide it.
                with pytest.raises(
                    KnowledgeDenied, match=f"{kind.name} was not granted"
                ):
                    hasattr(given, name)

    @pytest.mark.parametrize("granted", [None, *HELD])
    def test_knowledge_that_was_not_granted_is_nowhere_in_it(self, granted):
        given = context(*filter(None, [granted]))
        assert not hasattr(given, "__dict__")
        slots = [getattr(given, slot) for slot in type(given).__slots__]
        reachable = list(slots)
        for slot in slots:
            if isinstance(slot, dict):
                reachable += [*slot, *slot.values()]
        for kind, name in HELD.items():
            is_reachable = any(value is OFFERED[name] for value in reachable)
            assert is_reachable == (kind is granted)

    @pytest.mark.parametrize(
        "missing", [[MECHANISM], [TRAIN], [REPEATS], [MECHANISM, TRAIN]]
    )
    def test_a_grant_of_missing_knowledge_is_an_error_of_the_caller(self, missing):
        names = ", ".join(sorted(kind.name for kind in missing))
        with pytest.raises(ValueError, match=f"granted, but not given: {names}$"):
            context(*Knowledge, **{HELD[kind]: None for kind in missing})

    def test_sigma_and_scene_need_nothing_from_the_context_and_give_nothing_of_it(self):
        bare = context(SIGMA, SCENE, **dict.fromkeys(OFFERED))
        assert (bare.granted, bare._held) == ({SIGMA, SCENE}, {})
        with pytest.raises(AttributeError):
            bare.truth = 1


def test_the_truth_of_a_training_set_is_one_position_a_sample():
    truth = np.arange(4.0).reshape(2, 2)
    assert TrainingSet(release(), truth).truth.tolist() == [[0.0, 1.0], [2.0, 3.0]]
    for shape in [(1, 2), (3, 2), (2, 3), (2,)]:
        with pytest.raises(ValueError, match=r"truth must have shape \(2, 2\)"):
            TrainingSet(release(), np.zeros(shape))


@pytest.mark.parametrize(
    ("mate", "says"),
    [
        ([0, 1, -1], r"2 integers, got \(3,\)"),
        ([0.0, 1.0], "2 integers"),
        ([0, 2], "within -1 and 1"),
        ([-2, 0], "within -1 and 1"),
        ([1, 1], "two probes have one mate"),
    ],
)
def test_a_track_of_a_training_set_has_at_most_one_mate(mate, says):
    both = flat_release(np.array([0.0, 0.0]), np.zeros((2, 2)), np.array([0, 1, 2]))
    assert LinkageTrainingSet(both, both, np.array([1, -1])).mate.tolist() == [1, -1]
    with pytest.raises(ValueError, match=says):
        LinkageTrainingSet(both, both, np.array(mate))


def test_each_adversary_knows_more_than_the_weaker_one():
    informed = {MECHANISM, TRAIN}
    assert list(ADVERSARIES.items()) == [
        ("blind", set()),
        ("informed", informed),
        ("repeats", informed | {REPEATS, SCENE}),
        ("anchor", informed | {Knowledge.ANCHOR}),
        ("companions", informed | {Knowledge.COMPANIONS}),
        ("insider", informed | {SCENE}),
        ("oracle", set(Knowledge)),
    ]
    assert USUAL == ("blind", "informed", "oracle")


def test_an_adversary_beyond_the_usual_runs_on_request():
    attack = Attack(
        requires=frozenset(), uses=frozenset({MECHANISM, Knowledge.ANCHOR, SCENE})
    )
    assert list(grants(attack)) == ["blind", "informed", "oracle"]
    rows = grants(attack, asked=("anchor", "companions"))
    assert list(rows) == ["blind", "informed", "anchor", "oracle"]
    assert rows["anchor"] == {MECHANISM, Knowledge.ANCHOR}


@pytest.mark.parametrize(
    ("requires", "uses", "rows"),
    [
        ((), (), {"blind": set()}),
        ((), (MECHANISM, TRAIN), {"blind": set(), "informed": {MECHANISM, TRAIN}}),
        ((), (SIGMA,), {"blind": set(), "oracle": {SIGMA}}),
        (
            (),
            (MECHANISM, TRAIN, SIGMA),
            {
                "blind": set(),
                "informed": {MECHANISM, TRAIN},
                "oracle": {MECHANISM, TRAIN, SIGMA},
            },
        ),
        ((TRAIN,), (TRAIN,), {"informed": {TRAIN}}),
        ((TRAIN,), (MECHANISM,), {"informed": {MECHANISM, TRAIN}}),
        ((TRAIN,), (SIGMA,), {"informed": {TRAIN}, "oracle": {TRAIN, SIGMA}}),
        ((SIGMA,), (TRAIN,), {"oracle": {SIGMA, TRAIN}}),
        ((REPEATS,), (MECHANISM, SIGMA), {"oracle": {REPEATS, MECHANISM, SIGMA}}),
        ((SCENE,), (), {"oracle": {SCENE}}),
        (tuple(Knowledge), (), {"oracle": set(Knowledge)}),
    ],
)
def test_a_row_is_named_after_the_weakest_adversary_that_gets_as_much(
    requires, uses, rows
):
    attack = Attack(requires=frozenset(requires), uses=frozenset(uses))
    assert grants(attack) == rows
    assert list(grants(attack)) == list(rows)  # weakest first
