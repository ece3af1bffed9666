"""The free constants of the sensing model, fitted to the paper's numbers.

The paper's link budget leaves three constants open: processing gain (net of the CRB
gap) and large-scale spread are fitted to raw PLR and raw MEL, the CRB gap to the PLR of
FID at eta = 1000, with sigma_cap_m, a fourth one in all but name, fixed beforehand. No
other number was fitted, but all had been seen when the readings were chosen. The ridge
shows how the constants move, and the other numbers with them, when what was fixed
beforehand is fixed elsewhere.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy.optimize import brentq

from evaluation.compute.tables import ROWS
from evaluation.compute.work import Levels, SceneWork, compute_cells
from evaluation.estimates import paper
from evaluation.estimates.paper import PREDICTOR, PUBLISHED
from evaluation.estimates.summary import ratios
from evaluation.plan.constants import BLOCK_SCENES
from evaluation.plan.consumer import Consumer
from isac_track import plugins, privacy, sensing, sharing
from isac_track.config import PrivacySettings, SensingSettings, StageSettings
from isac_track.errors import DataError
from isac_track.place import placed
from isac_track.scenes import Cut, cut, make_scenes, track_order
from isac_track.types import Floats, Ints, Tracks

# Settings of the sensing model.
FITTED = ("processing_gain_db", "large_scale_db", "crb_gap_db")
# Searched ranges in dB.
_GAINS = (-20.0, 60.0)  # Processing gain less the CRB gap.
_SPREADS = (2.0, 30.0)
_GAPS = (0.0, 40.0)
_RESOLUTION_DB = 0.01
_FID_ETA = 1000.0
_LEVELS = ("raw", "fid:1", "fid:1000", "fixed:0.7", "fixed:1")


class Link(NamedTuple):
    """The links of a block of scenes, without the constants to fit."""

    gain: Floats  # (M,) two-way gain without the large-scale part
    large_scale: Floats  # (M,) that part in standard deviations
    unit_norm: Floats  # (M,) norm of the standardised raw error
    t: Floats
    offsets: Ints


Calibration: TypeAlias = "tuple[SensingSettings, Mapping[tuple[str, str], float]]"
"""Fitted constants, and their predictions by SPEC and metric."""


def ridge() -> dict[str, dict[str, float]]:
    """Return other choices of the settings that are fixed beforehand, by name."""
    cases = {f"cap {m:g} m": {"sensing.sigma_cap_m": m} for m in (1.5, 2.5, 3.0)}
    cases |= {
        f"beam {db:.2g} dB": {"sensing.beam_fluctuation_db": db}
        for db in (math.sqrt(2.0), 4.0)
    }
    cases |= {f"exponent {n:g}": {"sensing.path_loss_exponent": n} for n in (2.0, 3.5)}
    return cases


def calibrate(
    recorded: Tracks, *, changes: dict[str, float], n_scenes: int, seed: int
) -> Calibration:
    """Return the constants that reproduce the paper's fitted numbers on a recording.

    `changes` is ``{"stage.key": value}``: settings other than the committed ones.
    Raises DataError if no constants in the searched ranges do.
    """
    stages = StageSettings().changed(changes)
    tracks = cut(placed(recorded, settings=stages), settings=stages, seed=seed)
    published = {tuple(key): value for *key, value in PUBLISHED}
    blocks = links(tracks, stages=stages, n_scenes=n_scenes, seed=seed)
    targets = [published[key] for key in paper.FITTED]
    sensing_fitted = fit(blocks, stages=stages, targets=targets)
    fitted = replace(stages, sensing=sensing_fitted)
    return sensing_fitted, predictions(
        tracks, stages=fitted, n_scenes=n_scenes, seed=seed
    )


def links(
    tracks: Cut, *, stages: StageSettings, n_scenes: int, seed: int
) -> tuple[Link, ...]:
    """Return the links of the run's own scenes, block by block."""
    without_spread = replace(stages.sensing, large_scale_db=0.0)
    station = np.array([stages.sensing.bs_x_m, stages.sensing.bs_y_m])
    blocks = []
    for block in _blocks(tracks, stages=stages, n_scenes=n_scenes, seed=seed):
        scenes = make_scenes(
            tracks,
            order=block.order,
            first=block.first_scene,
            settings=stages,
            seed=seed,
        )
        n_samples = np.diff(scenes.offsets)
        per_track = n_samples.reshape(len(scenes), -1)
        keys = [("scene", int(index)) for index in scenes.index]
        channel = sensing.draw_channel(
            walked_m=sensing.walked_within(scenes.xy, scenes.offsets),
            n_samples=per_track,
            keys=keys,
            settings=stages.sensing,
            seed=seed,
        )
        owner = np.repeat(np.arange(scenes.track.size), n_samples)
        gain = sensing.link_gain(
            distance_m=np.hypot(*(scenes.xy - station).T),
            owner=owner,
            channel=channel,
            settings=without_spread,
        )
        unit_norm = np.hypot(*channel.unit_error.T)
        blocks.append(
            Link(gain, channel.large_scale, unit_norm, scenes.t, scenes.offsets)
        )
    return tuple(blocks)


