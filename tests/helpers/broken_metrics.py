"""Plausible mistakes, each of which one check of the metric suite must catch by name.

Most are the right function with one word changed: how samples leak (`leaks`), how segments become
one duration (`durations`), or what is divided by what.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import nan

import numpy as np
from helpers import oracles


def distance(shared_xy, true_xy):
    return np.linalg.norm(shared_xy - true_xy, axis=1)


def strictly(shared_xy, true_xy, epsilon_m):
    return distance(shared_xy, true_xy) < epsilon_m


def or_equal(shared_xy, true_xy, epsilon_m):
    return distance(shared_xy, true_xy) <= epsilon_m


def per_axis(shared_xy, true_xy, epsilon_m):
    return np.abs(shared_xy - true_xy).max(axis=1) < epsilon_m


def squared(shared_xy, true_xy, epsilon_m):
    return distance(shared_xy, true_xy) ** 2 < epsilon_m


def in_a_ring(shared_xy, true_xy, epsilon_m):
    return strictly(shared_xy, true_xy, epsilon_m) & (distance(shared_xy, true_xy) > epsilon_m / 2)


def plr(*, leaks=strictly, share=np.mean):
    return lambda *points: share(leaks(*points))


def over_intervals(leaked):
    return leaked.sum() / max(len(leaked) - 1, 1)


def undefined_for_one(leaked):
    return np.mean(leaked) if len(leaked) > 1 else nan


def first_counts_double(leaked):
    return np.r_[leaked, leaked[:1]].mean()


def raises_on_one(leaked):
    if len(leaked) < 2:
        raise IndexError("too short")
    return np.mean(leaked)


def mean_interval(t):
    return (t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else nan


def duration(
    combine,
    *,
    leaks=strictly,
    change=lambda leaked: leaked,
    interval=mean_interval,
    nothing=0.0,
):
    """Return AEL if `combine` is the mean, MEL if it is max; it is given samples per segment."""

    def descriptor(shared_xy, true_xy, t, epsilon_m):
        found = np.array(oracles.runs(change(leaks(shared_xy, true_xy, epsilon_m))))
        return combine(found) * interval(t) if found.size else nothing

    return descriptor


ael, mel = partial(duration, np.mean), partial(duration, max)


def without_first_segment(leaked):
    return leaked[np.argmin(leaked) if not leaked.all() else leaked.size :]


def without_last_segment(leaked):
    return without_first_segment(leaked[::-1])


def zero_for_one(t):
    return mean_interval(t) if len(t) > 1 else 0.0


def first_interval(t):
    return t[1] - t[0] if len(t) > 1 else nan


def span_over_samples(t):
    return (t[-1] - t[0]) / len(t)


def clock_from_zero(t):
    return t[-1] / (len(t) - 1) if len(t) > 1 else nan


def first_and_last(shared_xy, true_xy, epsilon_m):
    """Index of the first and last sample of every segment."""
    padded = np.r_[False, strictly(shared_xy, true_xy, epsilon_m), False].astype(int)
    return np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1) - 1


def elapsed(combine):
    """Return the time from the first sample of a segment to its last."""

    def descriptor(shared_xy, true_xy, t, epsilon_m):
        first, last = first_and_last(shared_xy, true_xy, epsilon_m)
        return combine(t[last] - t[first]) if first.size else 0.0

    return descriptor


def mel_changes_its_input(shared_xy, true_xy, t, epsilon_m):
    t -= t[0]
    return mel()(shared_xy, true_xy, t, epsilon_m)


def exposure(shared_xy, true_xy, t, offsets, epsilon_m):
    leaked = strictly(shared_xy, true_xy, epsilon_m)
    found = oracles.exposure_of_all(leaked=leaked, t=t, offsets=offsets)[:3]
    return tuple(np.array(values, dtype=float) for values in found)


def exposure_across_tracks(shared_xy, true_xy, t, offsets, epsilon_m):
    """Runs over the flat arrays, booked where they begin."""
    share, ael_s, mel_s = exposure(shared_xy, true_xy, t, offsets, epsilon_m)
    first, last = first_and_last(shared_xy, true_xy, epsilon_m)
    for row, (lo, hi) in enumerate(pairwise(offsets)):
        mine = (last - first + 1)[(first >= lo) & (first < hi)]
        mel_s[row] = mine.max() * mean_interval(t[lo:hi]) if mine.size else 0.0
    return share, ael_s, mel_s


def exposure_sorted_by_length(*walks):
    order = np.argsort(-np.diff(walks[3]), kind="stable")
    return tuple(values[order] for values in exposure(*walks))


def exposure_drops_single_samples(*walks):
    return tuple(values[np.diff(walks[3]) > 1] for values in exposure(*walks))


def grid(t, *, window, steps):
    return oracles.prediction_grid(t=t, window=window, horizon_steps=steps)


def grid_divides_by_the_window(t, window, steps):
    return t[-1] + (t[-1] - t[-window:][0]) / (window - 1) * np.arange(steps)


def path_overshoots(start, destination, speed_mps, elapsed_s):
    way = destination - start
    return start + speed_mps * elapsed_s[:, None] * way / np.linalg.norm(way)


def path_without_its_start(start, destination, speed_mps, elapsed_s):
    way = destination - start
    walked = np.minimum(speed_mps * elapsed_s, np.linalg.norm(way))
    return walked[:, None] * way / np.linalg.norm(way)


def nearest(robot, agents):
    return np.linalg.norm(robot - agents, axis=-1).min()


def separation_of_the_curves(robot, agents):
    return nearest(robot[:, :, None], agents[:, None])


def among(decisions, *, otherwise=nan):
    return decisions.mean() if decisions.size else otherwise


def missed_among_all_scenes(conflict, predicted):
    return (conflict & ~predicted).mean() if conflict.any() else nan


def false_alarms_among_alarms(conflict, predicted):
    return nan if conflict.all() else among(~conflict[predicted])


def fid(extra, *, acts=np.greater):
    """Return a rule with `extra` in units of alpha, from rho and beta, where it acts."""
    return lambda fid, eta, alpha, beta: np.where(acts(fid, eta), alpha * extra(fid / eta, beta), 0)


def past(rho):
    return np.exp(-np.maximum(rho - 1, 0))


BROKEN = [
    ("plr", plr(leaks=or_equal), "plr_boundary_is_strict"),
    ("plr", plr(leaks=per_axis), "plr_distance_is_euclidean"),
    ("plr", plr(leaks=per_axis), "plr_rigid_motion"),
    ("plr", plr(leaks=per_axis), "plr_isotropic_gaussian"),
    ("plr", plr(leaks=squared), "plr_matches_brute_force"),
    ("plr", plr(leaks=squared), "plr_radial_gaussian"),
    ("plr", plr(leaks=in_a_ring), "plr_monotone_in_epsilon"),
    ("plr", plr(share=lambda leaked: 100 * np.mean(leaked)), "plr_all_and_none_leaked"),
    ("plr", plr(share=over_intervals), "plr_hand_examples"),
    ("plr", plr(share=undefined_for_one), "plr_single_sample"),
    ("plr", plr(share=first_counts_double), "plr_time_reversal"),
    ("ael_s", ael(leaks=or_equal), "ael_boundary_is_strict"),
    ("ael_s", duration(np.median), "ael_of_independent_samples"),
    ("ael_s", duration(np.median), "ael_matches_brute_force"),
    ("ael_s", mel(), "ael_may_fall_as_epsilon_grows"),
    ("ael_s", elapsed(np.mean), "ael_hand_examples"),
    ("ael_s", ael(interval=first_interval), "ael_irregular_sampling"),
    ("ael_s", ael(nothing=nan), "ael_all_and_none_leaked"),
    ("ael_s", ael(change=without_first_segment), "ael_segment_at_either_end"),
    ("ael_s", ael(change=without_first_segment), "ael_rigid_motion_and_clock"),
    ("ael_s", ael(interval=zero_for_one), "ael_single_sample"),
    ("mel_s", mel(leaks=or_equal), "mel_boundary_is_strict"),
    ("mel_s", duration(sum), "mel_hand_examples"),
    ("mel_s", duration(sum), "mel_of_independent_samples"),
    ("mel_s", mel(change=without_last_segment), "mel_segment_at_either_end"),
    ("mel_s", mel(change=without_last_segment), "mel_monotone_in_epsilon"),
    ("mel_s", mel(change=without_last_segment), "mel_is_at_least_ael"),
    ("mel_s", mel(interval=first_interval), "mel_irregular_sampling"),
    ("mel_s", elapsed(max), "mel_is_zero_exactly_when_plr_is"),
    ("mel_s", mel(interval=span_over_samples), "mel_all_and_none_leaked"),
    ("mel_s", mel(interval=zero_for_one), "mel_single_sample"),
    ("mel_s", mel(interval=clock_from_zero), "mel_rigid_motion_and_clock"),
    ("mel_s", mel_changes_its_input, "mel_matches_brute_force"),
    ("exposure", exposure_across_tracks, "exposure_stops_at_the_end_of_a_track"),
    ("exposure", exposure_sorted_by_length, "exposure_order_of_tracks"),
    ("exposure", exposure_drops_single_samples, "exposure_matches_brute_force"),
    ("prediction_grid", lambda t, w, h: grid(t, window=w, steps=h + 1)[1:], "grid_starts_now"),
    ("prediction_grid", lambda t, w, h: grid(t, window=w + 1, steps=h), "grid_matches_brute_force"),
    ("prediction_grid", grid_divides_by_the_window, "grid_of_a_short_track"),
    ("robot_path", path_overshoots, "path_walks_then_waits"),
    ("robot_path", path_without_its_start, "path_matches_brute_force"),
    ("minimum_separation", separation_of_the_curves, "separation_hand_examples"),
    ("minimum_separation", lambda r, a: nearest(r[0], a[0]), "separation_symmetries"),
    (
        "minimum_separation",
        lambda r, a: nearest(r[:, 0], a[:, 0]),
        "separation_matches_brute_force",
    ),
    ("is_conflict", lambda gap_m, radius_m: gap_m <= radius_m, "conflict_boundary_is_strict"),
    ("missed_conflict_rate", missed_among_all_scenes, "missed_rate_hand_examples"),
    ("missed_conflict_rate", lambda c, p: among(p[c]), "missed_rate_matches_brute_force"),
    ("false_alarm_rate", false_alarms_among_alarms, "false_alarm_rate_matches_brute_force"),
    ("false_alarm_rate", lambda c, p: among(p[~c], otherwise=0), "false_alarm_rate_hand_examples"),
    ("distance_mae_m", lambda a, b: among(b - a), "distance_mae_hand_examples"),
    ("distance_mae_m", lambda a, b: among((b - a) ** 2) ** 0.5, "distance_mae_matches_brute_force"),
    (
        "fid_d_sigma",
        fid(lambda rho, b: b - past(rho), acts=np.greater_equal),
        "fid_rule_hand_examples",
    ),
    ("fid_d_sigma", fid(lambda rho, b: b - np.exp(-rho)), "fid_rule_matches_brute_force"),
    ("fid_d_sigma", fid(lambda rho, b: b - 1 + past(rho)), "fid_rule_monotone"),
]
"""(function of `Metrics`, what is offered for it, the check that must catch it)"""
