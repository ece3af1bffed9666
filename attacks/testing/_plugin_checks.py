"""What holds for every mechanism and for every predictor, on made-up walks."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn
from unittest import SkipTest

import numpy as np

from attacks.testing import _releases as made
from attacks.testing._checks import SAME, SPREADS
from attacks.testing._releases import changed_by
from isac_track.protocols import knowing
from isac_track.rng import stream
from isac_track.sharing import Fixed
from isac_track.testing.engine import call
from isac_track.types import (
    SHARED_LIMIT_M,
    Floats,
    Ints,
    Knowledge,
    Prediction,
    Release,
    Sensed,
    stretches,
    within,
)

if TYPE_CHECKING:
    from isac_track.protocols import Mechanism, Predictor

N_TRACKS = 24
SHORT = (1, 2, 3, 40)  # Samples of the tracks of the odd cases.
HORIZON_S, N_STEPS = 3.0, 16
SIGMA_ERRORS, SIGMA_ROOM = 4.0, 0.02
"""The variance may differ from what is declared by so many standard errors over the tracks, and by
this share."""


@cache
def _sensed(
    sizes: tuple[int, ...] = tuple(60 + 6 * row for row in range(N_TRACKS)),
    steps_s: tuple[float, float] = made.STEADY_S,
) -> Sensed:
    """Return what a mechanism is asked to share: as most are, if nothing else is said."""
    walks = made.walks("plugin", "sensed", sizes=sizes, steps_s=steps_s)
    return made.sensed(walks, ("plugin", *sizes))


def _fail(plugin: object, what: str) -> NoReturn:
    raise AssertionError(f"{type(plugin).__name__}: {what}")


def _called(plugin: Any, method: str, expected: type, *given: object) -> Any:  # noqa: ANN401 - a stranger's
    """Return what a method returns; what it raises, or another type, fails the check."""
    result = call(getattr(plugin, method), *given, who=f"{type(plugin).__name__}: {method}")
    if not isinstance(result, expected):
        _fail(plugin, f"{method} must return a {expected.__name__}, got {type(result).__name__}")
    return result


def _expect_unchanged(
    plugin: object, method: str, before: tuple[object, ...], *more: object
) -> None:
    for path in changed_by(lambda given: _called(plugin, method, object, *given, *more), before):
        _fail(plugin, f"changed its input {path}; others read the same arrays: work on a copy")


def _bits(result: object) -> list[bytes]:
    return [array.tobytes() for array in made.arrays_of(result).values()]


# A mechanism


def _share(mechanism: Mechanism, sensed: Sensed, *, seed: int = 0) -> Release:
    rng = stream(seed, "attacks", "testing", "mechanism")
    release: Release = _called(mechanism, "share", Release, made.copied(sensed), rng)
    if len(release) != len(sensed):
        _fail(mechanism, f"of {len(sensed)} tracks it returned {len(release)}")
    return release


def _rows_shared(mechanism: Mechanism, release: Release, sensed: Sensed) -> Ints:
    """Return which of the sensed samples are shared; one that was not sensed fails the check."""
    # Number of the track and time: numpy orders complex numbers by the real part first.
    shared, known = (
        np.repeat(np.arange(len(one)), np.diff(one.offsets)) + 1j * one.t
        for one in (release, sensed)
    )
    rows = np.minimum(np.searchsorted(known, shared), known.size - 1)
    for strange in shared[known[rows] != shared]:
        _fail(
            mechanism,
            f"in track {strange.real:g} nothing was sensed at {strange.imag:.12g} s; samples may "
            "be left out, not moved in time or added",
        )
    return rows


def result_is_a_release(mechanism: Mechanism) -> None:
    """`share` returns a Release of the same tracks, at instants of which each was sensed."""
    release = _share(mechanism, _sensed())
    _rows_shared(mechanism, release, _sensed())
    if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
        _fail(mechanism, f"a position is not within {SHARED_LIMIT_M:g} m of the origin")


def sigma_is_declared(mechanism: Mechanism) -> None:
    """Every sample has a declared standard deviation, finite and not negative."""
    sigma = _share(mechanism, _sensed()).sigma
    if sigma is None or not within(sigma, 0.0, SHARED_LIMIT_M):
        wrong = "is None" if sigma is None else "is negative, or no number within the limit"
        _fail(mechanism, f"sigma {wrong}; declare the whole error of every sample, m")


def sigma_is_that_of_the_error(mechanism: Mechanism) -> None:
    """What is shared lies as far from the truth as its declared standard deviation says."""
    if not getattr(mechanism, "adds_error", True):
        raise SkipTest("adds_error = False: it adds no error of a standard deviation")
    sensed = _sensed()
    if getattr(mechanism, "law", None) not in (None, sensed.law):
        raise SkipTest("its error has a law of its own")
    release = _share(mechanism, sensed)
    if release.sigma is None:
        raise SkipTest("it declares no sigma")
    try:
        rows = _rows_shared(mechanism, release, sensed)
    except AssertionError as error:
        raise SkipTest(str(error)) from None
    truth = (sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error)[rows]
    squared = np.sum((release.xy - truth) ** 2, axis=1)
    ratio = np.divide(
        squared, release.sigma**2, out=np.full_like(squared, np.inf), where=release.sigma > 0
    )
    per_track = np.add.reduceat(ratio, release.offsets[:-1]) / np.diff(release.offsets)
    mean, std_error = per_track.mean(), per_track.std(ddof=1) / np.sqrt(per_track.size)
    if not abs(mean - 1.0) <= SIGMA_ROOM + SIGMA_ERRORS * std_error:
        _fail(
            mechanism,
            f"the error's variance is {mean:.3g} times what is declared ({std_error:.2g} standard "
            "error); sigma is that of the whole error, raw and added. If it adds no error of a "
            "standard deviation, say adds_error = False",
        )


def sensed_is_not_mutated(mechanism: Mechanism) -> None:
    """What was sensed is left as it came."""
    _expect_unchanged(mechanism, "share", (_sensed(),), made.draws("plugin", "share"))


def same_rng_same_release(mechanism: Mechanism) -> None:
    """Two calls with one random stream share the same, to the last bit."""
    first, second = (_bits(_share(mechanism, _sensed())) for _ in range(2))
    if first != second:
        _fail(mechanism, "two calls with one rng differ; draw from it alone, and keep nothing")


def another_rng_another_release(mechanism: Mechanism) -> None:
    """Under another `rng` independent errors are others, and so is every pseudonym."""
    first, second = (_share(mechanism, _sensed(), seed=seed) for seed in range(2))
    names, again = first.pseudonym, set(first.pseudonym) & set(second.pseudonym)
    if again or len(set(names)) < len(names):
        wrong = f"{min(again)!r} comes again under another rng" if again else "two tracks share one"
        _fail(mechanism, f"pseudonyms: {wrong}; `perturb` draws them afresh")
    is_independent = getattr(mechanism, "adding", "") == "independent"
    is_independent &= getattr(mechanism, "reuse", "release") != "session"  # drawn from the walk
    adds = getattr(mechanism, "adds_error", True) and not np.array_equal(first.xy, _sensed().xy)
    if is_independent and adds and np.array_equal(first.xy, second.xy):
        _fail(mechanism, 'adding is "independent", but two rng give one error; draw it from rng')


def odd_tracks_are_shared(mechanism: Mechanism) -> None:
    """A track may be alone, have one sample, or steps of 1 ms to 30 s."""
    for steps_s in (made.STEADY_S, made.IRREGULAR_S):
        for sizes in (SHORT, *((size,) for size in SHORT)):
            _share(mechanism, _sensed(sizes, steps_s))


def order_of_sensed_tracks_does_not_matter(mechanism: Mechanism) -> None:
    """Tracks in another order are shared in that order, and otherwise alike."""
    sensed = _sensed()
    rows = made.draws("plugin", "order").permutation(len(sensed))
    samples, offsets = stretches(sensed.offsets[rows], np.diff(sensed.offsets)[rows])
    moved: dict[str, Any] = {
        item.name: getattr(sensed, item.name)[samples if per == "sample" else rows]
        for item in fields(sensed)
        if (per := item.metadata.get("per"))
    }
    turned = _share(mechanism, replace(sensed, offsets=offsets, **moved))
    plain, redrawn = (_share(mechanism, sensed, seed=seed).tracks(rows) for seed in range(2))
    if plain.t.shape != redrawn.t.shape:
        raise SkipTest("how many samples it shares is drawn")
    for name in ("t", "xy", "sigma"):
        expected, got, other = (getattr(one, name) for one in (plain, turned, redrawn))
        if expected is None or got is None or other is None:
            continue
        # Errors that are drawn are others then; they can only be expected to be as large.
        room = SAME + SPREADS * float(np.sqrt(np.mean((other - expected) ** 2)))
        alike = got.shape == expected.shape and np.sqrt(np.mean((got - expected) ** 2)) <= room
        if not alike:
            hint = "does anything run from one track into the next, or depend on its number?"
            _fail(mechanism, f"with the tracks in another order {name} differs; {hint}")


MECHANISM = (
    result_is_a_release,
    sigma_is_declared,
    sigma_is_that_of_the_error,
    sensed_is_not_mutated,
    same_rng_same_release,
    another_rng_another_release,
    odd_tracks_are_shared,
    order_of_sensed_tracks_does_not_matter,
)
"""In the order in which they run."""


# A predictor


_ADDED = Fixed(0.25)  # What shares; one that is aware is told of it.


@cache
def _asked(
    sizes: tuple[int, ...] = tuple(20 + 4 * row for row in range(8)),
    steps_s: tuple[float, float] = made.STEADY_S,
) -> tuple[Release, Floats]:
    """Return a release and the times for which a predictor is asked: as most are."""
    walks = made.walks("plugin", "asked", sizes=sizes, steps_s=steps_s)
    release = made.shared(walks, ("plugin", *sizes), mechanism=_ADDED)
    last = release.t[release.offsets[1:] - 1]
    return release, last[:, None] + np.linspace(0.0, HORIZON_S, N_STEPS)


def _granted(predictor: Predictor, release: Release) -> tuple[Any, Release]:
    """Return a predictor as it is where the mechanism shares, and what it receives there."""
    who = f"{type(predictor).__name__}: knowing"
    has_sigma = Knowledge.SIGMA in predictor.requires
    return call(knowing, predictor, _ADDED, who=who), (
        release if has_sigma else release.without_sigma()
    )


def _predict(
    predictor: Predictor, release: Release, t_future: Floats, *, strictly: bool = False
) -> Prediction:
    """Return a prediction from what is granted; who touches more fails `strictly` alone."""
    ready, granted = _granted(predictor, release)

    def predicted(given: Release) -> Prediction:
        asked = made.copied(given), t_future.copy()
        prediction: Prediction = _called(ready, "predict", Prediction, *asked)
        return prediction

    try:
        found = predicted(granted)
    except AssertionError:
        if strictly:
            raise
        found = predicted(release)
    if found.mean.shape != (*t_future.shape, 2):
        expected = f"(N, H, 2) = {(*t_future.shape, 2)}"
        _fail(predictor, f"mean has shape {found.mean.shape}, expected {expected}")
    return found


def result_is_a_prediction(predictor: Predictor) -> None:
    """`predict` returns a Prediction for every track and time, for one time as well."""
    release, t_future = _asked()
    for times in (t_future, t_future[:, -1:]):
        _predict(predictor, release, times)


def only_required_knowledge_is_touched(predictor: Predictor) -> None:
    """Without the declared standard deviations it runs, or `requires` SIGMA."""
    _predict(predictor, *_asked())  # any other fault is not blamed on knowledge
    try:
        _predict(predictor, *_asked(), strictly=True)
    except AssertionError as error:
        hint = "release.sigma is None unless `requires` has Knowledge.SIGMA"
        raise AssertionError(f"{error}; {hint}") from error


def release_is_not_mutated(predictor: Predictor) -> None:
    """The release and the times asked for are left as they came."""
    _expect_unchanged(predictor, "predict", _asked())


def same_release_same_prediction(predictor: Predictor) -> None:
    """Asked twice it answers alike, to the last bit."""
    first, second = (_bits(_predict(predictor, *_asked())) for _ in range(2))
    if first != second:
        _fail(predictor, "two calls differ; draw nothing, and keep nothing from call to call")


def one_track_is_predicted_as_among_others(predictor: Predictor) -> None:
    """A track alone is predicted as in the batch."""
    release, t_future = _asked()
    together = _predict(predictor, release, t_future)
    for row, track in enumerate(release):
        alone = _predict(predictor, track, t_future[row : row + 1])
        for name in ("mean", "cov"):
            one, among = getattr(alone, name), getattr(together, name)
            if (one is None) != (among is None):
                _fail(predictor, f"track {row} alone has a covariance, or has none any more")
            if one is not None and not np.allclose(one[0], among[row], rtol=SAME, atol=SAME):
                gap = float(np.abs(one[0] - among[row]).max())
                _fail(predictor, f"track {row} alone is predicted otherwise: {name} by {gap:.3g}")


def odd_tracks_are_predicted(predictor: Predictor) -> None:
    """A track may have one sample, or steps of 1 ms to 30 s."""
    for steps_s in (made.STEADY_S, made.IRREGULAR_S):
        _predict(predictor, *_asked(SHORT, steps_s))


def track_is_causal(predictor: Predictor) -> None:
    """What `track` returns, if there is one, is a place for every sample, from no later sample."""
    if getattr(predictor, "track", None) is None:
        raise SkipTest("it has no track")
    for shared in (_asked(SHORT, made.IRREGULAR_S)[0], _asked()[0]):
        ready, release = _granted(predictor, shared)
        first = np.repeat(release.offsets[:-1], np.diff(release.offsets))
        late = np.arange(release.t.size) - first > np.diff(release.offsets).min() // 2
        moved = replace(release, xy=release.xy + np.where(late, 7.0, 0.0)[:, None])
        places = [_called(ready, "track", np.ndarray, one) for one in (release, moved)]
        if places[0].shape != release.xy.shape or not np.isfinite(places[0]).all():
            _fail(predictor, f"track must return finite places, (M, 2) = {release.xy.shape}")
        gap = np.abs(places[1] - places[0])[~late].max()
        if not gap <= SAME:
            _fail(predictor, f"track: later samples move what was known before by {gap:.3g} m")


PREDICTOR = (
    result_is_a_prediction,
    only_required_knowledge_is_touched,
    release_is_not_mutated,
    same_release_same_prediction,
    one_track_is_predicted_as_among_others,
    odd_tracks_are_predicted,
    track_is_causal,
)
"""In the order in which they run."""
