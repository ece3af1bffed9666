"""A made-up run in which all that is matched is a straight line in the noise."""

import numpy as np
from helpers.addresses import address_at
from helpers.mechanisms import RULE

from evaluation.estimates.metrics import EQUAL_ALARMS
from evaluation.plan.presets import SHARED
from isac_track.intervals import Estimate

FIXED = dict(zip(np.linspace(0.05, 1.0, 20), np.linspace(0.05, 1.0, 20), strict=True))
FID = dict(zip(10.0 ** np.arange(16), np.linspace(0.8, 0.05, 16), strict=True))
"""Noise of every level."""
PREDICTORS = ("least_squares", "kalman_cv")


def estimate(value, spread, *, n=30):
    """Replicates are the estimate times a common draw, so that all are paired."""
    return Estimate(value, value, value, n, value * (1.0 + spread))


def run(*, advantage=0.0, stranger=0.0):
    """A run: FID leaks less by `advantage`, a user's `mine:Ou` by `stranger`."""
    spread = 0.02 * np.random.default_rng(0).standard_normal(200)
    result = {}

    def level(mechanism, at, noise, gain):
        for predictor, more in zip(PREDICTORS, (0.0, 0.05), strict=True):
            result[address_at(mechanism, at, predictor, "missed_conflict_rate")] = (
                estimate(0.1 + more + 0.2 * noise, spread)
            )
            result[address_at(mechanism, at, predictor, EQUAL_ALARMS)] = estimate(
                0.1 + more + 0.3 * noise, spread
            )
        for metric, scale in (("plr", 1.0), ("ael", 2.0), ("mel", 5.0)):
            value = scale * np.exp(-0.5 - noise - gain)
            result[address_at(mechanism, at, SHARED, metric)] = estimate(value, spread)
            result[address_at(mechanism, at, "kalman_rts", metric, "blind")] = estimate(
                2 * value, spread
            )
        link = estimate(0.7 - 0.3 * noise, spread[:100])
        result[address_at(mechanism, at, "rerelease/shape", "rank1", "blind")] = link
        result[address_at(mechanism, at, "rerelease/control-random", "rank1", "")] = (
            link
        )
        result[address_at(mechanism, at, "new_traversal/shape", "auc", "blind")] = link

    level("raw", None, 0.0, 0.0)
    for rule in ("", RULE):
        for at, noise in FIXED.items():
            level("fixed" + rule, at, noise, 0.0)
        for at, noise in FID.items():
            level("fid" + rule, at, noise, advantage)
    if stranger:
        # Its level counts the other way than that of fixed noise.
        for at, noise in FIXED.items():
            level("mine:Ou", 2.0 - at, noise, stranger)
    return result
