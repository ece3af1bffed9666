"""The axes of tracks: trackers of a network's detections, and consumers of tracks."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from attacks.tasks.task_list import Task, task_named
from evaluation.plan.address import track_release_text
from evaluation.plan.constants import ORACLE
from evaluation.plan.consumer import ORACLE_TRACKER, Consumer
from evaluation.plan.linkage_axes import LinkageAxes
from evaluation.plan.patrol_axes import select_patrolled
from evaluation.plan.presets import Preset
from evaluation.plan.settings import Settings
from evaluation.plan.world import OWN_WORLD, World
from isac_track import plugins
from isac_track.plugins import Plugin

_HANDOVER: Final = "handover"
"""Family of the tasks in which tracks are linked."""


@dataclass(frozen=True, slots=True)
class TrackAxes:
    """The releases of tracks or detections, and their consumers on patrol."""

    releases: tuple[Plugin, ...] = ()
    """Trackers, each with the SPEC of its release; without any there are no tracks."""
    mechanisms: tuple[Plugin, ...] = ()
    """Mechanisms of these releases."""
    robots: tuple[Plugin, ...] = ()
    """Predictors of robots on patrol."""
    policies: tuple[Plugin, ...] = ()
    """Disclosure policies that answer from tracks."""
    linkers: tuple[Consumer, ...] = ()
    """Linkers and controls of tracks, across a rotation of pseudonyms."""

    def consumers(self, world: World = OWN_WORLD) -> tuple[Consumer, ...]:
        """Return the consumers of all releases in a world.

        In the run's own world they are the metrics of tracks, robots, an adversary with
        the log of each policy, and linkers. Only robots have further horizons.
        """
        robots = [Consumer("tracked", plugin, world=world) for plugin in self.robots]
        readers, policy_readers = robots, robots
        linkers: tuple[Consumer, ...] = ()
        if world == OWN_WORLD:
            readers = [Consumer("tracks"), *robots]
            policy_readers = [Consumer("track_log", adversary=ORACLE), *robots]
            linkers = self.linkers
        return (
            *(
                replace(consumer, track_release=release)
                for release in self.releases
                for consumer in readers
            ),
            *(
                replace(consumer, track_release=release, policy=policy)
                for release in self.releases
                for policy in self.policies
                for consumer in policy_readers
            ),
            *(
                replace(linker, track_release=release)
                for release in self.releases
                for linker in linkers
            ),
        )

    def limited_to(self, tasks: Iterable[Task]) -> "TrackAxes":
        """Return the axes with the linkers of some tasks alone."""
        names = {task.name for task in tasks}
        linkers = tuple(linker for linker in self.linkers if linker.task in names)
        return replace(self, linkers=linkers)


def expand_tracks(
    settings: Settings,
    preset: Preset,
    *,
    mechanisms: Iterable[Plugin],
    robots: tuple[Plugin, ...],
    linkage: LinkageAxes,
) -> TrackAxes:
    """Return the axes of tracks; empty for a run without a tracker.

    Their mechanisms are those of the preset's patrols, and those that a user names.
    """
    releases = _expand_releases(settings)
    if not releases:
        return TrackAxes()
    policies: tuple[Plugin, ...] = ()
    linkers: tuple[Consumer, ...] = ()
    # Unlabelled detections have neither: a policy chooses people, and linkers need
    # pseudonyms that rotate.
    if settings.stages.tracking.release == "tracks":
        policies = plugins.parse_all("policies", settings.choice("policies").named)
        linkers = _expand_linkers(settings, linkage)
    return TrackAxes(
        releases=releases,
        mechanisms=select_patrolled(settings, preset, mechanisms, includes_named=True),
        robots=robots,
        policies=policies,
        linkers=linkers,
    )


def _expand_releases(settings: Settings) -> tuple[Plugin, ...]:
    """Return the trackers of a run, each with the SPEC of its release.

    The oracle is beside every other tracker, as a reference. Alone it adds nothing:
    perfect association is what all other numbers assume.
    """
    rules = settings.stages.tracking
    (oracle,) = plugins.parse("trackers", ORACLE_TRACKER)
    trackers = plugins.parse("trackers", rules.method)
    if trackers == (oracle,):
        return ()
    is_before = rules.release == "tracks" and rules.noise == "before"
    return tuple(
        replace(
            plugin,
            spec=track_release_text(
                rules.release, plugin.spec, has_noise_before=is_before
            ),
        )
        for plugin in (oracle, *trackers)
    )


def _expand_linkers(settings: Settings, linkage: LinkageAxes) -> tuple[Consumer, ...]:
    """Return the linkers and controls of tracks, in handovers that a user names."""
    named = {
        name
        for name in settings.choice("tasks").named
        if task_named(name).family == _HANDOVER
    }
    return tuple(
        replace(consumer, kind="track_link")
        for task in linkage.tasks
        if task.name in named
        for consumer in linkage.consumers(task)
        if consumer.kind != "windows"
    )
