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
    count_steps,
    is_conflict,
    minimum_separation,
    prediction_grid,
    robot_path,
    seconds_grid,
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
    sample_runs,
)

_FEW_REDRAWS = 16  # Places that are drawn at a time.
FEW_PEOPLE = 20  # With fewer people nothing is decided.


@dataclass(frozen=True, eq=False, slots=True)
class Cut(Tracks):
    """N resampled tracks, split now into history and future on the grid."""

    t_future: Floats = field(metadata=TRACK)
    """Times of the grid, (N, H) s; step 0 is the last sample of the history.

    A shorter grid repeats its last instant.
    """
    # (N, H, 2) m, true positions on the grid.
    xy_future: Floats = field(metadata=TRACK)
    too_short: int  # Recorded tracks below `min_duration_s`.
    # Tracks that are long enough but do not cover the horizon after the split.
    no_future: int
    further: "Mapping[float, Cut]" = field(default_factory=dict, kw_only=True)
    """By horizon in s: those of the tracks that cover this longer future."""
    n_replaced: int = field(default=0, kw_only=True)
    """Intervals of these walks where the spline would overshoot and was replaced."""


@dataclass(frozen=True, eq=False, slots=True)
class _CutTrack:
    """History and future of one track."""

    t: Floats  # (K,) s, history.
    xy: Floats  # (K, 2) m
    t_future: Floats  # (H,) s
    xy_future: Floats  # (H, 2) m
    source: str
    group: str
    n_replaced: int  # Intervals of the walk where the spline was replaced.


def cut(recorded: Tracks, *, settings: StageSettings, seed: int) -> Cut:
    """Resample the recorded tracks and split each at `history_ratio` of its samples.

    The future is the continuous walk at the timestamps of the prediction grid, so that
    the label needs no further interpolation. DataError if fewer tracks remain than a
    scene has agents.
    """
    try:
        sampled = resample(recorded, settings=settings.resample, seed=seed)
    except ValueError as error:
        raise DataError(
            f"{error}; {recording_advice(recorded, settings=settings)}"
        ) from None
    recorded_tracks = dict(zip(recorded.source, recorded, strict=True))
    parts: list[_CutTrack] = []
    for track in sampled:
        part = _cut_track(track, recorded_tracks[track.source[0]], settings=settings)
        if part is not None:
            parts.append(part)
    if len(parts) < settings.scenes.agents:
        raise DataError(
            f"{len(parts)} of {len(recorded)} tracks last"
            f" {settings.resample.min_duration_s:g} s and cover the horizon, but a"
            f" scene needs {settings.scenes.agents};"
            f" {recording_advice(recorded, settings=settings)}"
        )
    return Cut(
        t=np.concatenate([part.t for part in parts]),
        xy=np.concatenate([part.xy for part in parts]),
        offsets=np.cumsum([0, *(len(part.t) for part in parts)]),
        t_future=np.stack([part.t_future for part in parts]),
        xy_future=np.stack([part.xy_future for part in parts]),
        source=tuple(part.source for part in parts),
        group=tuple(part.group for part in parts),
        too_short=len(recorded) - len(sampled),
        no_future=len(sampled) - len(parts),
        n_replaced=sum(part.n_replaced for part in parts),
    )


def no_tracks(recorded: Tracks, *, settings: StageSettings) -> Cut:
    """Return a cut of no track: for a run without scenes."""
    lasts_s = recorded.t[recorded.offsets[1:] - 1] - recorded.t[recorded.offsets[:-1]]
    long_enough = int((lasts_s >= settings.resample.min_duration_s).sum())
    return Cut(
        t=np.zeros(0),
        xy=np.zeros((0, 2)),
        offsets=np.zeros(1, dtype=np.int64),
        t_future=np.zeros((0, 1)),
        xy_future=np.zeros((0, 1, 2)),
        source=(),
        group=(),
        too_short=len(recorded) - long_enough,
        no_future=long_enough,
    )


def _cut_track(
    track: Tracks, recorded: Tracks, *, settings: StageSettings
) -> _CutTrack | None:
    """Split a resampled track; None if its recording does not cover the horizon."""
    n_history = history_samples(
        n_samples=track.t.size, ratio=settings.scenes.history_ratio
    )
    if n_history < 2:  # noqa: PLR2004 - the grid needs an interval
        return None
    t = track.t[:n_history]
    (t_future,) = prediction_grid(
        t=t,
        offsets=np.array([0, n_history]),
        window=settings.conflict.window,
        horizon_steps=settings.conflict.horizon_steps,
    )
    if t_future[-1] > recorded.t[-1]:
        return None
    continuous = walk(recorded, max_overshoot_m=settings.resample.max_overshoot_m)
    return _CutTrack(
        t=t,
        xy=track.xy[:n_history],
        t_future=t_future,
        xy_future=continuous(t_future),
        source=track.source[0],
        group=track.group[0],
        n_replaced=continuous.n_monotone + continuous.n_linear,
    )


