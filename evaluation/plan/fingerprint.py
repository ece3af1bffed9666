"""Keys of cells: digests of the code that computes them, and of their plug-ins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin

# Sections: the parts of the pipeline that compute consumers. A linkage task is a
# section by its own name.
SHARING, RECONSTRUCTION = "sharing", "reconstruction"
PATROL: Final = "patrol"  # Robots on patrol, with all policies.
RETURNS: Final = "returns"  # People who come back: a task of whole passages.
TRACKING: Final = "tracking"  # Robots and logs with tracks of detections.
_COMMON: Final = (
    "isac_track.datasets",
    "isac_track.place",
    "isac_track.scenes",
    "isac_track.sensing",
    "evaluation.compute.frames",
    "evaluation.compute.guards",
    "evaluation.compute.sharing",
    "evaluation.compute.tables",
)
"""Modules that every unit of work depends on: releases, and the tables of its file."""
_SECTIONS: Final = {
    SHARING: ("evaluation.compute.forecasts", *_COMMON),
    RECONSTRUCTION: ("evaluation.compute.reconstruction", *_COMMON),
    PATROL: ("evaluation.compute.patrols", *_COMMON),
    RETURNS: ("evaluation.compute.returns", *_COMMON),
    TRACKING: (
        "evaluation.compute.tracking",
        "evaluation.compute.recipients",
        "evaluation.compute.track_policies",
        "evaluation.compute.track_links",
        *_COMMON,
    ),
}
_LINKAGE: Final = (
    "evaluation.compute.linkage",
    "evaluation.compute.link_tables",
    "evaluation.compute.window_tables",
    "attacks.tasks.build",
    *_COMMON,
)


def section_modules(section: str) -> tuple[str, ...]:
    """Return the root modules of a section: a key covers them and all that they import.

    A section that is none of `_SECTIONS` is a linkage task, and all tasks have the same.
    """
    return _SECTIONS.get(section, _LINKAGE)


def plugin_modules(plugins: Iterable[Plugin]) -> tuple[str, ...]:
    """Return the modules of plug-ins: a key covers them and all that they import."""
    return tuple(plugin.origin.partition(":")[0] for plugin in plugins)


def consumer_key(consumer: Consumer, *, code: Iterable[str], keep_scores: bool) -> str:
    """Return the key of a consumer, from its plug-ins, its knowledge and its code.

    `code` has digests. A linkage attack or control with its raw scores has another key.
    """
    content = [
        consumer.spec,
        [
            [plugin.spec, plugin.origin, *filter(None, [plugin.digest])]
            for plugin in consumer.plugins
        ],
        consumer.adversary,
        sorted(item.name for item in consumer.granted),
        *code,
    ]
    if keep_scores and consumer.kind in {"linkage", "link_bound", "control"}:
        content.append("scores")
    if consumer.world:
        content.append(consumer.world.text)
    return digest(content)


def digest(content: object) -> str:
    """Return a short digest of a value that can be written as JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
