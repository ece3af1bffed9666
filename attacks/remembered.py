"""Memoise what is computed from a release, and note where a release comes from.

Several attacks smooth the same release, and several adversaries run one attack:
`memoised` shares their results. Two notes lead from a release to another: `find_origin`
from some tracks to the release that they were selected from, `as_shared` from smoothed
positions to those shared. Results and notes live as long as their release; nobody
has to empty anything.
"""

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
_Result = TypeVar("_Result")
_Function = TypeVar("_Function", bound=Callable[..., Any])


def memoised(
    function: Callable[Concatenate[_Source, _Rest], _Result],
) -> Callable[Concatenate[_Source, _Rest], _Result]:
    """Memoise a function of a release for as long as that release is alive.

    Further arguments must be hashable: numbers, functions, other releases. Other
    releases are held by weak references: two that are compared with each other, or one
    with itself, would otherwise live for ever.
    """
    results: WeakKeyDictionary[_Source, dict[object, _Result]] = WeakKeyDictionary()

    @wraps(function)
    def recalled(
        source: _Source, /, *rest: _Rest.args, **named: _Rest.kwargs
    ) -> _Result:
        by_arguments = results.setdefault(source, {})
        key = (
            *(ref(value) if isinstance(value, Release) else value for value in rest),
            *named.items(),
        )
        if key not in by_arguments:
            by_arguments[key] = function(source, *rest, **named)
        return by_arguments[key]

    return recalled


_ORIGINS: WeakKeyDictionary[Release, tuple[Release, Ints]] = WeakKeyDictionary()
"""For each part of a release, while it is alive: the release, and the part's tracks."""


def select_tracks(release: Release, rows: Ints) -> Release:
    """Return some tracks of a release; `find_origin` leads back to the release."""
    selected = release.tracks(rows)
    origin, origin_rows = find_origin(release)
    _ORIGINS[selected] = origin, origin_rows[rows]
    return selected


def find_origin(release: Release) -> tuple[Release, Ints]:
    """Return the release that a part was selected from, and the part's tracks in it.

    A release that is no part of another is its own origin.
    """
    origin = _ORIGINS.get(release)
    return (release, np.arange(len(release))) if origin is None else origin


_SHARED: WeakKeyDictionary[Release, Release] = WeakKeyDictionary()
"""For each reconstructed release, while it is alive: the shared release behind it."""


def record_shared(release: Release, shared: Release) -> Release:
    """Record the shared release behind a reconstruction; return the latter."""
    _SHARED[release] = shared
    return release


def as_shared(release: Release) -> Release:
    """Return a release with its positions as shared: itself, if nothing smoothed it.

    An adversary who smooths positions still has the shared release. Only this shows how
    much noise was added: a smoother removes it.
    """
    origin, rows = find_origin(release)
    shared = _SHARED.get(origin)
    if shared is None:
        return release
    return shared if origin is release else select_tracks(shared, rows)


def memoised_by_track(
    take: Callable[[Any, Ints], Any] = getitem,
) -> Callable[[_Function], _Function]:
    """Memoise a function that treats every track by itself.

    For a part of a release, compute the result of the whole release once.
    ``take(result, rows)`` selects the part's tracks from it; by default these are the
    rows of an array.
    """

    def decorate(function: _Function) -> _Function:
        @memoised
        @wraps(function)
        def recalled(release: Release, /, *rest: object) -> Any:  # noqa: ANN401 - as the function
            origin, rows = find_origin(release)
            if origin is release:
                return function(release, *rest)
            return take(recalled(origin, *rest), rows)

        return cast("_Function", recalled)

    return decorate


@memoised_by_track()
def noise_m2(release: Release) -> Floats:
    """Return the error variance per axis of each track, (N,) m^2, by innovations."""
    return innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
