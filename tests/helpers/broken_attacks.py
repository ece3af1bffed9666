"""Plausible mistakes, each of which exactly one check of the attack kit must catch.

A broken attack is the honest `Base` with one step replaced by a function; which step is
said by what the function takes (`planting`). The decorator names the check and a piece
of its message.
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.noise import innovation_variance_m2
from isac_track.types import Knowledge, Reconstruction

TRAIN, SIGMA = frozenset({Knowledge.TRAIN}), frozenset({Knowledge.SIGMA})
MECHANISM, REPEATS = frozenset({Knowledge.MECHANISM}), frozenset({Knowledge.REPEATS})
SCENE = frozenset({Knowledge.SCENE})


@dataclass(frozen=True)
class Base:
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context):
        del context
        return lambda release: Reconstruction(self.positions(release))

    def positions(self, release):
        """For each track by itself, unless a broken attack says otherwise."""
        return np.concatenate([self.track(track) for track in release])

    def track(self, track):
        return track.xy


@dataclass(frozen=True)
class Jitters(Base):
    """Honest: it draws, from the stream that it was given."""

    sigma_m: float = 0.05

    def fit(self, context):
        return lambda release: Reconstruction(
            release.xy + context.rng.normal(0.0, self.sigma_m, release.xy.shape)
        )


def planting(base, steps):
    """Return how to make broken classes, how to list them, and the list.

    A broken class is `base` with one step replaced by a function, called as that is;
    `steps` says which by the first argument of the function. Of `fit`, one that returns
    nothing only prepares: the rest is the honest fit. What is listed is (class, the one
    check that it fails, part of the message with `.*` for anything).
    """
    listed = []

    def make(function, **attributes):
        step = steps[
            next(iter(inspect.signature(function).parameters)).removeprefix("_")
        ]

        def fit(self, context):
            return function(context) or super(made, self).fit(context)

        method = fit if step == "fit" else lambda _, *given: function(*given)
        words = {"__doc__": function.__doc__, "__module__": function.__module__}
        made = type(function.__name__, (base,), {step: method, **words, **attributes})
        return made

    def fails(check, message, **knowledge):
        def decorate(function):
            made = make(function, **knowledge)
            listed.append((made, check, message))
            return made

        return decorate

    return make, fails, listed


attack, fails, BROKEN = planting(
    Base, {"track": "track", "release": "positions", "context": "fit"}
)


def halfway_back(xy):
    """Each position drawn a little towards the one before it."""
    return 0.9 * xy + 0.1 * np.concatenate([xy[:1], xy[:-1]])


@fails("result_is_a_reconstruction", "expected a Reconstruction, got ndarray")
def barehanded(_context):
    return Base().positions


@fails("same_seed_same_result", "draw from the rng that is given")
def own_dice(track):
    return track.xy + np.random.default_rng().normal(0.0, 0.05, track.xy.shape)


@fails("inputs_are_not_mutated", "changed release.xy; ")
def in_place(release):
    release.xy.flags.writeable = True
    for track in release:
        track.xy.flags.writeable = True
        track.xy[:] = halfway_back(track.xy)
    return release.xy


@fails(
    "only_granted_knowledge_is_touched",
    "(granted nothing), .* MECHANISM was",
    uses=MECHANISM,
)
def never_looks(context):
    """A blind adversary grants it nothing, yet it reads what it only `uses`."""
    assert context.mechanism.d_sigma >= 0


@fails(
    "only_granted_knowledge_is_touched",
    "without SIGMA, release.sigma is None",
    uses=SIGMA,
)
def takes_sigma(release):
    return release.xy * (release.sigma * 0.0 + 1.0)[:, None]


@fails("order_of_tracks_does_not_matter", "tracks in another order")
def across_tracks(release):
    return halfway_back(release.xy)


@fails("frame_and_clock_do_not_matter", "another frame and clock")
def by_the_clock(track):
    return track.xy + 0.01 * np.column_stack([np.sin(track.t), np.cos(track.t)])


@fails("frame_and_clock_do_not_matter", "as oracle (granted REPEATS)", requires=REPEATS)
def common_frame(context):
    """Averages repeats as if their frames were one, without asking for SCENE."""
    return lambda release: Reconstruction(
        np.mean([release.xy, *(repeat.xy for repeat in context.repeats)], axis=0)
    )


@fails("pseudonyms_do_not_matter", "other pseudonyms")
def first_by_name(release):
    first = min(release.pseudonym)
    return np.concatenate(
        [
            item.xy if item.pseudonym[0] == first else halfway_back(item.xy)
            for item in release
        ]
    )


@fails("odd_tracks_are_handled", "raised IndexError: .* (broken_attacks.py, line ")
def needs_three(track):
    assert np.isfinite(track.xy[2]).all()
    return halfway_back(track.xy)


@fails("odd_tracks_are_handled", "is anything divided by a time step?")
def dead_reckoning(track):
    """Carries the last velocity on, however short the step that it was taken from."""
    t, xy = track.t, track.xy.copy()
    if len(t) > 2:
        velocity = np.diff(track.xy, axis=0)[:-1] / np.diff(t)[:-1, None]
        xy[2:] = 0.8 * xy[2:] + 0.2 * (track.xy[1:-1] + velocity * np.diff(t)[1:, None])
    return xy


@fails("calls_do_not_remember", "asked once more, after another release: .* 0 m;")
def counts_calls(_context):
    """Drifts with every release that one function is asked about."""
    seen = []

    def reconstruct(release):
        seen.append(release)
        return Reconstruction(release.xy + 1e-9 * len(seen))

    return reconstruct


@fails("calls_do_not_remember", "another release, asked after the first: positions")
def keeps_by_name(_context):
    """Answers pseudonyms that it has seen from a cache."""
    known = {}
    return lambda release: known.setdefault(
        release.pseudonym, Reconstruction(release.xy)
    )


def truth_called(name, check="null_stays_at_chance"):
    """Yield the part of a check's case under that name, if that check called."""
    frame = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == check:
            yield getattr(frame.f_locals["case"], name)
        frame = frame.f_back


@fails("null_stays_at_chance", "samples leak, expected about 2.19 by chance")
def peeks(release):
    """Takes every tenth position from whoever called and has it."""
    xy = release.xy.copy()
    for truth in truth_called("truth"):
        xy[::10] = truth[::10]
    return xy


@fails("nothing_beats_the_optimum", "where the exact posterior comes to")
def peeks_where_it_is_near(release):
    """Mends nine tenths of its own error, if walks of a model are asked for."""
    xy = release.xy.copy()
    for truth in truth_called("truth", "nothing_beats_the_optimum"):
        xy += 0.9 * (truth - xy)
    return xy


@fails("easy_case_beats_chance", "expected at least 1548; chance brings 2.19")
def steps_aside(track):
    """Off by 0.4 m to the left of the way."""
    way = track.xy[-1] - track.xy[0]
    length = np.hypot(*way)
    left = np.array([-way[1], way[0]]) / length if length else np.zeros(2)
    return track.xy + 0.4 * left


@fails("success_falls_with_noise", "expected a fall of more than")
def gives_up_in_between(release):
    """Takes noise of a few decimetres for a person who stands still."""
    std = np.sqrt(
        innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets)
    )
    return np.concatenate(
        [
            track.xy * 0 + track.xy.mean(axis=0) if 0.25 < noise < 0.6 else track.xy
            for track, noise in zip(release, std, strict=True)
        ]
    )
