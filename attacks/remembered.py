"""What several attacks make of one release, or one attack for several adversaries, is made once."""

from collections.abc import Callable
from functools import wraps
from operator import getitem
from typing import Any, Concatenate, ParamSpec, TypeVar, cast
from weakref import WeakKeyDictionary, ref

import numpy as np

from isac_track.noise import innovation_variance_m2
from isac_track.types import Floats, Ints, Release

_Rest = ParamSpec("_Rest")
_Source = TypeVar("_Source")
_Found = TypeVar("_Found")
_Made = TypeVar("_Made", bound=Callable[..., Any])


def remembered(
    function: Callable[Concatenate[_Source, _Rest], _Found],
) -> Callable[Concatenate[_Source, _Rest], _Found]:
    """Return a function that keeps what it makes of a release for as long as that is alive.

    What else it takes can be hashed: numbers, functions, other releases. Of these it
    keeps nobody alive: two that are compared with each other, or one with itself, would
    live on for ever.
    """
    known: WeakKeyDictionary[_Source, dict[object, _Found]] = WeakKeyDictionary()

    @wraps(function)
    def recalled(
        source: _Source, /, *rest: _Rest.args, **named: _Rest.kwargs
    ) -> _Found:
        of_this = known.setdefault(source, {})
        key = (
            *(ref(one) if isinstance(one, Release) else one for one in rest),
            *named.items(),
        )
        if key not in of_this:
            of_this[key] = function(source, *rest, **named)
        return of_this[key]

    return recalled


_PARTS: WeakKeyDictionary[Release, tuple[Release, Ints]] = WeakKeyDictionary()


def part(release: Release, rows: Ints) -> Release:
    """Return some tracks of a release, of which `whole` tells where they are from."""
    some = release.tracks(rows)
    origin, among = whole(release)
    _PARTS[some] = origin, among[rows]
    return some


def whole(release: Release) -> tuple[Release, Ints]:
    """Return the release that one is a part of, or itself, and which of its tracks are in it."""
    known = _PARTS.get(release)
    return (release, np.arange(len(release))) if known is None else known


_SHARED: WeakKeyDictionary[Release, Release] = WeakKeyDictionary()
"""By reconstructed release, for as long as that is alive, the release that it was made from."""


def reconstructed_from(release: Release, shared: Release) -> Release:
    """Return a release with reconstructed positions, of which `as_shared` tells the shared ones."""
    _SHARED[release] = shared
    return release


def as_shared(release: Release) -> Release:
    """Return a release with the positions as they were shared: itself, if nothing smoothed it.

    Whoever smooths positions still has them. A smoother takes out the noise, and with
    it how much there was.
    """
    origin, rows = whole(release)
    shared = _SHARED.get(origin)
    if shared is None:
        return release
    return shared if origin is release else part(shared, rows)


def by_track(take: Callable[[Any, Ints], Any] = getitem) -> Callable[[_Made], _Made]:
    """Return what remembers what is made track by track: of a part it is made of the whole, once.

    `take` takes what belongs to some tracks from what was made of all.
    """

    def decorate(function: _Made) -> _Made:
        @remembered
        @wraps(function)
        def made(release: Release, /, *rest: object) -> Any:  # noqa: ANN401 - as the function
            origin, rows = whole(release)
            if origin is release:
                return function(release, *rest)
            return take(made(origin, *rest), rows)

        return cast("_Made", made)

    return decorate


@by_track()
def noise_m2(release: Release) -> Floats:
    """Return the error variance per axis of each track, (N,) m^2, as its innovations have it."""
    return innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
