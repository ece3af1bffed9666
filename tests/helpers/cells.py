"""Cells of made-up people, computed as a run does, and attacks that watch."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar

import numpy as np
from helpers.runs import arrays
from helpers.walkers import walkers

from attacks.tasks import build
from attacks.tasks.task_list import TASKS
from evaluation.compute.link_setup import sense_task
from evaluation.compute.link_views import linked_level
from evaluation.compute.linkage import link
from evaluation.compute.reconstruction import attacked_block, draw_halves
from evaluation.compute.sharing import share
from evaluation.compute.work import SceneWork, compute_cells
from evaluation.plan.axes import Axes
from evaluation.plan.consumer import Consumer
from isac_track import plugins
from isac_track.config import StageSettings
from isac_track.plugins import Plugin
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from isac_track.types import Reconstruction

STAGES = StageSettings()
EPSILON_M = STAGES.privacy.epsilon_m


def plugin(instance, name="spy"):
    """A user's plug-in."""
    return Plugin(
        name=name, level=None, spec=name, origin=f"here:{name}", instance=instance
    )


def parsed(kind, plugin_or_spec, name="mine"):
    """A plug-in from its SPEC, from a user's instance, or as it is."""
    if isinstance(plugin_or_spec, str):
        return plugins.parse(kind, plugin_or_spec)[0]
    return (
        plugin_or_spec
        if isinstance(plugin_or_spec, Plugin)
        else plugin(plugin_or_spec, name)
    )


@dataclass(frozen=True)
class Spy:
    """An attack that records what it sees, and moves positions by a function."""

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
    """Some scenes of four agents, and their cells, block by block."""

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
        self.half = draw_halves(self.tracks.group, seed=seed)

    def share(self, by):
        """The release of all scenes, as of the first block."""
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
        """The scenes, prepared for all attacks."""
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
            (parsed("mechanisms", mechanism), tuple(consumers))
            for mechanism in mechanisms
        )
        size = size or len(self.order)
        for number, first in enumerate(range(0, len(self.order), size)):
            block = SceneWork(number, first, self.order[first : first + size], levels)
            own = {"tracks": self.tracks, "stages": self.stages, "seed": self.seed}
            for _, level, consumer, tables in compute_cells(block, **own):
                yield level, consumer, arrays(tables, tracks=self.tracks)


@lru_cache(maxsize=8)
def make_task_windows(task, *, tracks=None, seed=0):
    """The sessions of a task of walkers."""
    crowd = tracks or walkers()
    return build.make_task_windows(TASKS[task], tracks=crowd, stages=STAGES, seed=seed)


@lru_cache(maxsize=8)
def _sensed(task_windows, seed, stages):
    groups = sorted(set(task_windows.group))
    return sense_task(task_windows, groups=groups, stages=stages, seed=seed)


def result_numbers(cell):
    """All numbers of a linkage cell, in one row: equal for equal cells, bit by bit."""
    scores = (search.scores.ravel() for search in cell.searches)
    estimates = cell.scorecard.estimates.values()
    numbers = (
        [estimate.value, estimate.ci_low, estimate.ci_high, *estimate.replicates]
        for estimate in estimates
    )
    return np.concatenate([*scores, *numbers, [cell.scorecard.p_value]])


def linked(task_windows, by, *links, controls=False, seed=0, stages=STAGES):
    """Results of all linkers of a task by consumer and adversary, and the level.

    Each of `links` is a consumer, or an argument of `parsed`.
    """
    task = task_windows.task
    level = linked_level(parsed("mechanisms", by), _sensed(task_windows, seed, stages))
    linkers = [
        (
            linker
            if isinstance(linker, Consumer)
            else Consumer("linkage", parsed("attacks", linker, "spy"))
        )
        for linker in links
    ]
    crossed = Axes((), (), (), links=tuple((task, linker) for linker in linkers))
    wanted = ("linkage", "control") if controls else ("linkage",)
    results = {
        (consumer.spec, consumer.adversary): link(consumer, level)
        for consumer in crossed.task_consumers(task)
        if consumer.kind in wanted
    }
    return results, level
