"""What several attacks make of one release, or one attack for several adversaries, is made once."""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, TypeVar
from weakref import WeakKeyDictionary

from isac_track.noise import innovation_variance_m2

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Concatenate, ParamSpec

    from isac_track.types import Floats, Release

    _P = ParamSpec("_P")
_Found = TypeVar("_Found")


def remembered(
    function: Callable[Concatenate[Release, _P], _Found],
) -> Callable[Concatenate[Release, _P], _Found]:
    """Return a function that keeps what it makes of a release for as long as that is alive.

    What else it takes comes by position and can be hashed: numbers, parameters, other releases.
    """
    known: WeakKeyDictionary[Release, dict[object, _Found]] = WeakKeyDictionary()

    @wraps(function)
    def recalled(release: Release, *rest: _P.args, **none: _P.kwargs) -> _Found:
        of_this = known.setdefault(release, {})
        if rest not in of_this:
            of_this[rest] = function(release, *rest, **none)
        return of_this[rest]

    return recalled


@remembered
def noise_m2(release: Release) -> Floats:
    """Return the error variance per axis of each track, (N,) m^2, as its innovations have it."""
    return innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
