"""One call of a user's plug-in on made-up people: a broken plug-in fails before a run.

The call has random streams of its own: the numbers of a run do not depend on it.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from types import CodeType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from evaluation.compute import sharing
from evaluation.compute.current_cell import note_cell
from evaluation.compute.linkage import score_releases
from evaluation.compute.work import Block, compute_cells
from isac_track import plugins
from isac_track.errors import PluginError, code_at, raised_at
from isac_track.protocols import AttackContext, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from isac_track.types import Ints, Tracks

if TYPE_CHECKING:
    from evaluation.plan.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.scenes import Cut

# At least so many: a plug-in may need some to hide among, or to learn from.
N_PEOPLE = 12
_SEED = 0
# Predictors and attacks get a release of this mechanism: it declares a sigma.
_MECHANISM = "fixed:0.5"
_GRID_S = 0.1


class PluginCall(NamedTuple):
    """The plug-in that is called once: a mechanism, or a reader of a release."""

    plugin: Plugin
    consumer: Consumer | None = None  # None: the plug-in is a mechanism.


def check_plugin(
    plugin_call: PluginCall, *, stages: StageSettings
) -> Iterator[tuple[str, str]]:
    """Yield the message and the traceback of a plug-in's error, if a call shows one."""
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
        getattr(type(instance), name, None) for name in ("share", "predict", "fit")
    )
    codes = (getattr(method, "__code__", None) for method in methods)
    return next((code for code in codes if isinstance(code, CodeType)), None)


def _call(plugin_call: PluginCall, stages: StageSettings) -> None:
    plugin, consumer = plugin_call
    tracks = cut(_people(stages), settings=stages, seed=_SEED)
    mechanism = plugins.parse("mechanisms", _MECHANISM)[0]
    if consumer is not None and consumer.kind == "linkage":
        _call_linker(plugin, consumer, mechanism, tracks=tracks, stages=stages)
        return
    level = (plugin, ()) if consumer is None else (mechanism, (consumer,))
    block = Block(0, 0, _order(tracks, stages), (level,))
    for _ in compute_cells(block, tracks=tracks, stages=stages, seed=_SEED):
        pass


def _call_linker(
    plugin: Plugin,
    consumer: Consumer,
    mechanism: Plugin,
    *,
    tracks: Cut,
    stages: StageSettings,
) -> None:
    """Let a linker link two releases of the same people, on whom it is also trained."""
    scenes = make_scenes(
        tracks, order=_order(tracks, stages), first=0, settings=stages, seed=_SEED
    )
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=_SEED)
    granted = consumer.granted & sharing.declared(plugin)
    releases = (
        sharing.share(mechanism, sensed, "trial", n, seed=_SEED) for n in range(2)
    )
    probe, gallery = (sharing.hide_sigma(release, granted) for release in releases)
    copies = sharing.copied(probe), sharing.copied(gallery)
    context = AttackContext(
        rng=stream(_SEED, "attacks", "trial"),
        epsilon_m=stages.privacy.epsilon_m,
        granted=granted,
        mechanism=mechanism.instance,
        train=LinkageTrainingSet(*copies, np.arange(len(probe))),
    )
    name = f"attack {consumer.label}"
    attack = sharing.guarded(name, lambda: plugin.instance.fit(context))
    score_releases(attack, probe, gallery, plugin=plugin, name=name)


def _order(tracks: Cut, stages: StageSettings) -> Ints:
    agents = stages.scenes.agents
    return track_order(
        n_tracks=len(tracks), n_scenes=-(-N_PEOPLE // agents), agents=agents, seed=_SEED
    )


def _people(stages: StageSettings) -> Tracks:
    """Return people who walk in bows, long enough for a history and a future."""
    scenes, conflict, resample = stages.scenes, stages.conflict, stages.resample
    ahead_s = (conflict.horizon_steps + 2) / resample.rate_min_hz
    duration_s = 1.1 * max(
        resample.min_duration_s, ahead_s / (1.0 - scenes.history_ratio)
    )
    t = np.linspace(0.0, duration_s, 2 + int(duration_s / _GRID_S))
    n = max(N_PEOPLE, scenes.agents)
    rng = stream(_SEED, "trial", "people")
    speed_mps, turn_radps = rng.uniform(0.8, 1.6, n), rng.uniform(0.05, 0.3, n)
    phase = turn_radps[:, None] * t + rng.uniform(0.0, 2.0 * np.pi, n)[:, None]
    radius_m = (speed_mps / turn_radps)[:, None]
    xy = np.stack([radius_m * np.cos(phase), radius_m * np.sin(phase)], axis=2)
    names = tuple(f"person-{number}" for number in range(n))
    return Tracks(
        np.tile(t, n), xy.reshape(-1, 2), np.arange(n + 1) * t.size, names, names
    )