def with_horizons(tracks: Cut, recorded: Tracks, *, settings: StageSettings) -> Cut:
    """Return the tracks with futures at the further horizons, ``conflict.horizons_s``.

    A horizon that fewer tracks cover than a scene has agents is left out.
    """
    further = {}
    for horizon_s in settings.conflict.horizons_s:
        longer = _at_horizon(tracks, recorded, horizon_s=horizon_s, settings=settings)
        if longer:
            further[horizon_s] = longer
    return replace(tracks, further=further)


def _at_horizon(
    tracks: Cut, recorded: Tracks, *, horizon_s: float, settings: StageSettings
) -> Cut | None:
    """Return the tracks that cover a horizon; None if too few for a scene."""
    recorded_tracks = dict(zip(recorded.source, recorded, strict=True))
    window = settings.conflict.window
    ahead, _ = seconds_grid(
        t=tracks.t, offsets=tracks.offsets, window=window, horizon_s=horizon_s
    )
    sources = [recorded_tracks[name] for name in tracks.source]
    ends_s = np.array([source.t[-1] for source in sources])
    covered = ahead[:, -1] <= ends_s
    rows = np.flatnonzero(covered)
    if rows.size < settings.scenes.agents:
        return None
    overshoot_m = settings.resample.max_overshoot_m
    futures = [
        walk(sources[row], max_overshoot_m=overshoot_m)(ahead[row]) for row in rows
    ]
    if covered.all():  # share the arrays of the histories
        return derived(tracks, t_future=ahead, xy_future=np.stack(futures))
    runs, offsets = sample_runs(tracks.offsets, rows)
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


