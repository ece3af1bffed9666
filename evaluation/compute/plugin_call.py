"""Calls of a user's plug-in on made-up people: a broken plug-in fails before a run.

The calls have random streams of their own: the numbers of a run do not depend on them.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import process_time
from types import CodeType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from evaluation.compute import sharing
from evaluation.compute.current_cell import note_cell
from evaluation.compute.frames import hide_sigma
from evaluation.compute.guards import copied, guarded
from evaluation.compute.linkage import score_releases
from evaluation.compute.work import (
    PatrolWork,
    SceneWork,
    TrackingWork,
    Work,
    compute_cells,
)
from isac_track import plugins
from isac_track.errors import PluginError, code_at, raised_at
from isac_track.protocols import AttackContext, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from isac_track.types import Ints, Tracks

if TYPE_CHECKING:
    from evaluation.plan.consumer import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut

# At least so many: a plug-in may need some to hide among, or to learn from.
N_PEOPLE = 12
# A second size tells the time of a call from the time for each sample or pair.
_MORE_PEOPLE: Final = 24
# With a slower call the second size would take too long.
_MOST_TIMED_S: Final = 5.0
# Quick calls are repeated, and the least time counts.
_REPEATED_S: Final = 0.3
_REPEATS: Final = 3
_SEED = 0
# Predictors and attacks get a release of this mechanism: it declares a sigma.
_MECHANISM = "fixed:0.5"
_GRID_S = 0.1


class PluginCall(NamedTuple):
    """The plug-in that is called once: a mechanism, or a consumer of a release."""

    plugin: Plugin
    consumer: Consumer | None = None  # None: the plug-in is a mechanism.

    @property
    def kind(self) -> str:
        """The kind of the consumer, or `mechanism`."""
        return "mechanism" if self.consumer is None else self.consumer.kind


@dataclass(frozen=True, slots=True)
class PluginTime:
    """CPU time of a plug-in in a cell, beyond that of a simple built-in plug-in.

    A linker reads pairs of tracks, all others read samples.
    """

    fixed_s: float
    per_million_s: float  # Per million samples, or pairs.

    def cell_s(self, size: float) -> float:
        """Return the time of a cell, s, in which `size` millions are read."""
        return self.fixed_s + self.per_million_s * size


class _CallTime(NamedTuple):
    cpu_s: float
    size: float  # Millions of samples, or of pairs.


def check_and_time(
    plugin_call: PluginCall, *, stages: StageSettings
) -> Iterator[tuple[str, str] | PluginTime]:
    """Yield what `check_plugin` yields, or without an error the time of a plug-in.

    Nothing is yielded for a plug-in that is too slow to be timed.
    """
    errors = [*check_plugin(plugin_call, stages=stages)]
    yield from errors
    if not errors and (plugin_time := _measured_time(plugin_call, stages)):
        yield plugin_time


def _measured_time(plugin_call: PluginCall, stages: StageSettings) -> PluginTime | None:
    """Return the time of a plug-in whose loops are compiled; None if it is too slow."""
    simplest = _simplest_call(plugin_call)
    try:
        few = _least_time(plugin_call, stages, n_people=N_PEOPLE)
        if few.cpu_s > _MOST_TIMED_S:
            return None
        more = _least_time(plugin_call, stages, n_people=_MORE_PEOPLE)
        beside_few_s = beside_more_s = 0.0
        if simplest is not None:
            _call(simplest, stages)  # compiles its loops
            beside_few_s = _least_time(simplest, stages, n_people=N_PEOPLE).cpu_s
            beside_more_s = _least_time(simplest, stages, n_people=_MORE_PEOPLE).cpu_s
    except Exception:  # noqa: BLE001 - it cannot be timed: the run reports why
        return None
    few_s = max(few.cpu_s - beside_few_s, 0.0)
    more_s = max(more.cpu_s - beside_more_s, few_s)
    per_million_s = (more_s - few_s) / (more.size - few.size)
    return PluginTime(max(few_s - per_million_s * few.size, 0.0), per_million_s)


def _simplest_call(plugin_call: PluginCall) -> PluginCall | None:
    """Return the same call of a built-in plug-in that does least.

    Its time is that of all that a call does beside the plug-in. None for a linker,
    which is timed alone.
    """
    consumer = plugin_call.consumer
    if consumer is None:
        return PluginCall(plugins.parse("mechanisms", "raw")[0])
    if consumer.kind == "attack":
        plugin = plugins.parse("attacks", "identity")[0]
    elif consumer.kind == "predictor":
        plugin = plugins.parse("predictors", "constant_position")[0]
    else:
        return None
    return PluginCall(plugin, replace(consumer, plugin=plugin, reconstruction=None))


def _least_time(
    plugin_call: PluginCall, stages: StageSettings, *, n_people: int
) -> _CallTime:
    """Return the least time of a few calls, or that of one slow call."""
    note_cell(plugin_call.plugin.spec)
    least = _call(plugin_call, stages, n_people=n_people)
    n_calls = 1
    if least.cpu_s < _REPEATED_S:
        n_calls = _REPEATS
    for _ in range(1, n_calls):
        least = min(least, _call(plugin_call, stages, n_people=n_people))
    return least


def check_plugin(
    plugin_call: PluginCall, *, stages: StageSettings
) -> Iterator[tuple[str, str]]:
    """Yield the message and the traceback of a plug-in's error, if a call shows any."""
    plugin = plugin_call.plugin
    note_cell(plugin.spec)
    try:
        _call(plugin_call, stages)
    except PluginError as error:
        message = str(error)
        names_place = error.__cause__ is not None and raised_at(error.__cause__)
        if not names_place:
            message += defined_at(plugin.instance)
        yield message, "".join(traceback.format_exception(error))
    except Exception:  # noqa: BLE001 - our own or the settings' fault: the run reports it
        return


