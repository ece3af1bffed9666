"""What a plan makes of settings, and what it refuses before anything is computed."""

import math

import pytest
from helpers.small_runs import smoke

from evaluation.plan.axes import expand_axes
from evaluation.plan.fingerprint import PATROL
from evaluation.plan.plan import make_plan
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from evaluation.plan.world import World
from isac_track.errors import SettingsError


def patrolled(csv_recording, **changes):
    """Every mechanism, policy and reader of the patrols of a run."""
    plan = make_plan(smoke(csv_recording, **changes))
    return {
        (unit.mechanism.spec, consumer.policy.spec, consumer.spec, consumer.adversary)
        for unit in plan.units
        if unit.section == PATROL
        for consumer in unit.consumers.values()
    }


def keys(plan):
    """Keys of the units of a plan: those of patrols, and all others."""
    patrols = {unit.key for unit in plan.units if unit.section == PATROL}
    return patrols, {unit.key for unit in plan.units} - patrols


def test_settings_of_patrols_are_in_the_keys_of_patrols_alone(csv_recording):
    axes = {"policies": ("near:3",), "mechanisms": ("raw",)}
    usual, other = (
        keys(make_plan(smoke(csv_recording, stages={"patrol.robots": n}, **axes)))
        for n in (1, 2)
    )
    assert usual[1] == other[1]
    assert not usual[0] & other[0]


def test_a_preset_has_its_patrols_and_a_user_others(csv_recording):
    settings = Settings(dataset=str(csv_recording), scenes=8, attacks=(), tasks=())
    for preset in ("quick", "paper"):
        plan = make_plan(settings.changed(preset=preset))
        assert plan.settings.stages.patrol.fleets == PRESETS[preset].fleets
        assert plan.settings.stages.patrol.segment_s == PRESETS[preset].patrol_segment_s
    named = {"patrol.fleets": 20, "patrol.segment_s": math.inf}
    changed = make_plan(settings.changed(stages=settings.stages.changed(named)))
    assert changed.settings.stages.patrol.fleets == 20
    assert changed.settings.stages.patrol.segment_s == math.inf


def test_every_policy_meets_robots_and_adversaries_of_the_patrolled(csv_recording):
    found = patrolled(csv_recording, policies=("near:3", "flag"), mechanisms=("raw",))
    readers = {("least_squares", "")}
    readers |= {("log", name) for name in ("blind", "informed", "oracle")}
    assert found == {
        ("raw", policy, *reader) for policy in ("near:3", "flag") for reader in readers
    }


def test_named_mechanisms_are_patrolled_unless_they_withhold_samples(csv_recording):
    named = ("raw", "fixed:0.3", "window:2", "thin:3")
    found = patrolled(csv_recording, policies=("flag",), mechanisms=named)
    assert {spec for spec, *_ in found} == {"raw", "fixed:0.3"}


def test_without_policies_there_are_no_patrols(csv_recording):
    assert not patrolled(csv_recording, policies=())


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("neer:3", "unknown policy 'neer'; did you mean 'near'"),
        ("near:-3", "metres must be positive"),
        ("window:0", "seconds must be positive"),
    ],
)
def test_a_wrong_policy_is_refused(csv_recording, policy, message):
    with pytest.raises(SettingsError, match=message):
        make_plan(smoke(csv_recording, policies=(policy,)))


def test_the_optimum_of_a_linkage_task_has_a_kind_that_files_do_not_have():
    linkage = expand_axes(Settings(preset="paper", tasks=("rerelease",))).linkage
    (task,) = linkage.tasks
    *linkers, optimum = linkage.model_consumers(World(is_model=True), task)
    assert {linker.kind for linker in linkers} == {"linkage"}
    assert optimum.kind == "link_bound"
    assert optimum.kind_in_files == "linkage"
    assert optimum.spec == "rerelease/bound"