def descriptors(
    blocks: tuple[Link, ...],
    *,
    settings: SensingSettings,
    rule: PrivacySettings,
    eta: float | None = None,
) -> tuple[float, float]:
    """Return mean PLR and mean MEL in s, raw or under FID with linear adding."""
    plr, mel_s = [], []
    for link in blocks:
        gain = link.gain * 10.0 ** (settings.large_scale_db * link.large_scale / 10.0)
        info = sensing.information(gain=gain, settings=settings)
        sigma = sensing.sigma_from_information(information=info, settings=settings)
        if eta is not None:
            fid = sensing.fisher_information_density(
                information=info, t=link.t, offsets=link.offsets
            )
            sigma = sigma + sharing.fid_d_sigma(fid=fid, eta=eta, alpha_m=0.5, beta=1.5)
        leaked = sigma * link.unit_norm < rule.epsilon_m
        exposure = privacy.exposure(
            leaked=leaked, t=link.t, offsets=link.offsets, intervals=rule.intervals
        )
        plr.append(exposure.plr)
        mel_s.append(exposure.mel_s)
    return float(np.concatenate(plr).mean()), float(np.concatenate(mel_s).mean())


def fit(
    blocks: tuple[Link, ...], *, stages: StageSettings, targets: Sequence[float]
) -> SensingSettings:
    """Return the settings whose `FITTED` constants, to 0.01 dB, reproduce the targets.

    Those are raw PLR, raw MEL in s, and PLR under FID at eta = 1000 with linear adding.
    Raises DataError as `calibrate`.
    """
    raw_plr, raw_mel_s, fid_plr = targets

    def fitted(*constants: float) -> SensingSettings:
        known: Any = dict(zip(FITTED, constants, strict=True))
        return replace(stages.sensing, **known)

    def trial(
        net_db: float,
        spread_db: float,
        gap_db: float = 0.0,
        *,
        eta: float | None = None,
    ) -> tuple[float, float]:
        tried = fitted(net_db + gap_db, spread_db, gap_db)
        return descriptors(blocks, settings=tried, rule=stages.privacy, eta=eta)

    def net_for(spread: float) -> float:
        return _root(
            lambda net: trial(net, spread)[0] - raw_plr, _GAINS, target="raw PLR"
        )

    spread_db = _root(
        lambda db: trial(net_for(db), db)[1] - raw_mel_s, _SPREADS, target="raw MEL"
    )
    net_db = net_for(spread_db)
    gap_db = _root(
        lambda gap: trial(net_db, spread_db, gap, eta=_FID_ETA)[0] - fid_plr,
        _GAPS,
        target=f"PLR at eta = {_FID_ETA:g}",
    )
    constants = net_db + gap_db, spread_db, gap_db
    return fitted(*(round(constant, 2) for constant in constants))


def predictions(
    tracks: Cut, *, stages: StageSettings, n_scenes: int, seed: int
) -> dict[tuple[str, str], float]:
    """Return the run's numbers at the paper's levels, ``{(spec, metric): value}``."""
    (predictor,) = plugins.parse("predictors", PREDICTOR)
    consumers = (Consumer("shared"), Consumer("predictor", predictor))
    mechanisms = plugins.parse_all("mechanisms", _LEVELS)
    levels = tuple((mechanism, consumers) for mechanism in mechanisms)
    sums: dict[tuple[str, str], Floats] = {}
    for block in _blocks(
        tracks, stages=stages, n_scenes=n_scenes, seed=seed, levels=levels
    ):
        for _, level, consumer, tables in compute_cells(
            block, tracks=tracks, stages=stages, seed=seed
        ):
            for metric, ratio in ratios(consumer.kind, tables[ROWS]).items():
                key = level.spec, metric
                sums[key] = sums.get(key, 0.0) + np.sum(ratio, axis=1)
    wanted = {metric for _, _, metric, _ in PUBLISHED}
    return {
        key: float(over / under)
        for key, (over, under) in sums.items()
        if key[1] in wanted
    }


def _blocks(
    tracks: Cut, *, stages: StageSettings, n_scenes: int, seed: int, levels: Levels = ()
) -> Iterator[SceneWork]:
    agents = stages.scenes.agents
    order = track_order(
        n_tracks=len(tracks), n_scenes=n_scenes, agents=agents, seed=seed
    )
    for number, first in enumerate(range(0, n_scenes, BLOCK_SCENES)):
        yield SceneWork(number, first, order[first : first + BLOCK_SCENES], levels)


def _root(
    function: Callable[[float], float], bounds: tuple[float, float], *, target: str
) -> float:
    low, high = function(bounds[0]), function(bounds[1])
    if not (math.isfinite(low) and math.isfinite(high) and low * high <= 0):
        raise DataError(
            f"no constant between {bounds[0]:g} and {bounds[1]:g} dB gives the paper's"
            f" {target} on this recording; the calibration is made for students03"
        )
    return float(brentq(function, *bounds, xtol=_RESOLUTION_DB / 2))
