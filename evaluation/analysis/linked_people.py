"""Who is linked at every level of a task, and what their own windows give away, summed by cluster.

Both axes of a comparison of mechanisms come from the same people: the descriptors are those of the
windows that are linked, not of the tracks in scenes. Everything is a ratio of sums over clusters,
so that a bootstrap, a jackknife or one half of the people are weights of these sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.analysis.keys import Source
    from isac_track.types import Floats


@dataclass(frozen=True, eq=False, slots=True)
class LinkedLevel:
    """One mechanism level of a task; clusters are numbered alike at all levels of the task."""

    mechanism: str
    level: float | None
    linker: Source
    """Whose success it is: of all linkers the strongest against this mechanism."""
    success: Floats
    """(C,) sum over the cluster's mated probes of rank-1 at a gallery of 100, or of their own"""
    chance: Floats
    """(C,) the same of a guess"""
    probes: Floats
    """(C,) mated probes"""
    descriptors: Mapping[str, Floats]
    """By name (2, C): sums over the cluster's linked windows that have a value, and their number"""


@dataclass(frozen=True, eq=False, slots=True)
class LinkedTask:
    """All levels of a task, raw among them."""

    task: str
    gallery: int | None
    """At which rank-1 is read: 100, or None where galleries are smaller and everybody's own is."""
    clusters: tuple[str, ...]
    """(C,) names, sorted"""
    levels: tuple[LinkedLevel, ...]
