"""Whose a plug-in is: the project's own, or a user's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from isac_track.plugins import Plugin

# The packages of the project.
OURS: Final = ("isac_track", "predictors", "attacks", "evaluation")


def is_user_plugin(plugin: Plugin) -> bool:
    """Whether a plug-in is a user's, not one of the project's own."""
    return plugin.origin.partition(":")[0].partition(".")[0] not in OURS
