"""Sample tracks of four people: as walked, as shared, and as reconstructed.

Cells hold no positions: the run computes these few once, and a redraw reads them from
its folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from attacks.reconstruction.kalman_rts import RadialRTS
from evaluation.compute.guards import copied, guarded
from evaluation.compute.sharing import samples_shared, share, take_samples
from evaluation.compute.tables import names_column, table
from evaluation.plan.constants import IDENTITY
from isac_track.privacy import leakage_indicator
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.scenes import Cut, make_scenes, track_order
from isac_track.sensing import sense_scenes

if TYPE_CHECKING:
    import pyarrow as pa

    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin

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


def sample_mechanisms(mechanisms: Sequence[Plugin]) -> list[Plugin]:
    """Return the mechanisms of the sample tracks.

    These are raw, the strictest FID and fixed noise near 0.7 m; or the first three.
    """

    def nearest(name: str, level: float) -> list[Plugin]:
        swept = [
            plugin
            for plugin in mechanisms
            if plugin.name == name and plugin.level is not None
        ]
        return sorted(swept, key=lambda plugin: abs((plugin.level or 0.0) - level))[:1]

    raw = [plugin for plugin in mechanisms if plugin.name == "raw"][:1]
    usual = [*raw, *nearest("fid", 0.0), *nearest("fixed", _FIXED_M)]
    if len(usual) == _MOST_MECHANISMS:
        return usual
    return list(mechanisms[:_MOST_MECHANISMS])


def sample_rows(
    mechanism: Plugin,
    *,
    tracks: Cut,
    attacks: Sequence[Plugin],
    stages: StageSettings,
    seed: int,
) -> pa.Table:
    """Return the tracks of the run's first scene, as walked, shared and reconstructed.

    The people are those of the first scene, not chosen by how they look. The adversary
    is blind and uses `radial_rts`, or the first suitable one of `attacks`, the run's
    reconstructions. The columns are `COLUMNS`, t in s and positions in m; there is one
    row for each shared sample. Raises PluginError if a plug-in raises.
    """
    order = track_order(
        n_tracks=len(tracks), n_scenes=1, agents=stages.scenes.agents, seed=seed
    )
    scenes = make_scenes(tracks, order=order, first=0, settings=stages, seed=seed)
    sensed = sense_scenes(scenes, settings=stages.sensing, seed=seed)
    able = [
        plugin
        for plugin in attacks
        if plugin.name != IDENTITY and not plugin.instance.requires
    ]
    able = [plugin for plugin in able if not getattr(plugin.instance, "slow", False)]
    best = min(able, key=lambda plugin: plugin.name != "radial_rts", default=None)
    name, attack = (
        ("radial_rts", RadialRTS()) if best is None else (best.spec, best.instance)
    )
    epsilon_m = stages.privacy.epsilon_m
    release = share(mechanism, sensed, "gallery", seed=seed)
    context = AttackContext(rng=stream(seed, "attack", "gallery"), epsilon_m=epsilon_m)
    hidden = copied(release.without_sigma())
    rebuilt = guarded(f"attack {name!r}", lambda: attack.fit(context)(hidden))
    # A mechanism may share fewer samples than were sensed.
    truth = take_samples(scenes, samples_shared(release, sensed)).xy
    owner = np.repeat(np.arange(len(release)), np.diff(release.offsets))
    columns: dict[str, Any] = {
        "track": owner,
        "source": names_column(scenes.track[owner], tracks.source),
        "mechanism": [mechanism.spec] * owner.size,
        "attack": [name] * owner.size,
        "epsilon_m": np.full(owner.size, epsilon_m),
        "t": release.t - release.t[release.offsets[owner]],
    }
    for version, xy in (
        ("true", truth),
        ("shared", release.xy),
        ("rec", np.asarray(rebuilt.xy)),
    ):
        columns |= {
            f"{axis}_{version}": np.round(xy[:, i], _DIGITS)
            for i, axis in enumerate("xy")
        }
        leaked = leakage_indicator(shared_xy=xy, true_xy=truth, epsilon_m=epsilon_m)
        columns[f"leaked_{version}"] = leaked
    return table(columns).select(COLUMNS)
