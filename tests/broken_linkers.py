"""Plausible mistakes of linkers, each of which exactly one check of the attack kit must catch.

And, first, four honest linkers, which no check may fail.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.noise import innovation_variance_m2
from isac_track.types import Knowledge

BIN_S = 1.0


@dataclass(frozen=True)
class Base:
    """Compares mean speeds: honest, as long as nobody spoils it."""

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context):
        del context
        return self.link

    def link(self, probe, gallery):
        return -np.abs(self.traits(probe)[:, None] - self.traits(gallery))

    def traits(self, release):
        """One number for each track by itself, unless a broken linker says otherwise."""
        return np.array([self.trait(track) for track in release])

    def trait(self, track):
        return mean_speed(track.t, track.xy)


def mean_speed(t, xy):
    """Length of the way through the means of every second, over its duration; 0 for one."""
    _, place = np.unique(np.floor((t - t[0]) / BIN_S), return_inverse=True)
    if place[-1] == 0:
        return 0.0
    count = np.bincount(place)
    when = np.bincount(place, t - t[0]) / count
    where = np.stack([np.bincount(place, axis) / count for axis in (xy - xy[0]).T])
    return np.hypot(*np.diff(where)).sum() / (when[-1] - when[0])


@dataclass(frozen=True)
class Learns(Base):
    """Learns from other people how much a person's speed varies, and takes all that it may."""

    uses = frozenset({Knowledge.TRAIN, Knowledge.MECHANISM, Knowledge.SIGMA})
    least_mps: float = 0.01

    def fit(self, context):
        scale = 0.1
        if Knowledge.TRAIN in context.granted:
            train = context.train
            known = train.mate >= 0
            mates = self.traits(train.gallery)[train.mate[known]]
            scale = np.sqrt(np.mean((self.traits(train.probe)[known] - mates) ** 2))
        if Knowledge.MECHANISM in context.granted:
            scale = np.hypot(scale, 1e-3 * context.mechanism.d_sigma)
        scale = max(scale, self.least_mps)
        return lambda probe, gallery: -((self.link(probe, gallery) / scale) ** 2)


class Continues(Base):
    """Asks how far the gallery begins from where a probe would have got to."""

    requires = frozenset({Knowledge.SCENE})

    def link(self, probe, gallery):
        first = np.stack([track.xy[0] for track in gallery])
        scores = []
        for track in probe:
            then = track.t[-1] - 1.0 <= track.t
            velocity = np.zeros(2)
            if then.sum() > 1:
                velocity = np.polyfit(track.t[then] - track.t[-1], track.xy[then], 1)[0]
            ahead_s = np.stack([other.t[0] - track.t[-1] for other in gallery])
            gap = first - track.xy[then].mean(axis=0) - np.outer(ahead_s + 0.5, velocity)
            scores.append(-np.hypot(*gap.T))
        return np.array(scores)


@dataclass(frozen=True)
class Jitters(Base):
    """Draws, from the stream that it was given."""

    sigma: float = 0.02

    def fit(self, context):
        def link(probe, gallery):
            scores = self.link(probe, gallery)
            return scores + context.rng.normal(0.0, self.sigma, scores.shape)

        return link


class NeedsRepeats(Base):
    requires = frozenset({Knowledge.REPEATS})


class Listing(Base):
    def link(self, probe, gallery):
        return super().link(probe, gallery).tolist()


class WholeNumbers(Base):
    def link(self, probe, gallery):
        return np.round(1e9 * super().link(probe, gallery)).astype(np.int64)


class OwnDice(Base):
    def link(self, probe, gallery):
        scores = super().link(probe, gallery)
        return scores + np.random.default_rng().normal(0.0, 1e-3, scores.shape)


class Memory(Base):
    """Remembers how often it was fitted."""

    fits: ClassVar[list[int]] = []

    def fit(self, context):
        del context
        self.fits.append(1)
        drift = 1e-9 * len(self.fits)
        return lambda probe, gallery: (
            self.link(probe, gallery) + drift * np.eye(len(probe), len(gallery))
        )


class InPlace(Base):
    """Takes walks back to where the first began, without a copy."""

    def link(self, probe, gallery):
        gallery.xy.flags.writeable = True
        gallery.xy[:] -= gallery.xy[0]
        return super().link(probe, gallery)


class CrossesOut(Base):
    """Marks the training pairs that it has learnt from."""

    uses = frozenset({Knowledge.TRAIN})

    def fit(self, context):
        if Knowledge.TRAIN in context.granted:
            context.train.mate.flags.writeable = True
            context.train.mate[:] = -1
        return super().fit(context)


class TakesTrainingSet(Base):
    def fit(self, context):
        assert len(context.train.probe)
        return super().fit(context)


