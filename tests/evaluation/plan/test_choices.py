"""A + on an axis adds to the preset: on the command line, in a file, in a notebook."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from helpers.commands import MATRIX, assert_refused, run

from evaluation.matrix import parser, settings_from
from evaluation.plan.axes import expand_axes
from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import AXES, Settings
from isac_track.errors import SettingsError
from isac_track.types import Knowledge, Reconstruction


@dataclass(frozen=True)
class OwnAttack:
    """Return the positions as they were shared."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context):  # noqa: ARG002 - it learns nothing
        return lambda release: Reconstruction(release.xy)


def specs(settings):
    """SPECs of a run by axis, in order."""
    crossed = expand_axes(settings)
    return {
        "mechanisms": [plugin.spec for plugin in crossed.mechanisms],
        "predictors": [plugin.spec for plugin in crossed.scenes.predictors],
        "attacks": [plugin.spec for plugin in crossed.scenes.attacks],
        "links": [
            (task.name, linker.spec)
            for task, linkers in crossed.linkage.linkers_by_task.items()
            for linker in linkers
        ],
    }


def typed(*words):
    return settings_from(parser().parse_args(words))


@pytest.mark.parametrize(
    ("axis", "spec", "options"),
    [
        ("mechanism", "laplace:0.3", "mechanisms"),
        ("predictor", "kalman_cv:0.5", "predictors"),
        ("attack", "savgol:0.4", "attacks"),
    ],
)
@pytest.mark.parametrize("preset", ["smoke", "paper"])
def test_what_is_added_comes_after_the_preset(preset, axis, spec, options, tmp_path):
    usual, path = specs(Settings(preset=preset)), tmp_path / "run.toml"
    path.write_text(f"preset = '{preset}'\n{axis} = ['+{spec}']\n")
    for settings in (
        typed("--preset", preset, f"--{axis}", f"+{spec}"),
        typed("--config", str(path)),
        Settings(preset=preset, **{f"{axis}s": [f"+{spec}"]}),
    ):
        result = specs(settings)
        new = [item for item in result[options] if item not in usual[options]]
        assert len(new) == 1
        assert [item for item in result[options] if item not in new] == usual[options]
        assert {name: result[name] for name in result if name != options} == {
            name: usual[name] for name in usual if name != options
        }


def test_a_linker_that_is_added_links_and_the_others_still_do():
    usual, linkers = (
        specs(Settings(preset="smoke", attacks=attacks))
        for attacks in (None, ["+shape@kalman_rts"])
    )
    new = {*linkers["links"]} - {*usual["links"]}
    assert ("rerelease", "shape@kalman_rts") in new
    assert {spec for _, spec in new} == {"shape@kalman_rts"}
    assert {*usual["links"]} < {*linkers["links"]}


def test_a_task_that_is_added_is_linked():
    result = expand_axes(typed("--preset", "frontier", "--task", "+split"))
    assert [task.name for task in result.linkage.tasks] == ["rerelease", "split"]


def test_all_that_a_preset_does_besides_its_axes_stays():
    usual = expand_axes(Settings())
    added = expand_axes(
        Settings(
            attacks=["+savgol:0.4"],
            mechanisms=["+laplace:0.3"],
            predictors=["+kalman_cv:2"],
        )
    )
    assert added.scenes.slow_error_attacks == usual.scenes.slow_error_attacks
    assert added.scenes.mechanisms_by_world == usual.scenes.mechanisms_by_world
    assert added.linkage.mechanisms_by_world == usual.linkage.mechanisms_by_world
    assert added.scenes.adversaries == usual.scenes.adversaries
    # A robot that is named reads all scenes, at every horizon.
    added_robots = added.scenes.utility_predictors
    assert len(added_robots) == len(usual.scenes.utility_predictors) + 1


def test_without_the_attacks_of_a_preset_its_further_adversaries_go():
    usual, replaced = Settings(), Settings(attacks=["savgol"])
    assert expand_axes(usual).scenes.adversaries.further
    assert expand_axes(replaced).scenes.adversaries.further == ()


def test_an_attack_of_slow_errors_that_is_named_runs_against_every_mechanism():
    (spec,) = expand_axes(Settings()).scenes.slow_error_attacks
    named = expand_axes(Settings(attacks=[f"+{spec}"]))
    assert named.scenes.slow_error_attacks == frozenset()


def test_twice_is_once():
    for name in PRESETS["smoke"].attacks:
        once = expand_axes(Settings(preset="smoke"))
        assert (
            expand_axes(
                Settings(preset="smoke", attacks=[f"+{name}"])
            ).linkage.linkers_by_task
            == once.linkage.linkers_by_task
        )


def test_an_object_follows_a_plus_of_its_own():
    result = expand_axes(
        Settings(preset="smoke", attacks=["+", OwnAttack(), "savgol:0.4"])
    )
    usual = expand_axes(Settings(preset="smoke"))
    assert result.scenes.attacks[-2].instance == OwnAttack()
    assert len(result.scenes.attacks) == len(usual.scenes.attacks) + 2


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(
    ("values", "says"),
    [
        (["+a", "b"], "'+a' adds to the preset's and 'b' replaces them"),
        (["b", "+a"], "'+a' adds to the preset's and 'b' replaces them"),
        (["+none"], "a + is followed by what it adds, as +NAME"),
        (["+"], "a + is followed by what it adds, as +NAME"),
        (["+a", "+"], "a + is followed by what it adds, as +NAME"),
    ],
)
def test_both_at_once_is_refused(axis, values, says):
    with pytest.raises(SettingsError) as caught:
        Settings(**{axis: values})
    assert str(caught.value).startswith(f"{axis}: {says}")


@pytest.mark.parametrize(
    "words",
    [
        ("--attack", "+kalman_rts", "--attack", "savgol"),
        ("--attack", "+none"),
        ("--task", "+"),
    ],
)
def test_the_command_says_it_in_one_line(tmp_path, words):
    assert_refused(
        run(tmp_path, *MATRIX, *words), "a +" if len(words) == 2 else "write + before"
    )


def test_none_beside_a_plus_is_refused():
    with pytest.raises(SettingsError, match="none empties the axis"):
        typed("--attack", "none", "--attack", "+savgol")


@pytest.mark.parametrize(
    "option", ["fresh", "keep_ids", "keep_scores", "persistent_ids"]
)
def test_a_flag_is_true_or_false(option):
    for value in ("no", 0, 1.0, []):
        with pytest.raises(SettingsError) as caught:
            Settings(**{option: value})
        message = str(caught.value)
        assert message.startswith(f"{option} must be True or False; got ")
        assert "\n" not in message
    for value in (True, False, np.True_, np.False_):
        assert getattr(Settings(**{option: value}), option) is bool(value)


def test_the_width_of_a_pilot_is_a_number():
    with pytest.raises(SettingsError, match="pilot_half_width must be a number"):
        Settings(pilot_half_width="wide")


def test_what_is_added_must_be_able_to_run():
    with pytest.raises(SettingsError, match="has no task to run in"):
        expand_axes(
            Settings(
                preset="smoke", tasks=["split"], attacks=["+kinematic:0.3@kalman_rts"]
            )
        )