def recording_advice(
    recorded: Tracks, *, settings: StageSettings, used: int = 0
) -> str:
    """Return advice for a recording with only `used` tracks that are long enough.

    `FEW_PEOPLE` tracks are enough, or at least as many as a scene has agents. A track
    is long enough if its last part, at the slowest sampling rate, covers the horizon.
    """
    durations = np.sort(
        recorded.t[recorded.offsets[1:] - 1] - recorded.t[recorded.offsets[:-1]]
    )
    horizon_s = (settings.conflict.horizon_steps - 1) / settings.resample.rate_min_hz
    least_s = max(horizon_s / (1.0 - settings.scenes.history_ratio), 0.1)
    longest_s = ", ".join(f"{duration:.1f}" for duration in durations[::-1][:4])
    longest = f"the longest last {longest_s} s"
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
    """Return how many of a track's samples are history: the share, rounded down.

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
        # Agents that the scene of the previous pass still lacks.
        open_seats = -(number * n_tracks) % agents
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
    """Build the scenes with numbers from `first` on.

    `order`, (S, A), holds the tracks of the agents of each scene. Every scene draws
    from a random stream of its own.
    """
    n_scenes = len(order)
    elapsed_s = (tracks.t_future - tracks.t_future[:, :1])[order]  # (S, A, H)
    futures = tracks.xy_future[order]  # (S, A, H, 2), unshifted
    radius_m = settings.conflict.safety_radius_m
    rngs = [stream(seed, "scenes", "scene", first + scene) for scene in range(n_scenes)]
    start, destination = _draw_robots(rngs, elapsed_s=elapsed_s, settings=settings)
    robot = robot_path(
        start=start,
        destination=destination,
        speed_mps=settings.conflict.robot_speed_mps,
        elapsed_s=elapsed_s,
    )
    shift = np.empty((*order.shape, 2))
    exhausted = np.zeros(n_scenes, dtype=np.int64)
    # The first agent's grid may repeat its last step, which is drawn once.
    n_steps = count_steps(tracks.t_future)[order[:, 0]].tolist()
    for scene, rng in enumerate(rngs):
        shift[scene], exhausted[scene] = _place_agents(
            robot[scene],
            futures[scene],
            number=first + scene,
            n_steps=n_steps[scene],
            settings=settings,
            rng=rng,
            seed=seed,
        )
    futures = futures + shift[:, :, None, :]
    separation = minimum_separation(robot=robot, agents=futures)
    rows = order.reshape(-1)
    runs, offsets = sample_runs(tracks.offsets, rows)
    sample_shift = np.repeat(shift.reshape(-1, 2), np.diff(offsets), axis=0)
    return Scenes(
        t=end_to_end(tracks.t, runs),
        xy=end_to_end(tracks.xy, runs) + sample_shift,
        offsets=offsets,
        track=rows,
        index=np.arange(first, first + n_scenes),
        t_future=tracks.t_future[rows],
        xy_future=futures.reshape(rows.size, -1, 2),
        robot_start=start,
        robot_destination=destination,
        separation=separation,
        conflict=is_conflict(separation_m=separation, safety_radius_m=radius_m),
        time_to_conflict_s=time_to_conflict_s(
            robot=robot,
            agents=futures,
            elapsed_s=elapsed_s,
            safety_radius_m=radius_m,
        ),
        exhausted=exhausted,
    )


def _draw_robots(
    rngs: list[Generator], *, elapsed_s: Floats, settings: StageSettings
) -> tuple[Floats, Floats]:
    """Draw start and destination of the robot of each scene, (S, 2) m each.

    `elapsed_s` are the times of the grid since now, (S, A, H) s. A destination lies
    beyond the horizon.
    """
    place, speed_mps = settings.scenes, settings.conflict.robot_speed_mps
    start, destination = np.empty((len(rngs), 2)), np.empty((len(rngs), 2))
    for scene, rng in enumerate(rngs):
        aside = rng.uniform(-place.robot_spread_m, place.robot_spread_m, 2)
        start[scene] = np.array([place.robot_x_m, place.robot_y_m]) + aside
        angle = rng.uniform(0.0, 2.0 * np.pi)
        way_m = 2.0 * (speed_mps * float(elapsed_s[scene].max())) + 1.0
        heading = np.array([np.cos(angle), np.sin(angle)])
        destination[scene] = start[scene] + way_m * heading
    return start, destination


def _place_agents(
    robot: Floats,
    futures: Floats,
    *,
    number: int,
    n_steps: int,
    settings: StageSettings,
    rng: Generator,
    seed: int,
) -> tuple[Floats, int]:
    """Return the shifts of a scene's agents, (A, 2) m, and how many lack clearance.

    `robot` and `futures` are (A, H, 2) m; `rng` places the first agent, whose grid has
    `n_steps`. Every other agent has a random stream of its own, so that its redraws do
    not move the next agent.
    """
    shift, n_exhausted = np.empty((len(futures), 2)), 0
    shift[0] = _place_first_agent(
        robot[0],
        futures[0],
        n_steps=n_steps,
        is_conflict_scene=number % 2 == 0,
        settings=settings,
        rng=rng,
    )
    for agent in range(1, len(futures)):
        own_rng = stream(seed, "scenes", "scene", number, "agent", agent)
        shift[agent], is_clear = _around_the_robot(
            robot[agent], futures[agent], settings, own_rng
        )
        n_exhausted += not is_clear
    return shift, n_exhausted


def _place_first_agent(
    robot: Floats,
    future: Floats,
    *,
    n_steps: int,
    is_conflict_scene: bool,
    settings: StageSettings,
    rng: Generator,
) -> Floats:
    """Return the shift of the agent that makes a conflict, or a near miss, (2,) m."""
    if not is_conflict_scene:
        return _past_robot(robot, future, settings, rng)
    # The agent meets the robot at a random step of the future, since step 0 is now. A
    # longer horizon scales the same uniform number.
    step = int(rng.integers(min(1, n_steps - 1), n_steps))
    return np.asarray(robot[step] - future[step])


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
    """Return the shift of a near miss, whose smallest separation is drawn exactly.

    The agent is pushed along a random direction u until its whole relative path q just
    touches the circle of the drawn distance d: s is the largest root over all steps h
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
    """Return the shift of a background agent, and whether its place has clearance."""
    place = settings.scenes
    relative = (future - future[0]) - robot
    draws_left = place.max_redraws
    while True:
        # A few draws nearly always suffice; they are a prefix of all draws.
        draws = rng.random((min(draws_left, _FEW_REDRAWS), 2))
        draws_left -= len(draws)
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
        is_clear = bool(clear.any())
        if is_clear or not draws_left:
            return now[int(clear.argmax()) if is_clear else -1] - future[0], is_clear
