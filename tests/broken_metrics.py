"""Plausible mistakes, each of which one check of the metric suite must catch by name."""

from __future__ import annotations

from itertools import pairwise
from math import exp, nan

import numpy as np
from helpers import oracles


def distance(shared_xy, true_xy):
    return np.linalg.norm(shared_xy - true_xy, axis=1)


def runs(shared_xy, true_xy, epsilon_m):
    return oracles.runs(distance(shared_xy, true_xy) < epsilon_m)


def mean_interval(t):
    return (t[-1] - t[0]) / (len(t) - 1) if len(t) > 1 else nan


def first_and_last(shared_xy, true_xy, epsilon_m):
    """Index of the first and last sample of every segment."""
    padded = np.r_[False, distance(shared_xy, true_xy) < epsilon_m, False].astype(int)
    return np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1) - 1


# PLR


def plr_not_strict(shared_xy, true_xy, epsilon_m):
    return np.mean(distance(shared_xy, true_xy) <= epsilon_m)


def plr_per_axis(shared_xy, true_xy, epsilon_m):
    return np.mean(np.abs(shared_xy - true_xy).max(axis=1) < epsilon_m)


def plr_city_block(shared_xy, true_xy, epsilon_m):
    return np.mean(np.abs(shared_xy - true_xy).sum(axis=1) < epsilon_m)


def plr_in_percent(shared_xy, true_xy, epsilon_m):
    return 100 * np.mean(distance(shared_xy, true_xy) < epsilon_m)


