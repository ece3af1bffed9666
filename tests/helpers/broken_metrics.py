"""Plausible mistakes, each of which one check of the metric suite must catch by name.

Most are the right function with one word changed: how samples leak (`LEAKS`), how
segments become one duration (`duration`), or what is divided by what.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import nan

import numpy as np
from helpers import oracles

LEAKS = {
    "strictly": lambda error, epsilon_m: np.hypot(*error.T) < epsilon_m,
    "or_equal": lambda error, epsilon_m: np.hypot(*error.T) <= epsilon_m,
    "per_axis": lambda error, epsilon_m: np.abs(error).max(axis=1) < epsilon_m,
    "squared": lambda error, epsilon_m: (error**2).sum(axis=1) < epsilon_m,
    "in_a_ring": lambda error, epsilon_m: (
        np.abs(np.hypot(*error.T) / epsilon_m - 0.75) < 0.25
    ),
}


def plr(leaks="strictly", share=np.mean):
    return lambda shared_xy, true_xy, epsilon_m: share(
        LEAKS[leaks](shared_xy - true_xy, epsilon_m)
    )


def duration(
    combine, *, leaks="strictly", change=np.asarray, lasting=oracles.own_s, nothing=0.0
):
    """Return AEL if `combine` is the mean, MEL if it is max, of s per segment."""

    def descriptor(shared_xy, true_xy, t, epsilon_m):
        leaked = change(LEAKS[leaks](shared_xy - true_xy, epsilon_m))
        result = oracles.segments_s(leaked, lasting(t))
        return combine(result) if result else nothing

    return descriptor


ael, mel = partial(duration, np.mean), partial(duration, max)


def without_first_segment(leaked):
    first = np.argmin(leaked) if not leaked.all() else leaked.size
    return leaked & (np.arange(leaked.size) >= first)


LOSES_FIRST = ael(change=without_first_segment)
LOSES_LAST = mel(change=lambda leaked: without_first_segment(leaked[::-1])[::-1])

LASTING = {
    "zero_for_one": lambda t: oracles.own_s(t) if len(t) > 1 else [0.0],
    "mean": oracles.mean_s,
    "first": lambda t: [t[1] - t[0] if len(t) > 1 else nan] * len(t),
    "after": lambda t: [*np.diff(t), t[-1] - t[-2]] if len(t) > 1 else [nan],
    "span_over_samples": lambda t: [(t[-1] - t[0]) / len(t)] * len(t),
    "clock_from_zero": lambda t: [t[-1] / (len(t) - 1) if len(t) > 1 else nan] * len(t),
}


def elapsed(combine):
    """Return the time from the first sample of a segment to its last."""

    def descriptor(shared_xy, true_xy, t, epsilon_m):
        padded = np.r_[
            False, LEAKS["strictly"](shared_xy - true_xy, epsilon_m), False
        ].astype(int)
        first, behind = (np.flatnonzero(np.diff(padded) == sign) for sign in (1, -1))
        return combine(t[behind - 1] - t[first]) if first.size else 0.0

    return descriptor


def mel_changes_its_input(shared_xy, true_xy, t, epsilon_m):
    t += 1.0
    return mel()(shared_xy, true_xy, t, epsilon_m)


def exposure(shared_xy, true_xy, t, offsets, epsilon_m):
    leaked = LEAKS["strictly"](shared_xy - true_xy, epsilon_m)
    result = oracles.total_exposure(leaked=leaked, t=t, offsets=offsets)[:3]
    return tuple(np.array(values, dtype=float) for values in result)


def exposure_across_tracks(shared_xy, true_xy, t, offsets, epsilon_m):
    """Takes the first sample of the next track along."""
    result = []
    for lo, hi in pairwise(offsets):
        walk = [values[lo : hi + 1] for values in (shared_xy, true_xy, t)]
        result.append(exposure(*walk, [0, len(walk[2])], epsilon_m))
    return np.concatenate(result, axis=1)


def exposure_sorted_by_length(*walks):
    order = np.argsort(-np.diff(walks[3]), kind="stable")
    return tuple(values[order] for values in exposure(*walks))


def exposure_drops_single_samples(*walks):
    return tuple(values[np.diff(walks[3]) > 1] for values in exposure(*walks))


def grid(t, *, window, steps):
    return oracles.prediction_grid(t=t, window=window, horizon_steps=steps)


def grid_divides_by_the_window(t, window, steps):
    return t[-1] + (t[-1] - t[-window:][0]) / (window - 1) * np.arange(steps)


def path(start, destination, speed_mps, elapsed_s, *, waits, begins):
    way, length_m = destination - start, np.linalg.norm(destination - start)
    walked_m = speed_mps * elapsed_s[:, None]
    return (
        begins * start
        + np.minimum(walked_m, length_m if waits else np.inf) * way / length_m
    )


def nearest(robot, agents):
    return np.linalg.norm(robot - agents, axis=-1).min()


def among(decisions, *, otherwise=nan):
    return decisions.mean() if decisions.size else otherwise


def fid(extra, *, acts=np.greater):
    """Return a rule with `extra` in units of alpha, from rho and beta."""
    return lambda fid, eta, alpha, beta: np.where(
        acts(fid, eta), alpha * extra(fid / eta, beta), 0
    )


def past(rho):
    return np.exp(-np.maximum(rho - 1, 0))


BROKEN = {
    "plr": [
        (plr("or_equal"), "plr_boundary_is_strict"),
        (
            plr("per_axis"),
            "plr_distance_is_euclidean",
            "plr_rigid_motion",
            "plr_isotropic_gaussian",
        ),
        (plr("squared"), "plr_matches_brute_force", "plr_radial_gaussian"),
        (plr("in_a_ring"), "plr_monotone_in_epsilon"),
        (plr(share=lambda leaked: 100 * leaked.mean()), "plr_all_and_none_leaked"),
        (
            plr(share=lambda leaked: leaked.sum() / max(leaked.size - 1, 1)),
            "plr_hand_examples",
        ),
        (
            plr(share=lambda leaked: among(leaked[leaked.size < 2 :])),
            "plr_single_sample",
        ),
        (
            plr(share=lambda leaked: np.r_[leaked, leaked[:1]].mean()),
            "plr_time_reversal",
        ),
    ],
    "ael_s": [
        (ael(leaks="or_equal"), "ael_boundary_is_strict"),
        (
            duration(np.median),
            "ael_averages_independent_samples",
            "ael_matches_brute_force",
        ),
        (mel(), "ael_may_fall_as_epsilon_grows"),
        (elapsed(np.mean), "ael_hand_examples"),
        (
            ael(lasting=LASTING["mean"]),
            "ael_irregular_sampling",
            "ael_matches_brute_force",
        ),
        (
            ael(lasting=LASTING["after"]),
            "ael_irregular_sampling",
            "ael_rigid_motion_and_clock",
        ),
        (ael(nothing=nan), "ael_all_and_none_leaked"),
        (LOSES_FIRST, "ael_segment_at_either_end", "ael_rigid_motion_and_clock"),
        (ael(lasting=LASTING["zero_for_one"]), "ael_single_sample"),
    ],
    "mel_s": [
        (mel(leaks="or_equal"), "mel_boundary_is_strict"),
        (duration(sum), "mel_hand_examples", "mel_averages_independent_samples"),
        (
            LOSES_LAST,
            "mel_segment_at_either_end",
            "mel_monotone_in_epsilon",
            "mel_is_at_least_ael",
        ),
        (mel(lasting=LASTING["first"]), "mel_irregular_sampling"),
        (
            mel(lasting=LASTING["mean"]),
            "mel_irregular_sampling",
            "mel_matches_brute_force",
        ),
        (elapsed(max), "mel_is_zero_exactly_when_plr_is"),
        (mel(lasting=LASTING["span_over_samples"]), "mel_all_and_none_leaked"),
        (mel(lasting=LASTING["zero_for_one"]), "mel_single_sample"),
        (mel(lasting=LASTING["clock_from_zero"]), "mel_rigid_motion_and_clock"),
        (mel_changes_its_input, "mel_matches_brute_force"),
    ],
    "exposure": [
        (exposure_across_tracks, "exposure_stops_at_the_end_of_a_track"),
        (exposure_sorted_by_length, "exposure_order_of_tracks"),
        (exposure_drops_single_samples, "exposure_matches_brute_force"),
    ],
    "prediction_grid": [
        (lambda t, w, h: grid(t, window=w, steps=h + 1)[1:], "grid_starts_now"),
        (lambda t, w, h: grid(t, window=w + 1, steps=h), "grid_matches_brute_force"),
        (grid_divides_by_the_window, "grid_of_a_short_track"),
    ],
    "robot_path": [
        (partial(path, waits=False, begins=True), "path_walks_then_waits"),
        (partial(path, waits=True, begins=False), "path_matches_brute_force"),
    ],
    "minimum_separation": [
        # Of the curves, of the first agent, of the first step.
        (lambda r, a: nearest(r[:, :, None], a[:, None]), "separation_hand_examples"),
        (lambda r, a: nearest(r[0], a[0]), "separation_symmetries"),
        (lambda r, a: nearest(r[:, 0], a[:, 0]), "separation_matches_brute_force"),
    ],
    "is_conflict": [
        (lambda gap_m, radius_m: gap_m <= radius_m, "conflict_boundary_is_strict")
    ],
    "missed_conflict_rate": [
        (lambda c, p: (c & ~p).mean() if c.any() else nan, "missed_rate_hand_examples"),
        (lambda c, p: among(p[c]), "missed_rate_matches_brute_force"),
    ],
    "false_alarm_rate": [
        (
            lambda c, p: nan if c.all() else among(~c[p]),
            "false_alarm_rate_matches_brute_force",
        ),
        (lambda c, p: among(p[~c], otherwise=0), "false_alarm_rate_hand_examples"),
    ],
    "distance_mae_m": [
        (lambda a, b: among(b - a), "distance_mae_hand_examples"),
        (lambda a, b: among((b - a) ** 2) ** 0.5, "distance_mae_matches_brute_force"),
    ],
    "fid_d_sigma": [
        (
            fid(lambda rho, b: b - past(rho), acts=np.greater_equal),
            "fid_rule_hand_examples",
        ),
        (fid(lambda rho, b: b - np.exp(-rho)), "fid_rule_matches_brute_force"),
        (fid(lambda rho, b: b - 1 + past(rho)), "fid_rule_monotone"),
    ],
}
"""What is offered for a function of `Metrics`, and the checks that must catch it."""
