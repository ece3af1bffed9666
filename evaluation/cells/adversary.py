"""What an adversary is given: a release as it shows, a context of what was granted, and calls.

Reconstructions and linkers get theirs by the same rules, wherever they stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.cells.plugin_calls import guarded
from isac_track.errors import PluginError
from isac_track.protocols import AttackContext
from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.random import Generator

    from isac_track.plugins import Plugin
    from isac_track.protocols import LinkageTrainingSet, TrainingSet
    from isac_track.types import Floats, Release

SHOWS = frozenset({Knowledge.SIGMA, Knowledge.SCENE})
"""Knowledge that shows in the release itself."""
FAR_M = 1000.0
LONG_S = 86_400.0
"""How far off, and how long ago, an adversary's frame and clock may begin."""


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """A release in an adversary's frame: turned by the angle, then shifted."""

    release: Release
    angle: float
    """radians"""
    shift: Floats
    """(2,) m"""


def view_of(release: Release, *, granted: frozenset[Knowledge], rng: Generator) -> View:
    """Return a release as it shows: without SCENE turned, shifted, and on another clock."""
    release = showing(release, granted)
    if Knowledge.SCENE in granted:
        return View(release, 0.0, np.zeros(2))
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    shift = rng.uniform(-FAR_M, FAR_M, 2)
    moved = replace(
        release,
        xy=turned(release.xy, angle=angle, shift=shift),
        t=release.t + rng.uniform(0.0, LONG_S),
    )
    return View(moved, angle, shift)


def showing(release: Release, granted: frozenset[Knowledge]) -> Release:
    """Return a release with its standard deviations for who is granted SIGMA alone."""
    return release if Knowledge.SIGMA in granted else release.without_sigma()


def turned(xy: Floats, *, angle: float, shift: Floats | tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return positions turned by an angle and shifted, (M, 2)."""
    # Not a matrix product: for two columns its threads cost more than they bring.
    cos, sin = np.cos(angle), np.sin(angle)
    moved = np.empty_like(xy)
    moved[:, 0] = cos * xy[:, 0] - sin * xy[:, 1] + shift[0]
    moved[:, 1] = sin * xy[:, 0] + cos * xy[:, 1] + shift[1]
    return moved


def declared(plugin: Plugin) -> frozenset[Knowledge]:
    """Return what a plug-in says that it needs or takes."""
    wanted: frozenset[Knowledge] = plugin.instance.requires | plugin.instance.uses
    return wanted


def granted_at(
    granted: frozenset[Knowledge], plugin: Plugin, *, who: str, mechanism: Plugin, has_sigma: bool
) -> frozenset[Knowledge]:
    """Return what an attack gets at a level: without SIGMA where the mechanism declares none.

    Raises
    ------
    PluginError
        If the attack cannot do without.
    """
    if Knowledge.SIGMA not in granted or has_sigma:
        return granted
    if Knowledge.SIGMA in plugin.instance.requires:
        raise PluginError(
            f"{who} requires SIGMA, but mechanism {mechanism.spec!r} declares none; leave one of "
            "the two out"
        )
    return granted - {Knowledge.SIGMA}


def fitted(
    plugin: Plugin,
    *,
    who: str,
    granted: frozenset[Knowledge],
    mechanism: Plugin,
    rng: Generator,
    epsilon_m: float,
    train: TrainingSet | LinkageTrainingSet | None,
    repeats: tuple[Release, ...] | None = None,
) -> Callable[..., Any]:
    """Return what an attack prepares from what it is granted.

    Raises
    ------
    PluginError
        If it raises; the message names it.
    """
    context = AttackContext(
        rng=rng,
        epsilon_m=epsilon_m,
        granted=granted,
        mechanism=mechanism.instance,
        train=train,
        repeats=repeats,
    )
    prepared: Callable[..., Any] = guarded(who, lambda: plugin.instance.fit(context))
    return prepared


def reconstructed(attack: Callable[[Release], object], release: Release, *, who: str) -> Floats:
    """Return what a fitted attack makes of a release, (M, 2) m in its frame.

    Raises
    ------
    PluginError
        If it raises or returns anything else; the message names it.
    """
    found = guarded(who, lambda: attack(release))
    if not isinstance(found, Reconstruction) or found.xy.shape != release.xy.shape:
        got = getattr(getattr(found, "xy", None), "shape", type(found).__name__)
        raise PluginError(
            f"{who} must return a Reconstruction with xy {release.xy.shape}, got {got}"
        )
    return found.xy