def plr_over_intervals(shared_xy, true_xy, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    return leaked.sum() / max(len(leaked) - 1, 1)


def plr_squared_distance(shared_xy, true_xy, epsilon_m):
    return np.mean(distance(shared_xy, true_xy) ** 2 < epsilon_m)


def plr_undefined_for_one_sample(shared_xy, true_xy, epsilon_m):
    share = np.mean(distance(shared_xy, true_xy) < epsilon_m)
    return share if len(true_xy) > 1 else nan


def plr_raises_on_one_sample(shared_xy, true_xy, epsilon_m):
    if len(true_xy) < 2:
        raise IndexError("too short")
    return np.mean(distance(shared_xy, true_xy) < epsilon_m)


def plr_of_distances_from_the_origin(shared_xy, true_xy, epsilon_m):
    return np.mean(np.abs(np.hypot(*shared_xy.T) - np.hypot(*true_xy.T)) < epsilon_m)


# AEL


def ael_not_strict(shared_xy, true_xy, t, epsilon_m):
    found = oracles.runs(distance(shared_xy, true_xy) <= epsilon_m)
    return np.mean(found) * mean_interval(t) if found else 0.0


def ael_over_all_samples(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return sum(found) / len(t) * mean_interval(t) if found else 0.0


def ael_median_segment(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return np.median(found) * mean_interval(t) if found else 0.0


def ael_is_longest(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return max(found) * mean_interval(t) if found else 0.0


def ael_weighted_by_length(shared_xy, true_xy, t, epsilon_m):
    found = np.array(runs(shared_xy, true_xy, epsilon_m))
    return (found**2).sum() / found.sum() * mean_interval(t) if found.size else 0.0


def ael_one_sample_lasts_zero(shared_xy, true_xy, t, epsilon_m):
    first, last = first_and_last(shared_xy, true_xy, epsilon_m)
    return np.mean(t[last] - t[first]) if first.size else 0.0


def ael_elapsed_time(shared_xy, true_xy, t, epsilon_m):
    first, last = first_and_last(shared_xy, true_xy, epsilon_m)
    return np.mean(t[last] - t[first]) + mean_interval(t) if first.size else 0.0


def ael_nothing_leaked_is_undefined(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return np.mean(found) * mean_interval(t) if found else nan


def ael_forgets_first_segment(shared_xy, true_xy, t, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    while leaked.size and leaked[0]:
        leaked = leaked[1:]
    found = oracles.runs(leaked)
    return np.mean(found) * mean_interval(t) if found else 0.0


def ael_single_sample_is_zero(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return np.mean(found) * mean_interval(t) if found and len(t) > 1 else 0.0


def ael_from_the_first_interval(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    interval_s = t[1] - t[0] if len(t) > 1 else nan
    return np.mean(found) * interval_s if found else 0.0


# MEL


def mel_not_strict(shared_xy, true_xy, t, epsilon_m):
    found = oracles.runs(distance(shared_xy, true_xy) <= epsilon_m)
    return max(found) * mean_interval(t) if found else 0.0


def mel_is_total(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return sum(found) * mean_interval(t) if found else 0.0


def mel_forgets_last_segment(shared_xy, true_xy, t, epsilon_m):
    longest = current = 0
    for leaked in distance(shared_xy, true_xy) < epsilon_m:
        if leaked:
            current += 1
        else:
            longest, current = max(longest, current), 0
    return longest * mean_interval(t) if longest else 0.0


def mel_forgets_first_segment(shared_xy, true_xy, t, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    while leaked.size and leaked[0]:
        leaked = leaked[1:]
    found = oracles.runs(leaked)
    return max(found) * mean_interval(t) if found else 0.0


def mel_never_resets(shared_xy, true_xy, t, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    return leaked.sum() * mean_interval(t) if leaked.any() else 0.0


def mel_wraps_around(shared_xy, true_xy, t, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    found = oracles.runs(np.tile(leaked, 2))
    return min(max(found), len(t)) * mean_interval(t) if found else 0.0


def mel_median_interval(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    interval_s = np.median(np.diff(t)) if len(t) > 1 else nan
    return max(found) * interval_s if found else 0.0


def mel_one_sample_lasts_zero(shared_xy, true_xy, t, epsilon_m):
    first, last = first_and_last(shared_xy, true_xy, epsilon_m)
    return max(t[last] - t[first]) if first.size else 0.0


def mel_span_over_samples(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return max(found) * (t[-1] - t[0]) / len(t) if found else 0.0


def mel_in_samples(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return max(found) if found and len(t) > 1 else (nan if found else 0)


def mel_single_sample_is_zero(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    return max(found) * mean_interval(t) if found and len(t) > 1 else 0.0


def mel_of_a_clock_from_zero(shared_xy, true_xy, t, epsilon_m):
    found = runs(shared_xy, true_xy, epsilon_m)
    interval_s = t[-1] / (len(t) - 1) if len(t) > 1 else nan
    return max(found) * interval_s if found else 0.0


def mel_changes_its_input(shared_xy, true_xy, t, epsilon_m):
    t -= t[0]
    return mel_of_a_clock_from_zero(shared_xy, true_xy, t, epsilon_m)


def mel_returns_nothing(shared_xy, true_xy, t, epsilon_m):  # noqa: ARG001
    return None


# Batches


def exposure_across_tracks(shared_xy, true_xy, t, offsets, epsilon_m):
    """Runs over the flat arrays, booked where they begin."""
    plr, ael_s, mel_s = exposure_correct(shared_xy, true_xy, t, offsets, epsilon_m)
    first, last = first_and_last(shared_xy, true_xy, epsilon_m)
    for row, (lo, hi) in enumerate(pairwise(offsets)):
        mine = (first >= lo) & (first < hi)
        if mine.any():
            mel_s[row] = (last - first + 1)[mine].max() * mean_interval(t[lo:hi])
        else:
            mel_s[row] = 0.0
    return plr, ael_s, mel_s


def exposure_one_interval_for_all(shared_xy, true_xy, t, offsets, epsilon_m):
    plr, ael_s, mel_s = exposure_correct(shared_xy, true_xy, t, offsets, epsilon_m)
    own = np.array([mean_interval(t[a:b]) for a, b in pairwise(offsets)])
    return plr, ael_s / own * np.nanmean(own), mel_s / own * np.nanmean(own)


def exposure_sorted_by_length(shared_xy, true_xy, t, offsets, epsilon_m):
    found = exposure_correct(shared_xy, true_xy, t, offsets, epsilon_m)
    order = np.argsort(-np.diff(offsets), kind="stable")
    return tuple(values[order] for values in found)


def exposure_drops_single_samples(shared_xy, true_xy, t, offsets, epsilon_m):
    found = exposure_correct(shared_xy, true_xy, t, offsets, epsilon_m)
    return tuple(values[np.diff(offsets) > 1] for values in found)


def exposure_correct(shared_xy, true_xy, t, offsets, epsilon_m):
    leaked = distance(shared_xy, true_xy) < epsilon_m
    found = oracles.exposure_of_all(leaked=leaked, t=t, offsets=offsets)[:3]
    return tuple(np.array(values, dtype=float) for values in found)


# The robot's task


def grid_starts_one_step_late(t, window, horizon_steps):
    return oracles.prediction_grid(t=t, window=window, horizon_steps=horizon_steps + 1)[1:]


def grid_from_all_samples(t, window, horizon_steps):  # noqa: ARG001
    return oracles.prediction_grid(t=t, window=len(t), horizon_steps=horizon_steps)


def grid_window_in_intervals(t, window, horizon_steps):
    return oracles.prediction_grid(t=t, window=window + 1, horizon_steps=horizon_steps)


def grid_divides_by_the_window(t, window, horizon_steps):
    step_s = (t[-1] - t[-window:][0]) / (window - 1)
    return t[-1] + step_s * np.arange(horizon_steps)


def path_overshoots(start, destination, speed_mps, elapsed_s):
    way = destination - start
    return start + speed_mps * elapsed_s[:, None] * way / np.linalg.norm(way)


def path_without_its_start(start, destination, speed_mps, elapsed_s):
    way = destination - start
    walked = np.minimum(speed_mps * elapsed_s, np.linalg.norm(way))
    return walked[:, None] * way / np.linalg.norm(way)


def separation_of_the_curves(robot, agents):
    gap = robot[:, :, None] - agents[:, None]
    return np.linalg.norm(gap, axis=-1).min()


def separation_of_the_first_agent(robot, agents):
    return np.linalg.norm(robot[0] - agents[0], axis=-1).min()


def separation_now(robot, agents):
    return np.linalg.norm(robot[:, 0] - agents[:, 0], axis=-1).min()


def conflict_not_strict(separation_m, safety_radius_m):
    return separation_m <= safety_radius_m


def missed_among_all_scenes(conflict, predicted):
    return (conflict & ~predicted).mean() if conflict.any() else nan


def missed_is_recall(conflict, predicted):
    return predicted[conflict].mean() if conflict.any() else nan


def missed_zero_without_conflict(conflict, predicted):
    return (~predicted)[conflict].mean() if conflict.any() else 0.0


def false_alarms_among_alarms(conflict, predicted):
    return (~conflict)[predicted].mean() if predicted.any() and not conflict.all() else nan


def false_alarms_zero_without_a_chance(conflict, predicted):
    return predicted[~conflict].mean() if not conflict.all() else 0.0


def mae_signed(true_m, predicted_m):
    return (predicted_m - true_m).mean() if true_m.size else nan


def mae_is_rmse(true_m, predicted_m):
    return np.sqrt(((predicted_m - true_m) ** 2).mean()) if true_m.size else nan


def mae_zero_without_a_scene(true_m, predicted_m):
    return np.abs(predicted_m - true_m).mean() if true_m.size else 0.0


# The FID rule


def fid_acts_at_the_threshold(fid, eta, alpha_m, beta):
    rho = fid / eta
    extra = alpha_m * (beta - np.exp(-np.maximum(rho - 1, 0)))
    return np.where(rho >= 1, extra, 0)


def fid_clipped_at_zero(fid, eta, alpha_m, beta):
    return np.maximum(alpha_m * (beta - np.exp(-(fid / eta - 1))), 0)


def fid_without_the_shift(fid, eta, alpha_m, beta):
    return np.where(fid > eta, alpha_m * (beta - np.exp(-fid / eta)), 0)


def fid_inverted(fid, eta, alpha_m, beta):
    return np.where(fid > eta, alpha_m * (beta - 1 + np.exp(-np.maximum(fid / eta - 1, 0))), 0)


def fid_grows_without_bound(fid, eta, alpha_m, beta):
    return [
        alpha_m * (beta - exp(1 - one / eta)) * max(1, one / eta) if one > eta else 0.0
        for one in fid
    ]


BROKEN = [
    ("plr", plr_not_strict, "plr_boundary_is_strict"),
    ("plr", plr_per_axis, "plr_distance_is_euclidean"),
    ("plr", plr_city_block, "plr_distance_is_euclidean"),
    ("plr", plr_per_axis, "plr_rigid_motion"),
    ("plr", plr_in_percent, "plr_all_and_none_leaked"),
    ("plr", plr_over_intervals, "plr_hand_examples"),
    ("plr", plr_squared_distance, "plr_matches_brute_force"),
    ("plr", plr_squared_distance, "plr_radial_gaussian"),
    ("plr", plr_per_axis, "plr_isotropic_gaussian"),
    ("plr", plr_undefined_for_one_sample, "plr_single_sample"),
    ("plr", plr_raises_on_one_sample, "plr_single_sample"),
    ("plr", plr_of_distances_from_the_origin, "plr_rigid_motion"),
    ("ael_s", ael_not_strict, "ael_boundary_is_strict"),
    ("ael_s", ael_over_all_samples, "ael_hand_examples"),
    ("ael_s", ael_median_segment, "ael_of_independent_samples"),
    ("ael_s", ael_median_segment, "ael_matches_brute_force"),
    ("ael_s", ael_is_longest, "ael_may_fall_as_epsilon_grows"),
    ("ael_s", ael_weighted_by_length, "ael_may_fall_as_epsilon_grows"),
    ("ael_s", ael_one_sample_lasts_zero, "ael_hand_examples"),
    ("ael_s", ael_elapsed_time, "ael_irregular_sampling"),
    ("ael_s", ael_from_the_first_interval, "ael_irregular_sampling"),
    ("ael_s", ael_nothing_leaked_is_undefined, "ael_all_and_none_leaked"),
    ("ael_s", ael_forgets_first_segment, "ael_segment_at_either_end"),
    ("ael_s", ael_forgets_first_segment, "ael_rigid_motion_and_clock"),
    ("ael_s", ael_single_sample_is_zero, "ael_single_sample"),
    ("mel_s", mel_not_strict, "mel_boundary_is_strict"),
    ("mel_s", mel_is_total, "mel_hand_examples"),
    ("mel_s", mel_never_resets, "mel_of_independent_samples"),
    ("mel_s", mel_forgets_last_segment, "mel_segment_at_either_end"),
    ("mel_s", mel_forgets_last_segment, "mel_monotone_in_epsilon"),
    ("mel_s", mel_forgets_last_segment, "mel_is_at_least_ael"),
    ("mel_s", mel_forgets_first_segment, "mel_segment_at_either_end"),
    ("mel_s", mel_wraps_around, "mel_segment_at_either_end"),
    ("mel_s", mel_wraps_around, "mel_matches_brute_force"),
    ("mel_s", mel_median_interval, "mel_irregular_sampling"),
    ("mel_s", mel_one_sample_lasts_zero, "mel_is_zero_exactly_when_plr_is"),
    ("mel_s", mel_span_over_samples, "mel_all_and_none_leaked"),
    ("mel_s", mel_in_samples, "mel_rigid_motion_and_clock"),
    ("mel_s", mel_single_sample_is_zero, "mel_single_sample"),
    ("mel_s", mel_single_sample_is_zero, "mel_is_zero_exactly_when_plr_is"),
    ("mel_s", mel_of_a_clock_from_zero, "mel_rigid_motion_and_clock"),
    ("mel_s", mel_changes_its_input, "mel_matches_brute_force"),
    ("mel_s", mel_returns_nothing, "mel_hand_examples"),
    ("exposure", exposure_across_tracks, "exposure_stops_at_the_end_of_a_track"),
    ("exposure", exposure_across_tracks, "exposure_matches_brute_force"),
    ("exposure", exposure_one_interval_for_all, "exposure_stops_at_the_end_of_a_track"),
    ("exposure", exposure_sorted_by_length, "exposure_order_of_tracks"),
    ("exposure", exposure_drops_single_samples, "exposure_matches_brute_force"),
    ("prediction_grid", grid_starts_one_step_late, "grid_starts_now"),
    ("prediction_grid", grid_from_all_samples, "grid_starts_now"),
    ("prediction_grid", grid_window_in_intervals, "grid_matches_brute_force"),
    ("prediction_grid", grid_divides_by_the_window, "grid_of_a_short_track"),
    ("robot_path", path_overshoots, "path_walks_then_waits"),
    ("robot_path", path_without_its_start, "path_matches_brute_force"),
    ("minimum_separation", separation_of_the_curves, "separation_hand_examples"),
    ("minimum_separation", separation_of_the_first_agent, "separation_symmetries"),
    ("minimum_separation", separation_now, "separation_matches_brute_force"),
    ("is_conflict", conflict_not_strict, "conflict_boundary_is_strict"),
    ("missed_conflict_rate", missed_among_all_scenes, "missed_rate_hand_examples"),
    ("missed_conflict_rate", missed_is_recall, "missed_rate_matches_brute_force"),
    ("missed_conflict_rate", missed_zero_without_conflict, "missed_rate_hand_examples"),
    ("false_alarm_rate", false_alarms_among_alarms, "false_alarm_rate_matches_brute_force"),
    ("false_alarm_rate", false_alarms_zero_without_a_chance, "false_alarm_rate_hand_examples"),
    ("distance_mae_m", mae_signed, "distance_mae_hand_examples"),
    ("distance_mae_m", mae_is_rmse, "distance_mae_matches_brute_force"),
    ("distance_mae_m", mae_zero_without_a_scene, "distance_mae_hand_examples"),
    ("fid_d_sigma", fid_acts_at_the_threshold, "fid_rule_hand_examples"),
    ("fid_d_sigma", fid_clipped_at_zero, "fid_rule_hand_examples"),
    ("fid_d_sigma", fid_without_the_shift, "fid_rule_matches_brute_force"),
    ("fid_d_sigma", fid_inverted, "fid_rule_monotone"),
    ("fid_d_sigma", fid_grows_without_bound, "fid_rule_hand_examples"),
]
