"""What a run crosses: its mechanisms with all that its settings let read them.

The axes of each subject are in a file of its own: scenes, linkage, patrols, tracks.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from attacks.tasks.task_list import RETURNS, Task, task_named
from evaluation.plan.adversaries import check_adversaries_attack, expand_adversaries
from evaluation.plan.linkage_axes import LinkageAxes, expand_linkage
from evaluation.plan.linkers import assign_linkers, parse_attacks
from evaluation.plan.patrol_axes import PatrolAxes, expand_patrols
from evaluation.plan.presets import PRESETS, Preset
from evaluation.plan.scene_axes import SceneAxes, expand_scenes, further_attacks
from evaluation.plan.settings import AXES, Settings
from evaluation.plan.track_axes import TrackAxes, expand_tracks
from isac_track import plugins
from isac_track.errors import SettingsError, quoted
from isac_track.plugins import Plugin


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of a run: mechanisms, and consumers by subject.

    Every mechanism level is crossed with every consumer of scenes and of linkage tasks,
    and some levels with the consumers of patrols and tracks (`evaluation.plan.units`).
    """

    mechanisms: tuple[Plugin, ...]
    scenes: SceneAxes = field(default_factory=SceneAxes)
    linkage: LinkageAxes = field(default_factory=LinkageAxes)
    patrols: PatrolAxes = field(default_factory=PatrolAxes)
    tracks: TrackAxes = field(default_factory=TrackAxes)
    horizons_s: tuple[float, ...] = ()
    """Further horizons, a world each, where only robots read."""

    def without_scenes(self, why: str) -> "Axes":
        """Return the axes of people who come back alone: no scene, window or patrol."""
        return Axes(
            self.mechanisms,
            scenes=SceneAxes(why_left_out=why),
            linkage=self.linkage.returns_alone(),
        )

    def limited_to(
        self, tasks: Collection[Task], *, skipped: Mapping[str, str]
    ) -> "Axes":
        """Return the axes with some of the tasks, and why others are `skipped`."""
        return replace(
            self,
            linkage=self.linkage.limited_to(tasks).with_skipped(skipped),
            tracks=self.tracks.limited_to(tasks),
        )


def expand_axes(settings: Settings) -> Axes:
    """Return the axes that the settings stand for, every plug-in once.

    Raises SettingsError if a SPEC is wrong, no mechanism is left, or a task and the
    attacks do not fit, and PluginError if a named plug-in cannot be loaded.
    """
    preset = PRESETS[settings.preset]
    names = _axis_names(settings, preset)
    attacks, linkers = parse_attacks(
        names["attacks"] + further_attacks(settings, preset).specs
    )
    mechanisms = plugins.parse_all("mechanisms", names["mechanisms"])
    predictors = plugins.parse_all("predictors", names["predictors"])
    tasks = tuple(task_named(name) for name in dict.fromkeys(names["tasks"]))
    linkers_by_task = assign_linkers(settings, linkers=linkers, asked=tasks)
    _check_mechanisms(mechanisms, law=settings.stages.sensing.law)
    scenes = expand_scenes(
        settings,
        preset,
        mechanisms=mechanisms,
        predictors=predictors,
        attacks=attacks,
        adversaries=expand_adversaries(settings, preset),
        has_linkers=bool(linkers_by_task),
    )
    linkage = expand_linkage(
        settings,
        preset,
        scenes=scenes,
        mechanisms=mechanisms,
        linkers_by_task=linkers_by_task,
        has_returns=RETURNS in tasks,
    )
    robots = scenes.utility_predictors
    patrols = expand_patrols(
        settings,
        preset,
        policies=plugins.parse_all("policies", names["policies"]),
        mechanisms=mechanisms,
        robots=robots,
    )
    check_adversaries_attack(settings, (*scenes.consumers, *linkage.all_consumers))
    return Axes(
        mechanisms,
        scenes=scenes,
        linkage=linkage,
        patrols=patrols,
        tracks=expand_tracks(
            settings, preset, mechanisms=mechanisms, robots=robots, linkage=linkage
        ),
        horizons_s=settings.stages.conflict.horizons_s if robots else (),
    )


def _axis_names(settings: Settings, preset: Preset) -> dict[str, tuple[Any, ...]]:
    """Return the plug-ins and tasks of each axis as they are named: SPECs or objects.

    A preset's protections are mechanisms that a user's own replace.
    """
    chosen = {axis: settings.choice(axis) for axis in AXES}
    names = {
        axis: choice.values(getattr(preset, axis)) for axis, choice in chosen.items()
    }
    if not chosen["mechanisms"].replaces:
        names["mechanisms"] += preset.protections
    return names


def _check_mechanisms(mechanisms: Iterable[Plugin], *, law: str) -> None:
    """Raise SettingsError without mechanisms, or if a law does not fit.

    Linear adding scales the raw error, so that it cannot have another `law`.
    """
    if not mechanisms:
        raise SettingsError(
            "nothing to run: the mechanism axis is empty; name one, such as raw"
        )
    for plugin in mechanisms:
        own = getattr(plugin.instance, "law", None)
        if plugin.adding == "linear" and isinstance(own, str) and own != law:
            raise SettingsError(
                f"{quoted(plugin.spec)}: linear adding scales the raw error, whose law"
                f" is {law}; write adding=independent, or --set sensing.law={own}"
            )
