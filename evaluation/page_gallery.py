"""A gallery of tracks: where four people walked, what was shared of it, and what was rebuilt.

Cells hold no positions. So the run computes these few once and keeps them in the run folder,
where a redraw finds them.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from attacks.reconstruction.radial_rts import RadialRTS
from evaluation.plugin_calls import copied, guarded
from evaluation.store import write_whole
from evaluation.sweeps import CONTROL
from isac_track.errors import DataError
from isac_track.privacy import leakage_indicator
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.scenes import make_scenes, track_order
from isac_track.sensing import sense_scenes

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from isac_track.config import StageSettings
    from isac_track.plugins import Plugin
    from isac_track.protocols import ReconstructionAttack
    from isac_track.scenes import Cut
    from isac_track.types import Bools, Floats, Release, Scenes, Sensed

GALLERY = "gallery.parquet"
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
_PERCENT = 100.0
_SHARED_COLOUR, _REBUILT_COLOUR = "#D55E00", "#0072B2"
_BAR_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


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


def write_gallery(parts: Sequence[pd.DataFrame], *, out: Path) -> None:
    """Keep the gallery in a run folder; without parts there is none, nor an earlier one.

    Raises
    ------
    DataError
        If the folder cannot be written.
    """
    if not parts:
        (out / GALLERY).unlink(missing_ok=True)
        return
    sink = io.BytesIO()
    pd.concat(parts, ignore_index=True).to_parquet(sink, index=False)
    write_whole(out / GALLERY, sink.getvalue())


def read_gallery(out: Path) -> pd.DataFrame | None:
    """Return the gallery of a run folder; None if it has none.

    Raises
    ------
    DataError
        If the file is broken.
    """
    path = out / GALLERY
    if not path.exists():
        return None
    try:
        rows = pd.read_parquet(path)
    except (OSError, ValueError) as error:
        raise DataError(f"{path} cannot be read ({error}); delete it") from None
    if not set(COLUMNS) <= set(rows.columns):
        raise DataError(f"{path} is of another version; delete it")
    return rows


def gallery_figure(rows: pd.DataFrame) -> Figure | None:
    """Return a panel for each person and mechanism; None without rows.

    Shared samples that leak are dots, stretches of the reconstruction that leak are thick.
    """
    if rows.empty:
        return None
    from evaluation import figure_style  # noqa: PLC0415 - computing rows needs no figure

    people = list(rows["track"].unique())
    mechanisms = list(rows["mechanism"].unique())
    figure = figure_style.placed_figure(
        width_in=figure_style.DOUBLE_COLUMN_IN, height_in=1.75 * len(people) + 0.85
    )
    panels = figure_style.placed(
        figure, rows=len(people), columns=len(mechanisms), left_in=0.3, right_in=0.1, top_in=0.6,
        bottom_in=0.4, gap_in=0.12, between_in=0.2,
    )  # fmt: skip
    width, height = panels[0, 0].get_position().size * figure.get_size_inches()
    for person, in_row in zip(people, panels, strict=True):
        of = rows[rows["track"] == person]
        corners = _window(of, shape=width / height)
        in_row[0].set_ylabel(f"person {person + 1}")
        for mechanism, ax in zip(mechanisms, in_row, strict=True):
            part = of[of["mechanism"] == mechanism]
            _draw(ax, part)
            ax.set_xlim(*corners[0])
            ax.set_ylim(*corners[1])
            _scale_bar(ax, span_m=corners[0][1] - corners[0][0])
    for mechanism, ax in zip(mechanisms, panels[0], strict=True):
        ax.set_title(mechanism, fontweight="bold", pad=14)
    figure_style.legend_in_rows(figure, _handles(), columns=5)
    first = rows.iloc[0]
    figure_style.title(
        figure,
        dataset="tracks",
        what=f"true, shared, rebuilt by {first['attack']} (blind); a leak is closer than "
        f"{first['epsilon_m']:g} m",
        one_line=True,
    )
    return figure


def leak_shares(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the share of leaked samples as shared and rebuilt, a row for each mechanism."""
    return rows.groupby("mechanism", sort=False)[["leaked_shared", "leaked_rec"]].mean()


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
        and plugin.name != CONTROL
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


