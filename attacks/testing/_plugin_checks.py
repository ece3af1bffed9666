"""Cases of mechanisms and predictors, and the checks that hold for these alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, ClassVar
from unittest import SkipTest

import numpy as np
from numpy.random import Generator

from attacks.testing import _checks as common
from attacks.testing import _releases as made
from isac_track.protocols import knowing
from isac_track.sharing import Fixed
from isac_track.testing.engine import Body, by_name, call
from isac_track.types import (
    SHARED_LIMIT_M,
    Complexes,
    Floats,
    Ints,
    Knowledge,
    Prediction,
    Release,
    Sensed,
    within,
)

SHORT = (1, 2, 3, 40)  # Samples of the tracks of the odd cases.
HORIZON_S, N_STEPS = 3.0, 16
SIGMA_ERRORS, SIGMA_ROOM = 4.0, 0.02
"""Room about a declared variance: standard errors, and a share of it."""


@dataclass(frozen=True, eq=False, slots=True)
class MechanismCase(made.Case):
    """Sensed walks that a mechanism is asked to share."""

    asked: ClassVar[tuple[str, ...]] = ("sensed",)
    compared: ClassVar[str] = "t, xy or sigma"
    unit: ClassVar[str] = " s or m"

    sensed: Sensed

    def prepared(
        self,
        mechanism: made.Plugin,
        _given: frozenset[Knowledge],
        rng: Generator,
        _actor: str,
    ) -> made.Plugin:
        """Return the function that shares, with its random stream."""
        return lambda sensed: mechanism.share(sensed, rng)

    def read(self, result: object) -> Floats:
        """Return track, t, xy and sigma, if declared, of all samples; or ValueError."""
        if not isinstance(result, Release):
            raise ValueError(  # noqa: TRY004 - a stranger's
                f"share must return a Release, got {type(result).__name__}"
            )
        if len(result) != len(self.sensed):
            raise ValueError(f"of {len(self.sensed)} tracks it returned {len(result)}")
        track = np.repeat(np.arange(len(result)), np.diff(result.offsets))
        sigma = [] if result.sigma is None else [result.sigma]
        return np.column_stack([track, result.t, result.xy, *sigma])

    def fault(self, release: Release) -> str:
        if not within(release.xy, -SHARED_LIMIT_M, SHARED_LIMIT_M):
            return f"a position is not within {SHARED_LIMIT_M:g} m of the origin"
        return self.match_samples(release)[1]

    def match_samples(self, release: Release) -> tuple[Ints, str]:
        """Return the sensed sample of each shared sample, and the fault if any."""
        shared, known = _track_and_time(release), _track_and_time(self.sensed)
        rows = np.minimum(np.searchsorted(known, shared), known.size - 1)
        strange = shared[known[rows] != shared]
        if strange.size == 0:
            return rows, ""
        fault = (
            f"in track {strange[0].real:g} nothing was sensed at"
            f" {strange[0].imag:.12g} s"
        )
        return rows, f"{fault}; samples may be left out, not moved in time or added"

    def reordered(self) -> tuple[MechanismCase, Callable[[Floats], Floats]]:
        """Return the case with its tracks in another order, and the map of answers."""
        rows = made.draws("plugin", "order").permutation(len(self.sensed))
        parts = [self.sensed[row] for row in rows]
        arrays: dict[str, Any] = {
            item.name: np.concatenate([getattr(part, item.name) for part in parts])
            for item in fields(self.sensed)
            if item.metadata.get("per") and getattr(self.sensed, item.name) is not None
        }
        offsets = np.cumsum([0, *(part.t.size for part in parts)])
        changed = replace(self, sensed=replace(self.sensed, offsets=offsets, **arrays))

        def follow(answer: Floats) -> Floats:
            place = np.argsort(rows)[answer[:, 0].astype(np.int64)]
            order = np.argsort(place, kind="stable")
            return np.column_stack([place, answer[:, 1:]])[order]

        return changed, follow

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[MechanismCase, MechanismCase]:
        """Return 24 ordinary walks, and the longest of them by itself."""
        sizes = tuple(60 + 6 * row for row in range(24))
        return _sensed(sizes, made.STEADY_S), _sensed(sizes[-1:], made.STEADY_S)

    def odd(self) -> Iterator[MechanismCase]:
        """Yield tracks that are alone, have few samples, or steps of 1 ms to 30 s."""
        for steps_s in (made.STEADY_S, made.IRREGULAR_S):
            for sizes in (SHORT, *((size,) for size in SHORT)):
                yield _sensed(sizes, steps_s)


def _track_and_time(batch: Release | Sensed) -> Complexes:
    """Return track + 1j * t of each sample, which numpy orders by track, then time."""
    track = np.repeat(np.arange(len(batch)), np.diff(batch.offsets))
    return np.asarray(track + 1j * batch.t)


# Made-up walks, the same for every plug-in; for the process.
@cache
def _sensed(sizes: tuple[int, ...], steps_s: tuple[float, float]) -> MechanismCase:
    walks = made.walks("plugin", "sensed", sizes=sizes, steps_s=steps_s)
    return MechanismCase(_about(sizes, steps_s), made.sensed(walks, ("plugin", *sizes)))


def _about(sizes: tuple[int, ...], steps_s: tuple[float, float]) -> str:
    samples = f"{len(sizes)} tracks of {min(sizes)} to {max(sizes)} samples"
    return f"{samples}, {steps_s[0]:.3g} to {steps_s[1]:.3g} s apart"


def sigma_is_declared(row: common.Row) -> None:
    """Every sample has a declared standard deviation, finite and not negative."""
    (release,) = row.results(row.ordinary)
    sigma = release.sigma
    if sigma is None or not within(sigma, 0.0, SHARED_LIMIT_M):
        wrong = (
            "is None" if sigma is None else "is negative, or no number within the limit"
        )
        row.fail(
            row.ordinary, f"sigma {wrong}; declare the whole error of every sample, m"
        )


def sigma_is_that_of_the_error(row: common.Row) -> None:
    """The errors of a release have the standard deviation that it declares."""
    if not getattr(row.subject, "adds_error", True):
        raise SkipTest("adds_error = False: it adds no error of a standard deviation")
    sensed = row.ordinary.sensed
    if getattr(row.subject, "law", None) not in (None, sensed.law):
        raise SkipTest("its error has a law of its own")
    (release,) = row.results(row.ordinary)
    samples, wrong = row.ordinary.match_samples(release)
    if wrong or release.sigma is None:
        raise SkipTest(wrong or "it declares no sigma")
    truth = (sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error)[samples]
    squared = np.sum((release.xy - truth) ** 2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(release.sigma > 0, squared / release.sigma**2, np.inf)
    per_track = np.add.reduceat(ratio, release.offsets[:-1]) / np.diff(release.offsets)
    mean, std_error = per_track.mean(), per_track.std(ddof=1) / np.sqrt(per_track.size)
    if not abs(mean - 1.0) <= SIGMA_ROOM + SIGMA_ERRORS * std_error:
        times = f"{mean:.3g} times what is declared ({std_error:.2g} standard error)"
        hint = "If it adds no error of a standard deviation, say adds_error = False"
        requirement = f"sigma is that of the whole error, raw and added. {hint}"
        row.fail(row.ordinary, f"the error's variance is {times}; {requirement}")


def another_rng_another_release(row: common.Row) -> None:
    """Under another `rng` all pseudonyms change, and so do independent errors."""
    mechanism, case = row.subject, row.ordinary
    (first,), (second,) = (row.results(case, seed=seed) for seed in range(2))
    names, repeated = first.pseudonym, set(first.pseudonym) & set(second.pseudonym)
    if repeated or len(set(names)) < len(names):
        wrong = (
            f"{min(repeated)!r} comes again under another rng"
            if repeated
            else "two tracks share one"
        )
        row.fail(case, f"pseudonyms: {wrong}; `perturb` draws them afresh")
    is_independent = getattr(mechanism, "adding", "") == "independent"
    # With reuse="session" errors depend on the walk alone.
    is_independent &= getattr(mechanism, "reuse", "release") != "session"
    adds = getattr(mechanism, "adds_error", True) and not np.array_equal(
        first.xy, case.sensed.xy
    )
    if is_independent and adds and np.array_equal(first.xy, second.xy):
        row.fail(
            case,
            'adding is "independent", but two rng give one error; draw it from rng',
        )


MECHANISM: dict[str, Body] = {
    "result_is_a_release": common.result_is_right,
    **by_name(sigma_is_declared, sigma_is_that_of_the_error),
    "sensed_is_not_mutated": common.inputs_are_not_mutated,
    "same_rng_same_release": common.same_seed_same_result,
    **by_name(another_rng_another_release),
    "odd_tracks_are_shared": common.odd_tracks_are_handled,
    "order_of_sensed_tracks_does_not_matter": common.order_of_tracks_does_not_matter,
}


@dataclass(frozen=True, eq=False, slots=True)
class PredictorCase(made.Case):
    """A release, and the times for which a predictor is asked."""

    asked: ClassVar[tuple[str, ...]] = ("release", "t_future")
    compared: ClassVar[str] = "mean or cov"
    unit: ClassVar[str] = " m or m^2"
    mechanism: ClassVar[Fixed] = Fixed(0.25)  # An aware predictor knows it.

    release: Release
    t_future: Floats  # (N, H) s

    def prepared(
        self,
        predictor: made.Plugin,
        _given: frozenset[Knowledge],
        _rng: Generator,
        actor: str,
    ) -> made.Plugin:
        """Return the function that predicts; it knows the mechanism if it is aware."""
        actor = f"{actor} knowing"
        return call(knowing, predictor, self.mechanism, actor=actor).predict

    def read(self, result: object) -> Floats:
        """Return means and covariances, if any, a row for each track; or ValueError."""
        if not isinstance(result, Prediction):
            raise ValueError(  # noqa: TRY004 - a stranger's
                f"predict must return a Prediction, got {type(result).__name__}"
            )
        expected = (*self.t_future.shape, 2)
        if result.mean.shape != expected:
            raise ValueError(
                f"mean has shape {result.mean.shape}, expected (N, H, 2) = {expected}"
            )
        parts = [part for part in (result.mean, result.cov) if part is not None]
        return np.column_stack([part.reshape(len(self.release), -1) for part in parts])

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[PredictorCase, PredictorCase]:
        """Return 8 ordinary walks and 16 times, and the last time by itself."""
        case = _asked(tuple(20 + 4 * row for row in range(8)), made.STEADY_S)
        return case, replace(case, t_future=case.t_future[:, -1:])

    def odd(self) -> Iterator[PredictorCase]:
        """Yield tracks of few samples, and steps of 1 ms to 30 s."""
        return (_asked(SHORT, steps_s) for steps_s in (made.STEADY_S, made.IRREGULAR_S))


# As above.
@cache
def _asked(sizes: tuple[int, ...], steps_s: tuple[float, float]) -> PredictorCase:
    walks = made.walks("plugin", "asked", sizes=sizes, steps_s=steps_s)
    release = made.shared(walks, ("plugin", *sizes), mechanism=PredictorCase.mechanism)
    t_future = release.t[release.offsets[1:] - 1][:, None] + np.linspace(
        0.0, HORIZON_S, N_STEPS
    )
    return PredictorCase(_about(sizes, steps_s), release, t_future)


def lone_track_is_predicted_as_in_batch(row: common.Row) -> None:
    """A track by itself has the same prediction as in the batch."""
    case = row.ordinary
    together = row.answer(case)
    for number, track in enumerate(case.release):
        single = row.answer(
            replace(case, release=track, t_future=case.t_future[[number]])
        )[0]
        if single.shape != together[number].shape:
            row.fail(
                case, f"track {number} alone has a covariance, or has none any more"
            )
        if not np.allclose(
            single, together[number], rtol=common.SAME, atol=common.SAME
        ):
            gap = float(np.abs(single - together[number]).max())
            row.fail(
                case,
                f"track {number} alone is predicted otherwise: mean or cov by"
                f" {gap:.3g}",
            )


def track_is_causal(row: common.Row) -> None:
    """`track`, if there is one, returns a place per sample, from no later sample."""
    if getattr(row.subject, "track", None) is None:
        raise SkipTest("it has no track")
    for case in (*row.ordinary.odd(), row.ordinary):
        release = (
            case.release
            if Knowledge.SIGMA in row.given
            else case.release.without_sigma()
        )
        actor = f"{row}, {case.about}: track"
        track = call(knowing, row.subject, case.mechanism, actor=actor).track
        first = np.repeat(release.offsets[:-1], np.diff(release.offsets))
        late = np.arange(release.t.size) - first > np.diff(release.offsets).min() // 2
        moved = replace(release, xy=release.xy + np.where(late, 7.0, 0.0)[:, None])
        places = call(track, release, actor=actor)
        others = call(track, moved, actor=actor)
        if np.shape(places) != release.xy.shape or not np.isfinite(places).all():
            row.fail(
                case, f"track must return finite places, (M, 2) = {release.xy.shape}"
            )
        gap = np.abs(others - places)[~late].max()
        if not gap <= common.SAME:
            row.fail(
                case, f"track: later samples move what was known before by {gap:.3g} m"
            )


PREDICTOR: dict[str, Body] = {
    "result_is_a_prediction": common.result_is_right,
    "only_required_knowledge_is_touched": common.only_granted_knowledge_is_touched,
    "release_is_not_mutated": common.inputs_are_not_mutated,
    "same_release_same_prediction": common.same_seed_same_result,
    "one_track_is_predicted_as_among_others": lone_track_is_predicted_as_in_batch,
    "odd_tracks_are_predicted": common.odd_tracks_are_handled,
    **by_name(track_is_causal),
}