class NeverLooks(Base):
    """A blind adversary grants it nothing, yet it reads what it only `uses`."""

    uses = frozenset({Knowledge.MECHANISM})

    def fit(self, context):
        assert context.mechanism.d_sigma >= 0
        return super().fit(context)


class TakesSigma(Base):
    uses = frozenset({Knowledge.SIGMA})

    def traits(self, release):
        return super().traits(release) / (1.0 + release.sigma.mean())


class LikesTheFirst(Base):
    """Breaks ties by the number of the gallery track."""

    def link(self, probe, gallery):
        return super().link(probe, gallery) - 1e-3 * np.arange(len(gallery))


class NumbersProbes(Base):
    def link(self, probe, gallery):
        return super().link(probe, gallery) - 1e-3 * np.arange(len(probe))[:, None]


class AcrossTracks(Base):
    """Smooths the speeds of all tracks as if they were one series."""

    def traits(self, release):
        speeds = super().traits(release)
        return 0.999 * speeds + 0.001 * np.concatenate([speeds[:1], speeds[:-1]])


class Northbound(Base):
    """Looks at the heading, too."""

    def trait(self, track):
        heading = np.arctan2(*(track.xy[-1] - track.xy[0]))
        return super().trait(track) + 0.003 * heading


class ByTheClock(Base):
    def trait(self, track):
        return super().trait(track) + 1e-5 * track.t[0]


class SameFrameForBoth(Base):
    """Asks how far apart the walks are, without asking for SCENE."""

    def link(self, probe, gallery):
        last = probe.xy[probe.offsets[1:] - 1]
        first = gallery.xy[gallery.offsets[:-1]]
        away_m = np.hypot(*(last[:, None] - first).transpose(2, 0, 1))
        return super().link(probe, gallery) - 1e-4 * away_m


class TrainsInOneFrame(Base):
    """Learns how far people get between the two releases, in frames that have nothing in common."""

    uses = frozenset({Knowledge.TRAIN})

    def fit(self, context):
        if Knowledge.TRAIN not in context.granted:
            return self.link
        train = context.train
        last = train.probe.xy[train.probe.offsets[1:] - 1]
        first = train.gallery.xy[train.gallery.offsets[:-1]]
        known = train.mate >= 0
        away_m = np.hypot(*(last[known] - first[train.mate[known]]).T).mean()
        return lambda probe, gallery: self.link(probe, gallery) * (1.0 + away_m)


class SameName(Base):
    """Trusts that nobody changes their pseudonym."""

    def link(self, probe, gallery):
        same = np.array([[one == other for other in gallery.pseudonym] for one in probe.pseudonym])
        return super().link(probe, gallery) + 0.1 * same


class FirstByName(Base):
    def traits(self, release):
        first = np.array([name == min(release.pseudonym) for name in release.pseudonym])
        return super().traits(release) + 0.01 * first


class AgainstTheOthers(Base):
    """Standard scores over the candidates; a single one has no spread."""

    def link(self, probe, gallery):
        scores = super().link(probe, gallery)
        with np.errstate(invalid="ignore", divide="ignore"):
            spread = np.sqrt(
                ((scores - scores.mean(axis=1, keepdims=True)) ** 2).sum(axis=1, keepdims=True)
                / np.float64(scores.shape[1] - 1)
            )
        return (scores - scores.mean(axis=1, keepdims=True)) / np.maximum(spread, 1e-9)


class NeedsThree(Base):
    def trait(self, track):
        assert np.isfinite(track.xy[2]).all()
        return super().trait(track)


class PerSecond(Base):
    """A walk of one sample goes nowhere in no time."""

    def trait(self, track):
        with np.errstate(invalid="ignore"):
            straight = np.hypot(*(track.xy[-1] - track.xy[0])) / (track.t[-1] - track.t[0])
        return super().trait(track) + 1e-3 * straight


class RoundsTimes(Base):
    """Takes the recording to have frames of 10 ms."""

    def link(self, probe, gallery):
        with np.errstate(invalid="ignore", divide="ignore"):
            return super().link(probe, gallery)

    def trait(self, track):
        step_s = np.diff(np.round(track.t - track.t[0], 2))
        fastest = (np.hypot(*np.diff(track.xy, axis=0).T) / step_s).max(initial=0.0)
        return super().trait(track) + 1e-4 * fastest


class TakesTheLastForNobody(Base):
    """A mate of -1 is an index to numpy."""

    uses = frozenset({Knowledge.TRAIN})

    def fit(self, context):
        if Knowledge.TRAIN not in context.granted:
            return self.link
        train = context.train
        gap = self.traits(train.probe) - self.traits(train.gallery)[train.mate]
        scale = np.sqrt(np.mean(gap**2))
        return lambda probe, gallery: -np.log1p((self.link(probe, gallery) / scale) ** 2)


