"""Plausible mistakes, each of which exactly one check of the attack kit must catch."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from isac_track.noise import innovation_variance_m2
from isac_track.types import Knowledge, Reconstruction


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


def halfway_back(xy):
    """Each position drawn a little towards the one before it."""
    return 0.9 * xy + 0.1 * np.concatenate([xy[:1], xy[:-1]])


class Barehanded(Base):
    def fit(self, context):
        del context
        return self.positions


class OwnDice(Base):
    def track(self, track):
        return track.xy + np.random.default_rng().normal(0.0, 0.05, track.xy.shape)


class Memory(Base):
    """Remembers how often it was asked."""

    calls: ClassVar[list[int]] = []

    def track(self, track):
        self.calls.append(1)
        return track.xy + 1e-9 * len(self.calls)


class InPlace(Base):
    def positions(self, release):
        release.xy.flags.writeable = True
        for first, end in zip(release.offsets[:-1], release.offsets[1:], strict=True):
            release.xy[first:end] = halfway_back(release.xy[first:end])
        return release.xy


class ShiftsTrainingSet(Base):
    uses = frozenset({Knowledge.TRAIN})

    def fit(self, context):
        if Knowledge.TRAIN in context.granted:
            context.train.truth.flags.writeable = True
            context.train.truth[:] += 1.0
        return super().fit(context)


class RetimesRepeats(Base):
    uses = frozenset({Knowledge.REPEATS})

    def fit(self, context):
        if Knowledge.REPEATS in context.granted:
            context.repeats[1].t.flags.writeable = True
            context.repeats[1].t[:] -= context.repeats[1].t[0]
        return super().fit(context)


class TakesTrainingSet(Base):
    def fit(self, context):
        assert len(context.train.release)
        return super().fit(context)


class NeverLooks(Base):
    """A blind adversary grants it nothing, yet it reads what it only `uses`."""

    uses = frozenset({Knowledge.MECHANISM})

    def fit(self, context):
        assert context.mechanism.d_sigma >= 0
        return super().fit(context)


class TakesSigma(Base):
    uses = frozenset({Knowledge.SIGMA})

    def positions(self, release):
        return super().positions(release) * (release.sigma * 0.0 + 1.0)[:, None]


class AcrossTracks(Base):
    def positions(self, release):
        return halfway_back(release.xy)


class CertainOfTheFirst(Base):
    """The positions are right, the claimed standard deviation knows the track's number."""

    def fit(self, context):
        del context
        return lambda release: Reconstruction(
            release.xy, np.repeat(np.arange(len(release)) * 0.1, np.diff(release.offsets))
        )


class OnTheGrid(Base):
    def track(self, track):
        return 0.1 * np.round(track.xy / 0.1)


class ByTheClock(Base):
    def track(self, track):
        return track.xy + 0.01 * np.column_stack([np.sin(track.t), np.cos(track.t)])


class OneFrameForAll(Base):
    """Averages repeats as if their frames were one, without asking for SCENE."""

    requires = frozenset({Knowledge.REPEATS})

    def fit(self, context):
        return lambda release: Reconstruction(
            np.mean([release.xy, *(repeat.xy for repeat in context.repeats)], axis=0)
        )


class FirstByName(Base):
    def positions(self, release):
        first = min(release.pseudonym)
        return np.concatenate(
            [
                track.xy if track.pseudonym[0] == first else halfway_back(track.xy)
                for track in release
            ]
        )


class NeedsThree(Base):
    def track(self, track):
        assert np.isfinite(track.xy[2]).all()
        return halfway_back(track.xy)


class FarFromAPoint(Base):
    """A walk of no extent is sent far away."""

    def track(self, track):
        return track.xy if len(track.t) > 1 else track.xy + 50.0


class DeadReckoning(Base):
    """Carries the last velocity on, however short the step that it was taken from."""

    def track(self, track):
        t, xy = track.t, track.xy.copy()
        if len(t) > 2:
            velocity = np.diff(track.xy, axis=0)[:-1] / np.diff(t)[:-1, None]
            xy[2:] = 0.8 * xy[2:] + 0.2 * (track.xy[1:-1] + velocity * np.diff(t)[1:, None])
        return xy


