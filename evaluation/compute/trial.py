"""One call of a stranger's plug-in on made-up people, before a run: what is broken fails at once.

All of it has streams of its own: a run comes out the same with it as without.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterator
from types import CodeType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from evaluation.compute import sharing
from evaluation.compute.linkage import scores_of
from evaluation.compute.where import note
from evaluation.compute.work import Block, cells
from isac_track import plugins
from isac_track.errors import PluginError, code_at, raised_at
from isac_track.protocols import AttackContext, LinkageTrainingSet
from isac_track.rng import stream
from isac_track.scenes import cut, make_scenes, track_order
from isac_track.sensing import sense_scenes
from isac_track.types import Tracks

if TYPE_CHECKING:
    from evaluation.plan.axes import Consumer
    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

# At least so many: a plug-in may need some to hide among, or to learn from.
N_PEOPLE = 12
_SEED = 0
_MECHANISM = (  # Whose release predictors and attacks are called with: it has a sigma.
    "fixed:0.5"
)
_GRID_S = 0.1


class Trial(NamedTuple):
    """What is called once: a mechanism, or what reads a release."""

    plugin: Plugin
    consumer: Consumer | None = None  # None: the plug-in is a mechanism.


def attempted(trial: Trial, *, stages: StageSettings) -> Iterator[tuple[str, str]]:
    """Yield what a plug-in does wrong, if a call shows it, and the traceback."""
    note(trial.plugin.spec)
    try:
        _call(trial, stages)
    except PluginError as error:
        is_told = error.__cause__ is not None and raised_at(error.__cause__)
        why = str(error) if is_told else f"{error}{defined_at(trial.plugin.instance)}"
        yield why, "".join(traceback.format_exception(error))
    except Exception:  # noqa: BLE001 - our own fault, or the settings': the run tells it
        return


def defined_at(instance: Any) -> str:  # noqa: ANN401 - a stranger's
    """Return file and line of what a plug-in is called by, as ` (file.py, line 3)`, if known."""
    code = code_of(instance)
    return "" if code is None else code_at(code.co_filename, code.co_firstlineno)


def code_of(instance: Any) -> CodeType | None:  # noqa: ANN401 - a stranger's
    """Return the code of what a plug-in is called by, if it is Python's."""
    calls = (
        getattr(type(instance), name, None) for name in ("share", "predict", "fit")
    )
    codes = (getattr(call, "__code__", None) for call in calls)
    return next((code for code in codes if isinstance(code, CodeType)), None)


def _call(trial: Trial, stages: StageSettings) -> None:
    tracks = cut(_people(stages), settings=stages, seed=_SEED)
    agents, n_scenes = stages.scenes.agents, -(-N_PEOPLE // stages.scenes.agents)
    order = track_order(
        n_tracks=len(tracks), n_scenes=n_scenes, agents=agents, seed=_SEED
    )
    mechanism, consumer = plugins.parse("mechanisms", _MECHANISM)[0], trial.consumer
    if consumer is None or consumer.kind != "linkage":
        level = (trial.plugin, ()) if consumer is None else (mechanism, (consumer,))
        list(
            cells(
                Block(0, 0, order, (level,)), tracks=tracks, stages=stages, seed=_SEED
            )
        )
        return
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=_SEED)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=_SEED)
    # Everybody comes again, and who learns has learnt on the same people.
    plugin, granted = trial.plugin, consumer.granted & sharing.declared(trial.plugin)
    releases = (
        sharing.share(mechanism, sensed, "trial", n, seed=_SEED) for n in range(2)
    )
    probe, gallery = (sharing.showing(one, granted) for one in releases)
    copies = sharing.copied(probe), sharing.copied(gallery)
    context = AttackContext(
        rng=stream(_SEED, "attacks", "trial"),
        epsilon_m=stages.privacy.epsilon_m,
        granted=granted,
        mechanism=mechanism.instance,
        train=LinkageTrainingSet(*copies, np.arange(len(probe))),
    )
    who = f"attack {consumer.label}"
    attack = sharing.guarded(who, lambda: plugin.instance.fit(context))
    scores_of(attack, probe, gallery, plugin=plugin, who=who)


def _people(stages: StageSettings) -> Tracks:
    """Return people who walk in bows, long enough for their history and their future."""
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
