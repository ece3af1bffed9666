"""A gallery of tracks: where four people walked, what was shared of it, and what was rebuilt.

Cells hold no positions. So the run computes these few once and keeps them in the run folder,
where a redraw finds them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from attacks.reconstruction.radial_rts import RadialRTS
from evaluation.cells.plugin_calls import copied, guarded
from evaluation.experiment.constants import IDENTITY
from isac_track.privacy import leakage_indicator
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.scenes import make_scenes, track_order
from isac_track.sensing import sense_scenes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.protocols import ReconstructionAttack
    from isac_track.scenes import Cut
    from isac_track.types import Bools, Floats, Release, Scenes, Sensed

COLUMNS = [
    "track",
    "source",
    "mechanism",
    "attack",
    "epsilon_m",
    "t",
    "x_true",
    "y_true",
    "x_shared",
    "y_shared",
    "x_rec",
    "y_rec",
    "leaked_shared",
    "leaked_rec",
]
_MOST_MECHANISMS = 3
_FIXED_M = 0.7
_DIGITS = 3


def gallery_rows(
    *,
    tracks: Cut,
    mechanisms: Sequence[Plugin],
    attacks: Sequence[Plugin],
    stages: StageSettings,
    seed: int,
) -> pd.DataFrame:
    """Return the tracks of the run's first scene, as they were, shared and rebuilt.

    The people are those of the first scene, not chosen by how they look. Mechanisms: raw, FID at
    its strictest threshold and fixed noise at 0.7 m or the next level, or else the first three.
    The adversary is blind and uses `radial_rts`, or what the run has instead.

    Parameters
    ----------
    tracks : Cut
    mechanisms, attacks : sequence of Plugin
        Of the run; attacks are reconstructions.
    stages : StageSettings
    seed : int

    Returns
    -------
    DataFrame
        `COLUMNS`; t in s, positions in m, one row for each shared sample.

    Raises
    ------
    PluginError
        If a plug-in raises.
    """
    order = track_order(n_tracks=len(tracks), n_scenes=1, agents=stages.scenes.agents, seed=seed)
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=seed)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    name, attack = _attack(attacks)
    parts = []
    for mechanism in chosen(mechanisms):
        release, rebuilt = _shared_and_rebuilt(
            mechanism, name, attack, sensed=sensed, epsilon_m=stages.privacy.epsilon_m, seed=seed
        )
        parts.append(
            _rows(
                scenes,
                release,
                rebuilt,
                mechanism=mechanism.spec,
                attack=name,
                sources=[tracks.source[row] for row in scenes.track.tolist()],
                epsilon_m=stages.privacy.epsilon_m,
            )
        )
    return pd.concat(parts, ignore_index=True)


def _shared_and_rebuilt(
    mechanism: Plugin,
    name: str,
    attack: ReconstructionAttack,
    *,
    sensed: Sensed,
    epsilon_m: float,
    seed: int,
) -> tuple[Release, Floats]:
    """Return what is shared of some tracks, and what a blind adversary rebuilds, (M, 2) m."""
    release: Release = guarded(
        f"mechanism {mechanism.spec!r}",
        lambda: mechanism.instance.share(sensed, stream(seed, "sharing", "gallery")),
    )
    context = AttackContext(rng=stream(seed, "attack", "gallery"), epsilon_m=epsilon_m)
    hidden = copied(release.without_sigma())
    rebuilt = guarded(f"attack {name!r}", lambda: attack.fit(context)(hidden))
    return release, np.asarray(rebuilt.xy)


def _attack(attacks: Sequence[Plugin]) -> tuple[str, ReconstructionAttack]:
    able = [
        plugin
        for plugin in attacks
        if not plugin.instance.requires
        and plugin.name != IDENTITY
        and not getattr(plugin.instance, "slow", False)
    ]
    for plugin in sorted(able, key=lambda one: one.name != "radial_rts"):
        return plugin.spec, plugin.instance
    return "radial_rts", RadialRTS()


def chosen(mechanisms: Sequence[Plugin]) -> list[Plugin]:
    """Return the mechanisms that are shown: see `gallery_rows`."""
    by_name: dict[str, list[Plugin]] = {}
    for plugin in mechanisms:
        by_name.setdefault(plugin.name, []).append(plugin)
    fid, fixed = (
        [plugin for plugin in by_name.get(name, ()) if plugin.level is not None]
        for name in ("fid", "fixed")
    )
    usual = by_name.get("raw", [])[:1]
    usual += sorted(fid, key=lambda one: one.level or 0.0)[:1]
    usual += sorted(fixed, key=lambda one: abs((one.level or 0.0) - _FIXED_M))[:1]
    return usual if len(usual) == _MOST_MECHANISMS else list(mechanisms[:_MOST_MECHANISMS])


def _rows(
    scenes: Scenes,
    release: Release,
    rebuilt: Floats,
    *,
    mechanism: str,
    attack: str,
    sources: Sequence[str],
    epsilon_m: float,
) -> pd.DataFrame:
    owner = np.repeat(np.arange(len(release)), np.diff(release.offsets))
    # A mechanism may share fewer samples than were sensed.
    true_owner = np.repeat(np.arange(len(release)), np.diff(scenes.offsets))
    kept = pd.MultiIndex.from_arrays([true_owner, scenes.t]).isin(
        pd.MultiIndex.from_arrays([owner, release.t])
    )
    truth = scenes.xy[kept]

    def leaks(xy: Floats) -> Bools:
        return leakage_indicator(shared_xy=xy, true_xy=truth, epsilon_m=epsilon_m)

    frame = pd.DataFrame(
        {
            "track": owner,
            "source": [sources[row] for row in owner.tolist()],
            "mechanism": mechanism,
            "attack": attack,
            "epsilon_m": epsilon_m,
            "t": release.t - release.t[release.offsets[owner]],
            "leaked_shared": leaks(release.xy),
            "leaked_rec": leaks(rebuilt),
        }
    )
    for what, xy in (("true", truth), ("shared", release.xy), ("rec", rebuilt)):
        for place, axis in enumerate("xy"):
            frame[f"{axis}_{what}"] = np.round(xy[:, place], _DIGITS)
    return frame[COLUMNS]
