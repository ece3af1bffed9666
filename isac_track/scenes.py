"""Monte Carlo scenes: choose tracks, split them 70/30, place robot and agents, label.

Conflict and conflict-free scenes alternate (even and odd index). A track is only
shifted.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator

from isac_track.config import ConflictSettings, StageSettings
from isac_track.conflict import (
    is_conflict,
    minimum_separation,
    prediction_grid,
    robot_path,
    seconds_grid,
    steps_of,
    time_to_conflict_s,
)
from isac_track.errors import DataError
from isac_track.resample import resample, walk
from isac_track.rng import stream
from isac_track.types import (
    TRACK,
    Floats,
    Ints,
    Scenes,
    Tracks,
    derived,
    end_to_end,
    runs_of,
)

_FEW_REDRAWS = 16
FEW_PEOPLE = 20  # With fewer nothing is decided.


@dataclass(frozen=True, eq=False, slots=True)
class Cut(Tracks):
    """N resampled tracks up to now, which is known history, and their future on the grid."""

    t_future: Floats = field(metadata=TRACK)
    """(N, H) s; step 0 is the last history sample, a shorter grid repeats its last instant."""
    xy_future: Floats = field(
        metadata=TRACK
    )  # (N, H, 2) m, true positions on the grid.
    too_short: int  # Recorded tracks below `min_duration_s`.
    # Tracks that are long enough but do not cover the horizon after the split.
    no_future: int
    further: "Mapping[float, Cut]" = field(default_factory=dict, kw_only=True)
    """By horizon, s: the same tracks with a longer future, those that cover it."""
    n_replaced: int = field(default=0, kw_only=True)
    """Pieces of the walks of these tracks that are no spline, lest it overshoots."""


def cut(recorded: Tracks, *, settings: StageSettings, seed: int) -> Cut:
    """Resample the recorded tracks and split each at `history_ratio` of its samples.

    The future is that of the continuous walk at the very timestamps of the prediction
    grid: the label has no interpolation of its own. DataError if fewer tracks remain
    than a scene has agents.
    """
    try:
        sampled = resample(recorded, settings=settings.resample, seed=seed)
    except ValueError as error:
        raise DataError(
            f"{error}; {what_would_help(recorded, settings=settings)}"
        ) from None
    whole_of = dict(zip(recorded.source, recorded, strict=True))
    conflict, n_replaced = settings.conflict, 0
    parts: list[tuple[Floats, Floats, Floats, Floats, str, str]] = []
    for track in sampled:
        n_history = history_samples(
            n_samples=track.t.size, ratio=settings.scenes.history_ratio
        )
        if n_history < 2:  # noqa: PLR2004 - the grid needs an interval
            continue
        t, xy, alone = (
            track.t[:n_history],
            track.xy[:n_history],
            np.array([0, n_history]),
        )
        (t_future,) = prediction_grid(
            t=t,
            offsets=alone,
            window=conflict.window,
            horizon_steps=conflict.horizon_steps,
        )
        whole = whole_of[track.source[0]]
        if t_future[-1] <= whole.t[-1]:
            names = track.source[0], track.group[0]
            continuous = walk(whole, max_overshoot_m=settings.resample.max_overshoot_m)
            n_replaced += continuous.n_monotone + continuous.n_linear
            parts.append((t, xy, t_future, continuous(t_future), *names))
    if len(parts) < settings.scenes.agents:
        raise DataError(
            f"{len(parts)} of {len(recorded)} tracks last"
            f" {settings.resample.min_duration_s:g} s and cover the horizon, but a"
            f" scene needs {settings.scenes.agents};"
            f" {what_would_help(recorded, settings=settings)}"
        )
    ts, xys, t_futures, xy_futures, source, group = zip(*parts, strict=True)
    return Cut(
        t=np.concatenate(ts),
        xy=np.concatenate(xys),
        offsets=np.cumsum([0, *map(len, ts)]),
        t_future=np.stack(t_futures),
        xy_future=np.stack(xy_futures),
        source=source,
        group=group,
        too_short=len(recorded) - len(sampled),
        no_future=len(sampled) - len(parts),
        n_replaced=n_replaced,
    )


def with_horizons(tracks: Cut, recorded: Tracks, *, settings: StageSettings) -> Cut:
    """Return the tracks with their futures at the further horizons, ``conflict.horizons_s``.

    A horizon that fewer tracks cover than a scene has agents is left out.
    """
    further = {
        horizon_s: longer
        for horizon_s in settings.conflict.horizons_s
        if (
            longer := _at_horizon(
                tracks, recorded, horizon_s=horizon_s, settings=settings
            )
        )
    }
    return replace(tracks, further=further)


def _at_horizon(
    tracks: Cut, recorded: Tracks, *, horizon_s: float, settings: StageSettings
) -> Cut | None:
    """Return the tracks whose recording covers a horizon; None if they do not fill a scene."""
    whole_of = dict(zip(recorded.source, recorded, strict=True))
    window = settings.conflict.window
    ahead, _ = seconds_grid(
        t=tracks.t, offsets=tracks.offsets, window=window, horizon_s=horizon_s
    )
    wholes = [whole_of[name] for name in tracks.source]
    ends_s = np.array([whole.t[-1] for whole in wholes])
    covered = ahead[:, -1] <= ends_s
    rows = np.flatnonzero(covered)
    if rows.size < settings.scenes.agents:
        return None
    overshoot_m = settings.resample.max_overshoot_m
    futures = [
        walk(wholes[row], max_overshoot_m=overshoot_m)(ahead[row]) for row in rows
    ]
    if covered.all():  # the histories are the very same arrays
        return derived(tracks, t_future=ahead, xy_future=np.stack(futures))
    runs, offsets = runs_of(tracks.offsets, rows)
    return Cut(
        t=end_to_end(tracks.t, runs),
        xy=end_to_end(tracks.xy, runs),
        offsets=offsets,
        t_future=ahead[rows],
        xy_future=np.stack(futures),
        source=tuple(tracks.source[row] for row in rows),
        group=tuple(tracks.group[row] for row in rows),
        too_short=tracks.too_short,
        no_future=tracks.no_future + int((~covered).sum()),
    )


def what_would_help(recorded: Tracks, *, settings: StageSettings, used: int = 0) -> str:
    """Return how a recording could be used of which so few tracks, `used`, are long enough.

    Enough are `FEW_PEOPLE` tracks, or else as many as a scene has agents. None may be
    so short that its last part, at the slowest rate of sampling, does not cover the
    horizon.
    """
    durations = np.sort(
        recorded.t[recorded.offsets[1:] - 1] - recorded.t[recorded.offsets[:-1]]
    )
    horizon_s = (settings.conflict.horizon_steps - 1) / settings.resample.rate_min_hz
    least_s = max(horizon_s / (1.0 - settings.scenes.history_ratio), 0.1)
    longest = (
        f"the longest last {', '.join(f'{one:.1f}' for one in durations[::-1][:4])} s"
    )
    wanted = [
        people for people in (FEW_PEOPLE, settings.scenes.agents) if people > used
    ]
    for people in wanted:
        if len(durations) >= people and durations[-people] >= least_s:
            value = np.floor(10.0 * durations[-people]) / 10.0
            return (
                f"{longest}; --set resample.min_duration_s={value:g} takes {people} or"
                " more"
            )
    which = "longer" if len(durations) >= wanted[-1] else "more people"
    return (
        f"{longest}; record {which}: {wanted[-1]} tracks of"
        f" {settings.resample.min_duration_s:g} s are needed, or of {least_s:.1f} s"
        f" with --set resample.min_duration_s={least_s:.1f}"
    )


def history_samples(*, n_samples: int, ratio: float) -> int:
    """Return how many of a track's samples are history: the whole part of the share.

    0.7 of 330 is 231, although 0.7 * 330 is a hair less in floating point.
    """
    return int(ratio * n_samples + 1e-9)


def track_order(*, n_tracks: int, n_scenes: int, agents: int, seed: int) -> Ints:
    """Return which track plays which agent, (S, A): cyclic, reshuffled at every pass.

    A fixed cycle would let only every n-th track ever be the first agent. Where two
    passes meet inside a scene no track is in it twice; ValueError if there are fewer
    tracks than agents.
    """
    if n_tracks < agents:
        raise ValueError(f"{n_tracks} tracks cannot fill scenes of {agents} agents")
    needed = n_scenes * agents
    passes: list[Ints] = []
    for number in range(-(-needed // n_tracks)):
        order = stream(seed, "scenes", "pass", number).permutation(n_tracks)
        open_seats = (
            -(number * n_tracks) % agents
        )  # agents of the scene that the pass begins in
        if open_seats:
            seated = passes[-1][-(agents - open_seats) :]
            clash = np.isin(order, seated)
            # A stable move of the seated tracks to the end keeps the rest of the
            # shuffle.
            order = np.concatenate([order[~clash], order[clash]])
        passes.append(order)
    return np.concatenate(passes)[:needed].reshape(n_scenes, agents)


def make_scenes(
    tracks: Cut, *, order: Ints, first: int, settings: StageSettings, seed: int
) -> Scenes:
    """Build the scenes from `first` on, each from its own stream and row of `order`, (S, A) int."""
    n_scenes, n_agents = order.shape
    elapsed_s = (tracks.t_future - tracks.t_future[:, :1])[order]  # (S, A, H)
    futures = tracks.xy_future[order]  # (S, A, H, 2), unshifted
    rules, place = settings.conflict, settings.scenes
    n_steps = steps_of(tracks.t_future)[
        order[:, 0]
    ].tolist()  # of each first agent's own grid
    rngs = [stream(seed, "scenes", "scene", first + scene) for scene in range(n_scenes)]
    start, destination = np.empty((n_scenes, 2)), np.empty((n_scenes, 2))
    for scene, rng in enumerate(rngs):
        aside = rng.uniform(-place.robot_spread_m, place.robot_spread_m, 2)
        start[scene] = np.array([place.robot_x_m, place.robot_y_m]) + aside
        angle = rng.uniform(0.0, 2.0 * np.pi)
        # Beyond the horizon.
        way_m = 2.0 * (rules.robot_speed_mps * float(elapsed_s[scene].max())) + 1.0
        destination[scene] = start[scene] + way_m * np.array(
            [np.cos(angle), np.sin(angle)]
        )
    robot = robot_path(
        start=start,
        destination=destination,
        speed_mps=rules.robot_speed_mps,
        elapsed_s=elapsed_s,
    )
    shift, exhausted = (
        np.empty((n_scenes, n_agents, 2)),
        np.zeros(n_scenes, dtype=np.int64),
    )
    for scene, rng in enumerate(rngs):
        if (first + scene) % 2 == 0:  # on the robot's point at a random step
            # Of the future: step 0 is now. A longer horizon scales the same uniform
            # number.
            step = int(rng.integers(min(1, n_steps[scene] - 1), n_steps[scene]))
            shift[scene, 0] = robot[scene, 0, step] - futures[scene, 0, step]
        else:
            shift[scene, 0] = _past_robot(
                robot[scene, 0], futures[scene, 0], settings, rng
            )
        for agent in range(1, n_agents):
            # A stream of its own: how often one is redrawn must not move the next one.
            own = stream(seed, "scenes", "scene", first + scene, "agent", agent)
            shift[scene, agent], found = _around_the_robot(
                robot[scene, agent], futures[scene, agent], settings, own
            )
            exhausted[scene] += not found
    futures = futures + shift[:, :, None, :]
    separation = minimum_separation(robot=robot, agents=futures)
    rows = order.reshape(-1)
    runs, offsets = runs_of(tracks.offsets, rows)
    xy = end_to_end(tracks.xy, runs) + np.repeat(
        shift.reshape(-1, 2), np.diff(offsets), axis=0
    )
    return Scenes(
        t=end_to_end(tracks.t, runs),
        xy=xy,
        offsets=offsets,
        track=rows,
        index=np.arange(first, first + n_scenes),
        t_future=tracks.t_future[rows],
        xy_future=futures.reshape(rows.size, -1, 2),
        robot_start=start,
        robot_destination=destination,
        separation=separation,
        conflict=is_conflict(
            separation_m=separation, safety_radius_m=rules.safety_radius_m
        ),
        time_to_conflict_s=time_to_conflict_s(
            robot=robot,
            agents=futures,
            elapsed_s=elapsed_s,
            safety_radius_m=rules.safety_radius_m,
        ),
        exhausted=exhausted,
    )


def robot_positions(scenes: Scenes, *, settings: ConflictSettings) -> Floats:
    """Return the robot's nominal positions on each agent's grid, (S, A, H, 2) m."""
    elapsed_s = scenes.t_future - scenes.t_future[:, :1]
    return robot_path(
        start=scenes.robot_start,
        destination=scenes.robot_destination,
        speed_mps=settings.robot_speed_mps,
        elapsed_s=elapsed_s.reshape(len(scenes), scenes.n_agents, -1),
    )


def _past_robot(
    robot: Floats, future: Floats, settings: StageSettings, rng: Generator
) -> Floats:
    """Return the shift of a near miss: the smallest separation is a drawn distance, exactly.

    The agent is pushed along a random direction u until its relative path q, as a
    whole, just touches the circle of that distance d: the largest root over all steps
    of |q_h + s u| = d.
    """
    distance_m = rng.uniform(
        settings.conflict.safety_radius_m, settings.scenes.near_miss_max_m
    )
    angle = rng.uniform(0.0, 2.0 * np.pi)
    u = np.array([np.cos(angle), np.sin(angle)])
    q = future - robot
    q = q - q[0]  # so that step 0 always touches the line of motion
    along = q @ u
    discriminant = distance_m**2 - (q**2).sum(axis=1) + along**2
    roots = np.sqrt(np.maximum(discriminant, 0.0)) - along
    push = roots[discriminant >= 0.0].max()
    # A hair beyond the circle: rounding must not turn the miss into a conflict.
    return np.asarray((robot[0] - future[0]) + (push + 1e-9) * u)


def _around_the_robot(
    robot: Floats, future: Floats, settings: StageSettings, rng: Generator
) -> tuple[Floats, bool]:
    """Return the shift of a background agent, and whether a place with clearance was found."""
    place = settings.scenes
    relative = (future - future[0]) - robot
    left = place.max_redraws
    while True:
        # The first few nearly always do: a share of the draws is a prefix of all.
        draws = rng.random((min(left, _FEW_REDRAWS), 2))
        left -= len(draws)
        radius_m = np.sqrt(
            place.ring_min_m**2
            + draws[:, 0] * (place.ring_max_m**2 - place.ring_min_m**2)
        )
        angle = 2.0 * np.pi * draws[:, 1]
        now = robot[0] + radius_m[:, None] * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        gap = now[:, None, :] + relative
        clear = (gap * gap).sum(axis=2).min(axis=1) >= place.clearance_m**2
        found = bool(clear.any())
        if found or not left:
            return now[int(clear.argmax()) if found else -1] - future[0], found
