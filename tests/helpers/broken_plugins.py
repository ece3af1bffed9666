"""Plausible mistakes in mechanisms and predictors: exactly one check catches each."""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from isac_track.sharing import perturb
from isac_track.types import Prediction


@dataclass(frozen=True)
class Noise:
    """Honest: independent errors, drawn from rng."""

    d_sigma: float = 0.4
    adding = "independent"

    def share(self, sensed, rng):
        return perturb(sensed, self.d_sigma, rng, adding="independent")


@dataclass(frozen=True)
class Stand:
    """Honest: nobody moves on."""

    requires = frozenset()

    def predict(self, release, t_future):
        last = release.xy[release.offsets[1:] - 1]
        return Prediction(np.repeat(last[:, None], t_future.shape[1], axis=1))


NOISE, STAND, CALLS = Noise(), Stand(), count()


def plugin(function):
    """A mechanism if the function takes `sensed`, else a predictor, of this method."""
    takes = function.__code__.co_varnames
    base, method = (Noise, "share") if "sensed" in takes else (Stand, "predict")
    if function.__code__.co_argcount == 1:
        method = "track"
    return type(
        function.__name__, (base,), {method: lambda _, *given: function(*given)}
    )()


BROKEN = []
"""(class, the one check that it fails, what the message says)"""


def fails(check, message):
    def decorate(function):
        BROKEN.append((type(plugin(function)), check, message))
        return function

    return decorate


@fails("result_is_a_release", "in track 0 nothing was sensed at")
def retimed(sensed, rng):
    release = NOISE.share(sensed, rng)
    return replace(release, t=release.t + 0.01)


@fails("sigma_is_declared", "sigma is None")
def undeclared(sensed, rng):
    return NOISE.share(sensed, rng).without_sigma()


@fails("sigma_is_that_of_the_error", "is 1..*adds_error = False")
def declares_d_sigma(sensed, rng):
    release = perturb(sensed, 0.1, rng, adding="independent")
    return replace(release, sigma=np.full_like(release.sigma, 0.1))


@fails("sensed_is_not_mutated", "changed sensed.xy; ")
def writes(sensed, rng):
    sensed.xy.flags.writeable = True
    sensed.xy[:] += 1.0
    release = NOISE.share(sensed, rng)
    return replace(release, xy=release.xy - 1.0)


@fails("same_rng_same_release", "draw from the rng that is given")
def own_dice(sensed, rng):
    release, again = (
        NOISE.share(sensed, rng),
        NOISE.share(sensed, np.random.default_rng()),
    )
    return replace(release, xy=again.xy)


@fails("another_rng_another_release", "two rng give one error")
def a_seed_for_a_place(sensed, rng):
    xy = []
    for track in sensed:
        own = np.random.default_rng(abs(int(1e6 * track.xy[0, 0])))
        xy.append(NOISE.share(track, own).xy)
    return replace(NOISE.share(sensed, rng), xy=np.concatenate(xy))


@fails("another_rng_another_release", "'0' comes again under another rng")
def numbered(sensed, rng):
    release = NOISE.share(sensed, rng)
    return replace(release, pseudonym=tuple(map(str, range(len(release)))))


@fails("odd_tracks_are_shared", "ValueError: .* (broken_plugins.py, line ")
def needs_two(sensed, rng):
    for track in sensed:
        np.diff(track.t).min()
    return NOISE.share(sensed, rng)


@fails(
    "order_of_sensed_tracks_does_not_matter",
    "in another order: t, xy or sigma differ by",
)
def by_number(sensed, rng):
    number = np.repeat(np.arange(len(sensed)), np.diff(sensed.offsets))
    return perturb(sensed, 0.1 * number, rng, adding="independent")


@fails("result_is_a_prediction", "asked for release and t_future, it raised IndexError")
def needs_a_grid(release, t_future):
    assert (np.diff(t_future)[:, 0] > 0).all()
    return STAND.predict(release, t_future)


@fails("only_required_knowledge_is_touched", "without SIGMA, release.sigma is None")
def takes_sigma(release, t_future):
    return Prediction(STAND.predict(release, t_future).mean + release.sigma.mean())


@fails("release_is_not_mutated", "changed release.xy; ")
def centres(release, t_future):
    result = STAND.predict(release, t_future)
    release.xy.flags.writeable = True
    release.xy[:] -= release.xy.mean(axis=0)
    return result


@fails("same_release_same_prediction", "two runs with one seed differ in")
def counts(release, t_future):
    return Prediction(STAND.predict(release, t_future).mean + 1e-9 * next(CALLS))


@fails("one_track_is_predicted_as_among_others", "track 0 alone .* mean or cov by")
def with_the_crowd(release, t_future):
    mean = STAND.predict(release, t_future).mean
    return Prediction(0.9 * mean + 0.1 * mean.mean(axis=0))


@fails("odd_tracks_are_predicted", "IndexError: .* (broken_plugins.py, line ")
def last_step(release, t_future):
    for track in release:
        track.xy[-1] - track.xy[-2]
    return STAND.predict(release, t_future)


def skewed(release, t_future):
    mean = STAND.predict(release, t_future).mean
    return Prediction(mean, np.broadcast_to([[1.0, 2.0], [0.0, 1.0]], (*mean.shape, 2)))


@fails("track_is_causal", "later samples move what was known before by 7 m")
def smooths(release):
    return np.repeat(release.xy[-1:], release.t.size, axis=0)
