"""Cells of made-up people, from the parts that a run computes them of, and attacks that watch."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar

import numpy as np
from helpers.runs import arrays
from helpers.walkers import walkers

from attacks.tasks import build
from attacks.tasks.task_list import TASKS
from evaluation.compute.link_setup import sensed_sessions
from evaluation.compute.linkage import link, linked_level
from evaluation.compute.reconstruction import attacked_block, folds
from evaluation.compute.sharing import share
from evaluation.compute.work import Block, cells
from evaluation.plan.axes import Axes, Consumer
from isac_track import plugins
from isac_track.config import StageSettings
from isac_track.plugins import Plugin
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from isac_track.types import Reconstruction

STAGES = StageSettings()
EPSILON_M = STAGES.privacy.epsilon_m


def plugin(instance, name="spy"):
    """A plug-in of one's own."""
    return Plugin(
        name=name, level=None, spec=name, origin=f"here:{name}", instance=instance
    )


def parsed(kind, one, name="mine"):
    """A plug-in from its SPEC, from an instance of one's own, or as it is."""
    if isinstance(one, str):
        return plugins.parse(kind, one)[0]
    return one if isinstance(one, Plugin) else plugin(one, name)


@dataclass(frozen=True)
class Spy:
    """An attack that keeps what it was shown, and moves positions as it is told."""

    requires: frozenset = frozenset()
    uses: frozenset = frozenset()
    move: object = lambda xy: xy
    seen: list = field(default_factory=list, compare=False)
    """Context, release, and three numbers from its stream."""

    def fit(self, context):
        drawn = context.rng.random(3)

        def reconstruct(release):
            self.seen.append((context, release, drawn))
            return Reconstruction(self.move(release.xy))

        return reconstruct


class SlowSpy(Spy):
    slow: ClassVar[bool] = True


@dataclass(frozen=True)
class Blur:
    """An attack that moves everything half a metre: worse than doing nothing."""

    requires: ClassVar[frozenset] = frozenset()
    uses: ClassVar[frozenset] = frozenset()

    def fit(self, _context):
        return lambda release: Reconstruction(release.xy + 0.5)


class World:
    """Some scenes of four agents, and what is computed of them in blocks."""

    def __init__(self, tracks, *, n_scenes, mechanism="raw", stages=STAGES, seed=0):
        self.stages, self.seed = stages, seed
        own = {"settings": stages, "seed": seed}
        self.tracks = cut(tracks, **own)
        n_tracks, agents = len(self.tracks), stages.scenes.agents
        self.order = track_order(
            n_tracks=n_tracks, n_scenes=n_scenes, agents=agents, seed=seed
        )
        self.scenes = make_scenes(self.tracks, order=self.order, first=0, **own)
        self.sensed = sense_scenes(self.scenes, settings=stages.sensing, seed=seed)
        self.release = self.share(mechanism)
        self.half = folds(self.tracks.group, seed=seed)

    def share(self, by):
        """What a mechanism shares of all scenes, as of the first block."""
        return share(parsed("mechanisms", by), self.sensed, "block", 0, seed=self.seed)

    def rows(self, fold):
        """Tracks whose people belong to that half."""
        return np.flatnonzero(self.half[self.scenes.track] == fold)

    def samples(self, fold):
        """Their samples."""
        offsets = self.scenes.offsets
        return np.concatenate(
            [np.arange(*offsets[row : row + 2]) for row in self.rows(fold)]
        )

    def attacked(self, *, repeats=False):
        """What all attacks on it share."""
        return attacked_block(
            scenes=self.scenes,
            sensed=self.sensed,
            tracks=self.tracks,
            repeats=repeats,
            stages=STAGES,
            seed=0,
        )

    def cells(self, mechanisms, consumers, *, size=None):
        """Yield mechanism, consumer and rows of every cell, block by block."""
        levels = tuple(
            (parsed("mechanisms", one), tuple(consumers)) for one in mechanisms
        )
        size = size or len(self.order)
        for number, first in enumerate(range(0, len(self.order), size)):
            block = Block(number, first, self.order[first : first + size], levels)
            own = {"tracks": self.tracks, "stages": self.stages, "seed": self.seed}
            for _, by, one, tables in cells(block, **own):
                yield by, one, arrays(tables, tracks=self.tracks)


@lru_cache(maxsize=8)
def sessions_of(task, *, tracks=None, seed=0):
    """The sessions of a task of walkers."""
    crowd = tracks or walkers()
    return build.sessions_of(TASKS[task], tracks=crowd, stages=STAGES, seed=seed)


@lru_cache(maxsize=8)
def _sensed(sessions, seed, stages):
    groups = sorted(set(sessions.group))
    return sensed_sessions(sessions, groups=groups, stages=stages, seed=seed)


def numbers_of(cell):
    """All that a cell of linkage says, in one row: equal where two cells are alike to the bit."""
    scores = (one.scores.ravel() for one in cell.searches)
    estimates = cell.scored.estimates.values()
    said = ([one.value, one.ci_low, one.ci_high, *one.replicates] for one in estimates)
    return np.concatenate([*scores, *said, [cell.scored.p_value]])


def linked(sessions, by, *links, controls=False, seed=0, stages=STAGES):
    """What all achieve who link in a task: by consumer and adversary.

    Also the level. A link is one, or what `parsed` takes.
    """
    task = sessions.task
    level = linked_level(parsed("mechanisms", by), _sensed(sessions, seed, stages))
    links = [
        (
            one
            if isinstance(one, Consumer)
            else Consumer("linkage", parsed("attacks", one, "spy"))
        )
        for one in links
    ]
    crossed = Axes((), (), (), links=tuple((task, one) for one in links))
    wanted = ("linkage", "control") if controls else ("linkage",)
    found = {
        (one.spec, one.knowledge): link(one, level)
        for one in crossed.readers(task)
        if one.kind in wanted
    }
    return found, level
