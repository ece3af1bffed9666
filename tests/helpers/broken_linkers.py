"""Honest linkers, and plausible mistakes, each for exactly one check of the attack kit.

A broken linker is the honest `Base` with one step replaced by a function; which step is
said by what the function takes, as in `helpers.broken_attacks`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from helpers.broken_attacks import TRAIN, planting, truth_called

from attacks.linkage.kinematic import Kinematic
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
        """One number for each track by itself, unless a broken linker overrides it."""
        return np.array([self.trait(track) for track in release])

    def trait(self, track):
        return mean_speed(track.t, track.xy)


def mean_speed(t, xy):
    """Path length through the means of every second, over its duration; 0 for one."""
    _, place = np.unique(np.floor((t - t[0]) / BIN_S), return_inverse=True)
    if place[-1] == 0:
        return 0.0
    count = np.bincount(place)
    when = np.bincount(place, t - t[0]) / count
    where = np.stack([np.bincount(place, axis) / count for axis in (xy - xy[0]).T])
    return np.hypot(*np.diff(where)).sum() / (when[-1] - when[0])


@dataclass(frozen=True)
class Jitters(Base):
    """Draws, from the stream that it was given."""

    sigma: float = 0.02

    def fit(self, context):
        def link(probe, gallery):
            scores = self.link(probe, gallery)
            return scores + context.rng.normal(0.0, self.sigma, scores.shape)

        return link


class ContinuesWhereShown(Base):
    """Links otherwise where the scene is hidden."""

    uses = frozenset({Knowledge.SCENE})

    def fit(self, context):
        return (Kinematic() if Knowledge.SCENE in context.granted else BASE).fit(
            context
        )


class Tiny(Base):
    """Scores have no scale."""

    def link(self, probe, gallery):
        return 1e-200 * super().link(probe, gallery) - 1e-195


class NeedsRepeats(Base):
    requires = frozenset({Knowledge.REPEATS})


BASE = Base()
HONEST = [BASE, ContinuesWhereShown(), Jitters(), Tiny()]
linker, fails, BROKEN = planting(
    Base, {"track": "trait", "release": "traits", "probe": "link", "context": "fit"}
)


@fails("result_is_a_score_matrix", "expected a numpy array of floats, got list")
def listing(probe, gallery):
    return BASE.link(probe, gallery).tolist()


@fails(
    "inputs_are_not_mutated",
    "as informed (granted TRAIN), .* context.train.mate",
    uses=TRAIN,
)
def crosses_out(context):
    """Marks the training pairs that it has learnt from."""
    if Knowledge.TRAIN in context.granted:
        context.train.mate.flags.writeable = True
        context.train.mate[:] = -1


@fails("order_of_tracks_does_not_matter", "depend on a track's number?")
def likes_the_first(probe, gallery):
    """Breaks ties by the number of the gallery track."""
    return BASE.link(probe, gallery) - 1e-3 * np.arange(len(gallery))


@fails("frames_and_clocks_do_not_matter", "on absolute times")
def by_the_clock(track):
    return BASE.trait(track) + 1e-5 * track.t[0]


def ends(probe, gallery):
    """Where probes end, and where the tracks of a gallery begin."""
    return probe.xy[probe.offsets[1:] - 1], gallery.xy[gallery.offsets[:-1]]


@fails("frames_and_clocks_do_not_matter", "two of these sharing a frame?")
def same_frame_for_both(probe, gallery):
    """Asks how far apart the walks are, without asking for SCENE."""
    last, first = ends(probe, gallery)
    away_m = np.hypot(*(last[:, None] - first).transpose(2, 0, 1))
    return BASE.link(probe, gallery) - 1e-4 * away_m


@fails("pseudonyms_do_not_matter", "other pseudonyms: scores differ by")
def same_name(probe, gallery):
    """Trusts that nobody changes their pseudonym."""
    same = np.array(
        [[item == other for other in gallery.pseudonym] for item in probe.pseudonym]
    )
    return BASE.link(probe, gallery) + 0.1 * same


@fails("odd_tracks_are_handled", "who cannot tell gives all candidates the same score")
def per_second(track):
    """A walk of one sample goes nowhere in no time."""
    with np.errstate(invalid="ignore"):
        straight = np.hypot(*(track.xy[-1] - track.xy[0])) / (track.t[-1] - track.t[0])
    return BASE.trait(track) + 1e-3 * straight


@fails("training_without_mates_is_handled", "a mate of -1 is no index", uses=TRAIN)
def takes_the_last_for_nobody(context):
    """A mate of -1 is an index to numpy."""
    if Knowledge.TRAIN not in context.granted:
        return None
    train = context.train
    gap = BASE.traits(train.probe) - BASE.traits(train.gallery)[train.mate]
    scale = np.sqrt(np.mean(gap**2))
    return lambda probe, gallery: -np.log1p((BASE.link(probe, gallery) / scale) ** 2)


@fails("calls_do_not_remember", "another release, asked after the first: scores")
def keeps_by_name(_context):
    """Looks a track up that has been seen under the same pseudonym."""
    probes, candidates = {}, {}

    def traits(release, known):
        for track in release:
            known.setdefault(track.pseudonym, BASE.trait(track))
        return np.array([known[track.pseudonym] for track in release])

    return lambda probe, gallery: (
        -np.abs(traits(probe, probes)[:, None] - traits(gallery, candidates))
    )


@fails("null_stays_at_chance", "24 of 24 mates come first, expected about 1 by")
def peeks(probe, gallery):
    """Takes the mates from whoever called and has them."""
    scores = BASE.link(probe, gallery)
    for mate in truth_called("mate"):
        scores[np.arange(len(probe)), mate] += 10.0
    return scores


@fails("easy_case_beats_chance", "expected at least 6; chance brings 1")
def slow_or_fast(release):
    """Tells who strolls from who hurries, and no more."""
    return (BASE.traits(release) > 1.3).astype(float)


@fails("success_falls_with_noise", "expected a fall of more than")
def gives_up_in_between(probe, gallery):
    """Takes noise of decimetres for people who stand still."""
    variance = innovation_variance_m2(t=probe.t, xy=probe.xy, offsets=probe.offsets)
    still = (variance > 0.06**2) & (variance < 1.0)
    return np.where(still[:, None], 0.0, BASE.link(probe, gallery))