def defined_at(instance: Any) -> str:  # noqa: ANN401 - a user's object
    """Return where a plug-in's code is, as ` (file.py, line 3)`; empty if unknown."""
    code = plugin_code(instance)
    return "" if code is None else code_at(code.co_filename, code.co_firstlineno)


def plugin_code(instance: Any) -> CodeType | None:  # noqa: ANN401 - a user's object
    """Return the code of the method that a plug-in is called by, if it is Python's."""
    methods = (
        getattr(type(instance), name, None)
        for name in ("share", "predict", "fit", "select", "track")
    )
    codes = (getattr(method, "__code__", None) for method in methods)
    return next((code for code in codes if isinstance(code, CodeType)), None)


def _call(
    plugin_call: PluginCall, stages: StageSettings, *, n_people: int = N_PEOPLE
) -> _CallTime:
    """Call a plug-in on at least `n_people` made-up people; return its time."""
    plugin, consumer = plugin_call
    people = _people(stages, n_people=n_people)
    tracks = cut(people, settings=stages, seed=_SEED)
    order = _order(tracks, stages, n_people=n_people)
    mechanism = plugins.parse("mechanisms", _MECHANISM)[0]
    if consumer is not None and consumer.kind == "linkage":
        return _call_linker(
            plugin, consumer, mechanism, tracks=tracks, order=order, stages=stages
        )
    level = (plugin, ()) if consumer is None else (mechanism, (consumer,))
    work: Work = SceneWork(0, 0, order, (level,))
    if consumer is not None and consumer.reads_patrols:
        work = PatrolWork(people, (level,))
        if consumer.reads_tracks:
            work = TrackingWork(people, (level,))
        stages = stages.changed(
            {"patrol.fleets": 1, "patrol.robots": 1, "tracking.seeds": 1}
        )
    started_s = process_time()
    for _ in compute_cells(work, tracks=tracks, stages=stages, seed=_SEED):
        pass
    spent_s = process_time() - started_s
    return _CallTime(spent_s, order.size * float(np.diff(tracks.offsets).mean()) / 1e6)


def _call_linker(
    plugin: Plugin,
    consumer: Consumer,
    mechanism: Plugin,
    *,
    tracks: Cut,
    order: Ints,
    stages: StageSettings,
) -> _CallTime:
    """Let a linker link two releases of the same people, on whom it is also trained."""
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=_SEED)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=_SEED)
    granted = consumer.granted & sharing.declared_knowledge(plugin)
    releases = (
        sharing.share(mechanism, sensed, "trial", n, seed=_SEED) for n in range(2)
    )
    probe, gallery = (hide_sigma(release, granted) for release in releases)
    copies = copied(probe), copied(gallery)
    context = AttackContext(
        rng=stream(_SEED, "attacks", "trial"),
        epsilon_m=stages.privacy.epsilon_m,
        granted=granted,
        mechanism=mechanism.instance,
        train=LinkageTrainingSet(*copies, np.arange(len(probe))),
    )
    name = f"attack {consumer.label}"
    started_s = process_time()
    attack = guarded(name, lambda: plugin.instance.fit(context))
    score_releases(attack, probe, gallery, plugin=plugin, name=name)
    return _CallTime(process_time() - started_s, len(probe) * len(gallery) / 1e6)


def _order(tracks: Cut, stages: StageSettings, *, n_people: int) -> Ints:
    agents = stages.scenes.agents
    return track_order(
        n_tracks=len(tracks), n_scenes=-(-n_people // agents), agents=agents, seed=_SEED
    )


def _people(stages: StageSettings, *, n_people: int) -> Tracks:
    """Return people who walk in bows, long enough for a history and a future."""
    scenes, conflict, resample = stages.scenes, stages.conflict, stages.resample
    ahead_s = (conflict.horizon_steps + 2) / resample.rate_min_hz
    duration_s = 1.1 * max(
        resample.min_duration_s, ahead_s / (1.0 - scenes.history_ratio)
    )
    t = np.linspace(0.0, duration_s, 2 + int(duration_s / _GRID_S))
    n = max(n_people, scenes.agents)
    rng = stream(_SEED, "trial", "people")
    speed_mps, turn_radps = rng.uniform(0.8, 1.6, n), rng.uniform(0.05, 0.3, n)
    phase = turn_radps[:, None] * t + rng.uniform(0.0, 2.0 * np.pi, n)[:, None]
    radius_m = (speed_mps / turn_radps)[:, None]
    xy = np.stack([radius_m * np.cos(phase), radius_m * np.sin(phase)], axis=2)
    names = tuple(f"person-{number}" for number in range(n))
    return Tracks(
        np.tile(t, n), xy.reshape(-1, 2), np.arange(n + 1) * t.size, names, names
    )
