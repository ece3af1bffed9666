"""One release of a mechanism, checked, and who sees nothing of a level but its release."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING

from evaluation.cells.plugin_calls import copied, guarded
from evaluation.cells.samples import samples_shared
from isac_track.errors import PluginError
from isac_track.rng import stream
from isac_track.types import SHARED_LIMIT_M, Knowledge, Release, within

if TYPE_CHECKING:
    from evaluation.experiment.axes import Consumer
    from isac_track.plugins import Plugin
    from isac_track.types import Sensed


def share(mechanism: Plugin, sensed: Sensed, *key: str | int, seed: int) -> Release:
    """Return what a mechanism shares of what was sensed.

    Parameters
    ----------
    mechanism : Plugin
    sensed : Sensed
    *key : str or int
        Name of the stream. Every mechanism gets the same one: common random numbers.
    seed : int

    Raises
    ------
    PluginError
        If the mechanism raises or breaks its contract; the message names it.
    """
    who = f"mechanism {mechanism.spec!r}"
    rng = stream(seed, "sharing", *key)
    release = guarded(who, lambda: mechanism.instance.share(copied(sensed), rng))
    if not isinstance(release, Release):
        raise PluginError(f"{who} must return a Release, got {type(release).__name__}")
    try:
        samples_shared(release, sensed)
    except ValueError as error:
        raise PluginError(f"{who} changed the tracks or their times: {error}") from None
    _check_shared(release, who=who)
    # Fresh for every release: the common stream gives every mechanism the same ones.
    names = stream(seed, "pseudonyms", mechanism.spec, *key).bytes(8 * len(release))
    fresh = tuple(names[8 * row : 8 * row + 8].hex() for row in range(len(release)))
    return replace(release, pseudonym=fresh)


def share_block(mechanism: Plugin, sensed: Sensed, number: int, *, seed: int) -> Release:
    """Return what a mechanism shares of a block of scenes, which is given by its number."""
    return share(mechanism, sensed, "block", number, seed=seed)


def _check_shared(release: Release, *, who: str) -> None:
    """Raise PluginError if what was shared is no number to compute with."""
    if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
        raise PluginError(
            f"{who} shared a position that is not within {SHARED_LIMIT_M:g} m of the origin"
        )
    if release.sigma is None or within(release.sigma, 0.0, SHARED_LIMIT_M):
        return
    if not (release.sigma >= 0).all():
        raise PluginError(f"{who} declared a sigma below 0 or NaN")
    raise PluginError(f"{who} declared a sigma above {SHARED_LIMIT_M:g} m, the limit")


def release_digest(*releases: Release) -> bytes:
    """Return a digest of all that releases hold but their pseudonyms."""
    digest = hashlib.sha256()
    for one in releases:
        for array in (one.t, one.xy, one.sigma, one.offsets):
            digest.update(b"none" if array is None else str(array.shape).encode() + array.tobytes())
    return digest.digest()


def sees_release_alone(consumer: Consumer) -> bool:
    """Whether a consumer leaves the same of two levels whose releases are the same.

    Ours do that know no mechanism. Controls and reconstructions draw from a stream of the level,
    and so may whatever a stranger wrote.
    """
    if consumer.kind in {"shared", "windows"}:
        return True
    plugins = [one for one in (consumer.plugin, consumer.behind) if one is not None]
    return (
        consumer.kind in {"predictor", "linkage"}
        and all(one.origin.startswith(("predictors.", "attacks.")) for one in plugins)
        and Knowledge.MECHANISM not in consumer.granted
    )