def _window(of: pd.DataFrame, *, shape: float) -> list[tuple[float, float]]:
    """Return the limits in m that hold a walk and most of what was shared, equal in scale."""
    shared = of[["x_shared", "y_shared"]].to_numpy()
    # A few far samples would make the walk tiny.
    low, high = np.percentile(shared, [5.0, 95.0], axis=0)
    for what in ("true", "rec"):
        walk = of[[f"x_{what}", f"y_{what}"]].to_numpy()
        low, high = np.minimum(low, walk.min(axis=0)), np.maximum(high, walk.max(axis=0))
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + 0.2
    half_x = max(half[0], half[1] * shape, 0.5)
    half_y = half_x / shape
    return [
        (float(middle[0] - half_x), float(middle[0] + half_x)),
        (float(middle[1] - half_y), float(middle[1] + half_y)),
    ]


def _draw(ax: Axes, part: pd.DataFrame) -> None:
    x, y = part["x_shared"].to_numpy(), part["y_shared"].to_numpy()
    leaked = part["leaked_shared"].to_numpy()
    look: dict[str, Any] = {"color": _SHARED_COLOUR, "linestyle": "", "markeredgewidth": 0}
    ax.plot(x[~leaked], y[~leaked], "o", markersize=1.1, alpha=0.45, zorder=1, **look)
    ax.plot(x[leaked], y[leaked], "o", markersize=1.9, zorder=3, **look)
    x, y = part["x_rec"].to_numpy(), part["y_rec"].to_numpy()
    leaked = part["leaked_rec"].to_numpy()
    ax.plot(x, y, color=_REBUILT_COLOUR, linewidth=0.7, zorder=2)
    ax.plot(
        *(np.where(leaked, values, np.nan) for values in (x, y)),
        color=_REBUILT_COLOUR,
        linewidth=3.2,
        alpha=0.35,
        solid_capstyle="round",
        zorder=1.5,
    )
    ax.plot(part["x_true"], part["y_true"], color="black", linewidth=0.8, zorder=4)
    shares = [_PERCENT * part[name].mean() for name in ("leaked_shared", "leaked_rec")]
    ax.text(
        0.0,
        1.02,
        f"leaks: shared {shares[0]:.0f} %, rebuilt {shares[1]:.0f} %",
        transform=ax.transAxes,
        verticalalignment="bottom",
    )
    ax.grid(visible=False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.spines[:].set(visible=True, color="#dddddd")


def _scale_bar(ax: Axes, *, span_m: float) -> None:
    length = max((one for one in _BAR_M if one < 0.3 * span_m), default=_BAR_M[0])
    left, bottom = ax.get_xlim()[0], ax.get_ylim()[0]
    x, y = left + 0.03 * span_m, bottom + 0.06 * (ax.get_ylim()[1] - bottom)
    ax.plot([x, x + length], [y, y], color="#777777", linewidth=1.2, zorder=6)
    ax.text(x + length, y, f" {length:g} m", verticalalignment="center", color="#777777", zorder=6)


def _handles() -> list[Any]:
    from matplotlib.lines import Line2D  # noqa: PLC0415 - computing rows needs no figure

    blue = _REBUILT_COLOUR
    dots: dict[str, Any] = {"color": _SHARED_COLOUR, "marker": "o", "linestyle": ""}
    return [
        Line2D([], [], color="black", linewidth=0.8, label="true"),
        Line2D([], [], markersize=1.1, alpha=0.6, label="shared", **dots),
        Line2D([], [], markersize=2.4, label="shared, leaks", **dots),
        Line2D([], [], color=blue, linewidth=0.7, label="rebuilt"),
        Line2D([], [], color=blue, linewidth=3.2, alpha=0.35, label="rebuilt, leaks"),
    ]
