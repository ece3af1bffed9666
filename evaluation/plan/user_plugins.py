"""The plug-ins of a run that a user wrote."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluation.plan.origins import is_user_plugin

if TYPE_CHECKING:
    from evaluation.plan.axes import Axes


def has_user_plugins(run_axes: Axes) -> bool:
    """Whether the axes have a user's plug-in: it may end its process, or spoil it."""
    consumers = (
        *run_axes.scenes.consumers,
        *run_axes.patrols.consumers(),
        *run_axes.tracks.consumers(),
        *run_axes.linkage.all_linkers,
    )
    used = (plugin for consumer in consumers for plugin in consumer.plugins)
    return any(map(is_user_plugin, (*run_axes.mechanisms, *used)))


def list_user_plugins(run_axes: Axes) -> dict[str, list[str]]:
    """Return the user's plug-ins by axis, by their names in the columns of the results.

    Axes without any are left out. Mechanisms and trackers have names without the level.
    A linker behind a reconstruction counts as soon as either is a user's.
    """
    scenes = run_axes.scenes
    names = {
        "mechanisms": [
            plugin.name for plugin in filter(is_user_plugin, run_axes.mechanisms)
        ],
        "predictors": [
            plugin.spec for plugin in filter(is_user_plugin, scenes.predictors)
        ],
        "policies": [
            plugin.spec for plugin in filter(is_user_plugin, run_axes.patrols.policies)
        ],
        "trackers": [
            plugin.name for plugin in filter(is_user_plugin, run_axes.tracks.releases)
        ],
        "attacks": [
            *(plugin.spec for plugin in filter(is_user_plugin, scenes.attacks)),
            *(
                linker.spec
                for linker in run_axes.linkage.all_linkers
                if any(map(is_user_plugin, linker.plugins))
            ),
        ],
    }
    return {axis: [*dict.fromkeys(specs)] for axis, specs in names.items() if specs}