class CountsCalls(Base):
    """Drifts with every release that one function is asked about."""

    def fit(self, context):
        del context
        seen = []

        def reconstruct(release):
            seen.append(release)
            return Reconstruction(release.xy + 1e-9 * len(seen))

        return reconstruct


class KeepsByName(Base):
    """Answers pseudonyms that it has seen from a cache."""

    def fit(self, context):
        del context
        known = {}
        return lambda release: known.setdefault(
            release.pseudonym, Reconstruction(self.positions(release))
        )


class Peeks(Base):
    """Takes every tenth position from whoever called and has it."""

    def positions(self, release):
        xy = release.xy.copy()
        frame = sys._getframe()
        while frame is not None:
            truth = frame.f_locals.get("truth")
            if isinstance(truth, np.ndarray) and truth.shape == xy.shape:
                xy[::10] = truth[::10]
            frame = frame.f_back
        return xy


class StepsAside(Base):
    """Off by 0.4 m to the left of the way."""

    def track(self, track):
        way = track.xy[-1] - track.xy[0]
        length = np.hypot(*way)
        left = np.array([-way[1], way[0]]) / length if length else np.zeros(2)
        return track.xy + 0.4 * left


class GivesUpInBetween(Base):
    """Takes noise of a few decimetres for a person who stands still."""

    def positions(self, release):
        std = np.sqrt(innovation_variance_m2(t=release.t, xy=release.xy, offsets=release.offsets))
        return np.concatenate(
            [
                track.xy * 0 + track.xy.mean(axis=0) if 0.25 < noise < 0.6 else track.xy
                for track, noise in zip(release, std, strict=True)
            ]
        )


BROKEN = [
    (Barehanded, "result_is_a_reconstruction", "expected a Reconstruction, got ndarray"),
    (OwnDice, "same_seed_same_result", "draw from context.rng alone"),
    (Memory, "same_seed_same_result", "keep nothing between two calls of fit"),
    (InPlace, "inputs_are_not_mutated", "changed release.xy; "),
    (ShiftsTrainingSet, "inputs_are_not_mutated", "as informed (granted TRAIN), .*train.truth"),
    (RetimesRepeats, "inputs_are_not_mutated", "as oracle .* changed context.repeats[1].t"),
    (TakesTrainingSet, "only_granted_knowledge_is_touched", "TRAIN was not granted"),
    (NeverLooks, "only_granted_knowledge_is_touched", "as blind (granted nothing)"),
    (TakesSigma, "only_granted_knowledge_is_touched", "without SIGMA, release.sigma is None"),
    (AcrossTracks, "order_of_tracks_does_not_matter", "tracks in another order"),
    (CertainOfTheFirst, "order_of_tracks_does_not_matter", "positions or std differ by 0.5 m"),
    (OnTheGrid, "frame_and_clock_do_not_matter", "another frame and clock"),
    (ByTheClock, "frame_and_clock_do_not_matter", "another frame and clock"),
    (OneFrameForAll, "frame_and_clock_do_not_matter", "as oracle (granted REPEATS)"),
    (FirstByName, "pseudonyms_do_not_matter", "other pseudonyms"),
    (NeedsThree, "short_tracks_are_handled", "raised IndexError: .* (broken_attacks.py, line "),
    (FarFromAPoint, "short_tracks_are_handled", "an answer lies 71 m from the middle of track 0"),
    (DeadReckoning, "irregular_sampling_is_handled", "is anything divided by a time step?"),
    (CountsCalls, "calls_do_not_remember", "asked once more, after another release: .* 0 m;"),
    (KeepsByName, "calls_do_not_remember", "another release, asked after the first: positions"),
    (Peeks, "null_stays_at_chance", "samples leak, expected about 2 by chance"),
    (StepsAside, "easy_case_beats_chance", "expected at least 0.5"),
    (GivesUpInBetween, "success_falls_with_noise", "expected a fall of more than"),
]
"""(class, the one check that it fails, part of the message with `.*` for anything)"""