class InsistsOnMates(Base):
    uses = frozenset({Knowledge.TRAIN})

    def fit(self, context):
        if Knowledge.TRAIN in context.granted:
            assert (context.train.mate >= 0).all(), "who is this?"
        return self.link


class CountsCalls(Base):
    """Drifts with every question that one function is asked."""

    def fit(self, context):
        del context
        asked = []

        def link(probe, gallery):
            asked.append(probe)
            return self.link(probe, gallery) - 1e-9 * len(asked)

        return link


class KeepsByName(Base):
    """Looks a track up that has been seen under the same pseudonym."""

    def fit(self, context):
        del context
        probes, candidates = {}, {}

        def traits(release, known):
            for track in release:
                known.setdefault(track.pseudonym, self.trait(track))
            return np.array([known[track.pseudonym] for track in release])

        return lambda probe, gallery: (
            -np.abs(traits(probe, probes)[:, None] - traits(gallery, candidates))
        )


class Peeks(Base):
    """Takes the mates from whoever called and has them."""

    def link(self, probe, gallery):
        scores = super().link(probe, gallery)
        frame = sys._getframe()
        while frame is not None:
            mate = frame.f_locals.get("mate")
            if isinstance(mate, np.ndarray) and mate.shape == (len(probe),):
                scores[np.arange(len(probe)), mate] += 10.0
            frame = frame.f_back
        return scores


class SlowOrFast(Base):
    """Tells who strolls from who hurries, and no more."""

    def traits(self, release):
        return (super().traits(release) > 1.3).astype(float)


class GivesUpInBetween(Base):
    """Takes noise of decimetres for people who stand still."""

    def link(self, probe, gallery):
        variance = innovation_variance_m2(t=probe.t, xy=probe.xy, offsets=probe.offsets)
        still = (variance > 0.06**2) & (variance < 1.0)
        return np.where(still[:, None], 0.0, super().link(probe, gallery))


BROKEN = [
    (Listing, "result_is_a_score_matrix", "expected a numpy array of floats, got list"),
    (WholeNumbers, "result_is_a_score_matrix", "got ndarray of int64"),
    (OwnDice, "same_seed_same_result", "draw from context.rng alone"),
    (Memory, "same_seed_same_result", "keep nothing between two calls of fit"),
    (InPlace, "inputs_are_not_mutated", "changed gallery.xy; "),
    (CrossesOut, "inputs_are_not_mutated", "as informed (granted TRAIN), .* context.train.mate"),
    (TakesTrainingSet, "only_granted_knowledge_is_touched", "TRAIN was not granted"),
    (NeverLooks, "only_granted_knowledge_is_touched", "as blind (granted nothing)"),
    (TakesSigma, "only_granted_knowledge_is_touched", "gallery.sigma are None"),
    (LikesTheFirst, "order_of_tracks_does_not_matter", "depend on a track's number?"),
    (NumbersProbes, "order_of_tracks_does_not_matter", "depend on a track's number?"),
    (AcrossTracks, "order_of_tracks_does_not_matter", "tracks in another order: scores differ by"),
    (Northbound, "frames_and_clocks_do_not_matter", "in another frame and clock"),
    (ByTheClock, "frames_and_clocks_do_not_matter", "on absolute times"),
    (SameFrameForBoth, "frames_and_clocks_do_not_matter", "two walks sharing a frame?"),
    (TrainsInOneFrame, "frames_and_clocks_do_not_matter", "as informed (granted TRAIN)"),
    (SameName, "pseudonyms_do_not_matter", "other pseudonyms: scores differ by"),
    (FirstByName, "pseudonyms_do_not_matter", "drawn afresh"),
    (AgainstTheOthers, "one_candidate_is_handled", "P = 1, G = 1, .* 1 of 1 scores are not"),
    (NeedsThree, "short_tracks_are_handled", "raised IndexError: .* (broken_linkers.py, line "),
    (PerSecond, "short_tracks_are_handled", "who cannot tell gives all candidates the same score"),
    (RoundsTimes, "irregular_sampling_is_handled", "steps from 1 ms to 30 s: .* are not finite"),
    (TakesTheLastForNobody, "training_without_mates_is_handled", "a mate of -1 is no index"),
    (InsistsOnMates, "training_without_mates_is_handled", "AssertionError: who is this?"),
    (CountsCalls, "calls_do_not_remember", "asked once more, after other releases"),
    (KeepsByName, "calls_do_not_remember", "other releases, asked after the first: scores"),
    (Peeks, "null_stays_at_chance", "24 of 24 drawn mates come first, expected about 1 by"),
    (SlowOrFast, "easy_case_beats_chance", "expected at least 6; chance brings 1"),
    (GivesUpInBetween, "success_falls_with_noise", "expected a rise by a factor of more than"),
]
"""(class, the one check that it fails, part of the message with `.*` for anything)"""
