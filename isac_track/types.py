"""Frozen containers of flat arrays and offsets, checked once when they are made.

A ragged batch of N tracks with M samples in all is flat arrays of length M and
`offsets` of length N + 1, as in Arrow: track i owns the samples ``offsets[i]:offsets[i
+ 1]``. Track lengths differ by a factor of 20, so nothing is padded. Arrays are
read-only. Iteration and indexing give views of single tracks without a copy, so that a
plug-in can be a plain loop. ``len(batch)`` is N.

Shapes in the docstrings: N tracks, M samples, S scenes, A agents, H future steps. A
container raises ValueError for an array of a wrong shape, for masked or complex
numbers, for times that do not rise within a track, and for a position that is not
finite.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from isac_track.renamed import renamed

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

__all__ = ["Adding", "Bools", "Complexes", "ErrorLaw", "Floats", "Ints", "Knowledge"]
__all__ += ["Prediction", "Reconstruction", "Release", "Scenes", "Sensed", "Tracks"]
__all__ += ["ESTIMATE_LIMIT_M", "SHARED_LIMIT_M"]

Floats: TypeAlias = NDArray[np.float64]
"""Array of 64-bit floating-point numbers."""
Complexes: TypeAlias = NDArray[np.complex128]
"""Array of complex numbers of 128 bits, points x + iy of the plane."""
Ints: TypeAlias = NDArray[np.int64]
"""Array of 64-bit integers."""
Bools: TypeAlias = NDArray[np.bool_]
"""Array of truth values."""
ErrorLaw: TypeAlias = Literal["radial", "isotropic", "fixed_direction"]
"""Law of a positioning error of standard deviation sigma.

``radial``: the error's length is that of a normal number, abs(N(0, sigma)), in a random
direction. ``isotropic``: N(0, sigma) on each axis. ``fixed_direction``: as ``radial``,
in a single direction per track.
"""
Adding: TypeAlias = Literal["linear", "independent"]
"""How noise joins the raw error, as `isac_track.sharing.perturb` explains."""

SHARED_LIMIT_M: Final = 1e10
"""Limit of a shared coordinate or std, ten times that of recordings, safe to square."""
ESTIMATE_LIMIT_M: Final = 1e12
"""Limit of an estimate, which may lie beyond the shared positions."""
TIME_TOLERANCE_S: Final = 1e-9
"""Tolerance of comparisons of times: 4.4 - 3.1 is a little more than 1.3."""
# Tolerance of a covariance, relative to the larger variance: float32 after many steps.
_ROUNDING: Final = 1e-5


class Knowledge(Enum):
    """Knowledge of a receiver beyond times, positions and pseudonyms.

    Attributes
    ----------
    MECHANISM
        The frozen mechanism object with its parameters (Kerckhoffs).
    SIGMA
        The standard deviation declared with each sample, and the covariance of an
        error with a shape.
    TRAIN
        Releases of other people, with their truth, perturbed by the same mechanism.
    SCENE
        The true frame and clock; without it both are random per release.
    REPEATS
        Further releases of the same walks.
    ANCHOR
        One true position of every walk, with its time: from a door or a camera.
    COMPANIONS
        Releases of companions, with independent errors.
    """

    MECHANISM = "mechanism"
    SIGMA = "sigma"
    TRAIN = "train"
    SCENE = "scene"
    REPEATS = "repeats"
    ANCHOR = "anchor"
    COMPANIONS = "companions"


_SAMPLE: Mapping[str, str] = {"per": "sample"}
# Fields with more than a number for each sample.
_SHAPES: Mapping[str, tuple[int, ...]] = {
    "xy": (2,),
    "unit_error": (2,),
    "cov": (2, 2),
}
# Metadata of a field that holds one value per track.
TRACK: Mapping[str, str] = {"per": "track"}
_Batch = TypeVar("_Batch", "Tracks", "Sensed", "Release")


def _n_tracks(batch: _Batch) -> int:
    return batch.offsets.size - 1


def _view_track(batch: _Batch, index: int) -> _Batch:
    """Return a batch of a single track, with views of its arrays."""
    n_tracks = _n_tracks(batch)
    if not -n_tracks <= index < n_tracks:
        raise IndexError(f"track {index} of {n_tracks}")
    row = index % n_tracks
    lo, hi = int(batch.offsets[row]), int(batch.offsets[row + 1])
    part: dict[str, object] = {"offsets": np.array([0, hi - lo])}
    for item in fields(batch):
        value, per = getattr(batch, item.name), item.metadata.get("per")
        if per is not None and value is not None:
            part[item.name] = value[lo:hi] if per == "sample" else value[row : row + 1]
    return derived(batch, **part)


def _iterate_tracks(batch: _Batch) -> Iterator[_Batch]:
    return (_view_track(batch, index) for index in range(_n_tracks(batch)))


@dataclass(frozen=True, eq=False, slots=True)
class Tracks:
    """The truth: N recorded or interpolated walks, M samples in all.

    Names and groups never reach a predictor or an attack.

    Attributes
    ----------
    t : Floats
        Times, (M,) s, strictly increasing within a track.
    xy : Floats
        True positions, (M, 2) m.
    offsets : Ints
        First sample of each track, then M: (N + 1,).
    source : tuple of str
        Id of the recorded track, (N,), unique.
    group : tuple of str
        Cluster of the intervals, (N,): people who walk together share a group.
    person : tuple of str or None
        Identity, (N,); None for several sessions without lasting ids.
    session : tuple of str or None
        Session, (N,), if there are several.

    Raises
    ------
    ValueError
        Also if two tracks have one source id.
    """

    t: Floats = field(metadata=_SAMPLE)
    xy: Floats = field(metadata=_SAMPLE)
    offsets: Ints
    source: tuple[str, ...] = field(metadata=TRACK)
    group: tuple[str, ...] = field(metadata=TRACK)
    person: tuple[str, ...] | None = field(default=None, kw_only=True, metadata=TRACK)
    session: tuple[str, ...] | None = field(default=None, kw_only=True, metadata=TRACK)

    def __post_init__(self) -> None:
        _check_batch(self)
        if len(set(self.source)) != len(self.source):
            raise ValueError("source ids must be unique")

    def __repr__(self) -> str:
        """Return the number of tracks and samples, in a line."""
        return f"<Tracks: {len(self):,} tracks, {self.t.size:,} samples>"

    __len__, __getitem__, __iter__ = _n_tracks, _view_track, _iterate_tracks


@dataclass(frozen=True, eq=False, slots=True)
class Scenes:
    """S scenes of one robot and A agents; agent a of scene s is track ``s * A + a``.

    Times are those of each agent's own recording; step h of the prediction grid is
    ``t_future[:, h]``, with h = 0 at the last history sample (eq. future_time_grid).
    ``len(scenes)`` is S.

    Attributes
    ----------
    t : Floats
        History times of the S * A agents, (M,) s.
    xy : Floats
        True history after the shift into the scene, (M, 2) m.
    offsets : Ints
        First sample of each agent, then M: (S * A + 1,).
    track : Ints
        Row of the source track in the `Tracks` that the scenes were made of, (S * A,).
    index : Ints
        Number of the scene in the run, (S,): the key of its random streams.
    t_future : Floats
        Prediction grid, (S * A, H) s.
    xy_future : Floats
        True positions on the grid, (S * A, H, 2) m.
    robot_start : Floats
        Position of the robot at step 0, (S, 2) m.
    robot_destination : Floats
        End of its straight path, (S, 2) m.
    separation : Floats
        True minimum separation of robot and agents over the horizon, (S,) m.
    conflict : Bools
        True label c, (S,): eq. conflict_rule on the true future.
    exhausted : Ints
        Agents whose placement ran out of redraws and took the last draw, (S,).
    time_to_conflict_s : Floats
        Time until an agent is inside, (S,) s; 0: now; NaN: no conflict, or unknown.

    Raises
    ------
    ValueError
        Also if the agents do not fill the scenes evenly.
    """

    t: Floats
    xy: Floats
    offsets: Ints
    track: Ints
    index: Ints
    t_future: Floats
    xy_future: Floats
    robot_start: Floats
    robot_destination: Floats
    separation: Floats
    conflict: Bools
    exhausted: Ints
    time_to_conflict_s: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if np.size(self.time_to_conflict_s) == 0:
            unknown = np.full(np.size(self.index), np.nan)
            object.__setattr__(self, "time_to_conflict_s", unknown)
        _freeze(self, t="M", xy=("M", 2), t_future="NH", xy_future=("N", "H", 2))
        _freeze(self, robot_start=("S", 2), robot_destination=("S", 2), separation="S")
        _freeze(self, time_to_conflict_s="S")
        _freeze(self, np.int64, offsets="N", track="N", index="S", exhausted="S")
        _freeze(self, np.bool_, conflict="S")
        check_offsets(self.offsets, self.t.size)
        check_times(self.t, self.offsets)
        n_tracks = self.offsets.size - 1
        if self.index.size == 0 or n_tracks % self.index.size:
            raise ValueError(
                f"{n_tracks} agents do not fill {self.index.size} scenes evenly"
            )

    def __len__(self) -> int:
        return self.index.size

    @property
    def n_agents(self) -> int:
        """Agents per scene."""
        return (self.offsets.size - 1) // self.index.size

    @property
    def inside_now(self) -> Bools:
        """Whether an agent is inside the safety radius at step 0 already, (S,)."""
        return np.asarray(self.time_to_conflict_s == 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Sensed:
    """Data of the sensing network about N tracks, the input of a mechanism; no ids.

    A mechanism is trusted: the truth is ``xy - sigma_raw[:, None] * unit_error``.

    Attributes
    ----------
    t : Floats
        Times, (M,) s, strictly increasing within a track.
    xy : Floats
        Raw estimates, (M, 2) m.
    unit_error : Floats
        Raw errors in units of `sigma_raw`, (M, 2), with the shape of `cov`.
    sigma_raw : Floats
        Standard deviation of the raw error under `law`, (M,) m; of an error with a
        shape that of a round error with the same mean square.
    information : Floats
        Fisher information (eq. swarm_fi), mean of both axes, (M,) 1/m^2.
    fid : Floats
        Fisher information density (eq. swarm_fid), (M,) 1/(m^2 s).
    offsets : Ints
        First sample of each track, then M: (N + 1,).
    law : ErrorLaw
        Law of the raw error.
    walk : Ints
        Opaque numbers, (N,), equal for releases of one walk in one session. By default
        all differ.
    cov : Floats or None
        Covariance of the raw error, (M, 2, 2) m^2; None: the same variance on both
        axes.

    Raises
    ------
    ValueError
        Also if a standard deviation is negative or NaN, or a matrix is no covariance.
    """

    t: Floats = field(metadata=_SAMPLE)
    xy: Floats = field(metadata=_SAMPLE)
    unit_error: Floats = field(metadata=_SAMPLE)
    sigma_raw: Floats = field(metadata=_SAMPLE)
    information: Floats = field(metadata=_SAMPLE)
    fid: Floats = field(metadata=_SAMPLE)
    offsets: Ints
    law: ErrorLaw = "radial"
    walk: Ints = field(
        default_factory=lambda: np.empty(0, dtype=np.int64), metadata=TRACK
    )
    cov: Floats | None = field(default=None, kw_only=True, metadata=_SAMPLE)

    def __post_init__(self) -> None:
        if np.size(self.walk) == 0:
            object.__setattr__(self, "walk", np.arange(np.size(self.offsets) - 1))
        _freeze(self, np.int64, walk="N")
        _check_batch(self)
        if not (self.sigma_raw >= 0).all():
            raise ValueError("sigma_raw must not be negative or NaN")

    __len__, __getitem__, __iter__ = _n_tracks, _view_track, _iterate_tracks


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class Release:
    """All that a robot or an adversary ever receives. N tracks, M samples in all.

    Attributes
    ----------
    t : Floats
        Times, (M,) s, strictly increasing within a track.
    xy : Floats
        Shared positions, (M, 2) m.
    sigma : Floats or None
        Declared standard deviations, (M,) m; None without `Knowledge.SIGMA`. Of an
        error with a shape: that of a round error with the same mean square.
    offsets : Ints
        First sample of each track, then M: (N + 1,).
    pseudonym : tuple of str
        Opaque names, (N,), fresh for every release.
    cov : Floats or None
        Declared covariances, (M, 2, 2) m^2, of errors with a shape; None: the same
        variance on both axes, and always without `Knowledge.SIGMA`.

    Examples
    --------
    Two tracks, of three and of two samples:

    >>> import numpy as np
    >>> from isac_track.types import Release
    >>> release = Release(
    ...     t=np.array([0.0, 0.4, 0.8, 0.0, 0.4]),
    ...     xy=np.array([[0, 0], [1, 0], [2, 0], [5, 5], [5, 6]]),
    ...     sigma=None,
    ...     offsets=np.array([0, 3, 5]),
    ...     pseudonym=("a", "b"),
    ... )
    >>> len(release)
    2
    >>> [track.t.size for track in release]
    [3, 2]
    >>> release[1].xy
    array([[5., 5.],
           [5., 6.]])
    """

    t: Floats = field(metadata=_SAMPLE)
    xy: Floats = field(metadata=_SAMPLE)
    sigma: Floats | None = field(metadata=_SAMPLE)
    offsets: Ints
    pseudonym: tuple[str, ...] = field(metadata=TRACK)
    cov: Floats | None = field(default=None, kw_only=True, metadata=_SAMPLE)

    def __post_init__(self) -> None:
        _check_batch(self)

    __len__, __getitem__, __iter__ = _n_tracks, _view_track, _iterate_tracks

    def tracks(self, rows: Ints | Sequence[int]) -> Release:
        """Return some of the tracks, in the order of `rows`, (K,) numbers from 0.

        IndexError for a row that does not exist.
        """
        rows = np.asarray(rows, dtype=np.int64)
        names = self.pseudonym
        runs, offsets = sample_runs(self.offsets, rows)
        return derived(
            self,
            t=end_to_end(self.t, runs),
            xy=end_to_end(self.xy, runs),
            sigma=None if self.sigma is None else end_to_end(self.sigma, runs),
            cov=None if self.cov is None else end_to_end(self.cov, runs),
            offsets=offsets,
            pseudonym=tuple([names[row] for row in rows.tolist()]),
        )

    def samples(self, rows: Ints | Bools, *, offsets: Ints) -> Release:
        """Return some of the samples, in the order of `rows`, under the same names.

        `rows` are numbers, (K,), or truth values, (M,); `offsets` are those of the
        samples' tracks, (N + 1,).
        """
        return Release(
            t=self.t[rows],
            xy=self.xy[rows],
            sigma=None if self.sigma is None else self.sigma[rows],
            cov=None if self.cov is None else self.cov[rows],
            offsets=offsets,
            pseudonym=self.pseudonym,
        )

    def without_sigma(self) -> Release:
        """Return the same release as a receiver without `Knowledge.SIGMA` gets it."""
        return derived(self, sigma=None, cov=None)


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """Predicted positions of N tracks on a grid of H future times.

    Attributes
    ----------
    mean : Floats
        Positions, (N, H, 2) m, at most `ESTIMATE_LIMIT_M` from the origin on each axis.
    cov : Floats or None
        Covariances, (N, H, 2, 2) m^2, symmetric and positive semidefinite.

    Raises
    ------
    ValueError
        If a shape is wrong, a position is not finite or beyond the limit, or a matrix
        is no covariance.
    """

    mean: Floats
    cov: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, mean=("N", "H", 2))
        _check_estimate(self.mean, noun="a predicted position")
        if self.cov is not None:
            _freeze(self, cov=(*self.mean.shape, 2))
            _check_covariances(self.cov, noun="a predicted covariance")


@dataclass(frozen=True, eq=False, slots=True)
class Reconstruction:
    """An adversary's estimate of the true positions of a release, for each sample.

    Attributes
    ----------
    xy : Floats
        Positions, (M, 2) m, in the frame of the release, at most `ESTIMATE_LIMIT_M`
        from the origin on each axis.
    std : Floats or None
        Standard deviation on each axis that the attack claims, (M,) m.

    Raises
    ------
    ValueError
        If a shape is wrong, a number is not finite or beyond the limit, or a standard
        deviation is negative.
    """

    xy: Floats
    std: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, xy=("M", 2))
        _check_estimate(self.xy, noun="a reconstructed position")
        if self.std is not None:
            _freeze(self, std=self.xy.shape[:1])
            if not within(self.std, 0.0, ESTIMATE_LIMIT_M):
                limit = f"at most {ESTIMATE_LIMIT_M:g} m"
                raise ValueError(f"std must be finite and not negative, and {limit}")


_Container = TypeVar("_Container", bound="DataclassInstance")


def derived(container: _Container, **changes: object) -> _Container:
    """Return a copy with changed fields, without checking them.

    As `dataclasses.replace`, but without the checks: the caller makes the changes from
    checked values.
    """
    new: _Container = object.__new__(type(container))
    for item in fields(container):
        value = changes.get(item.name, getattr(container, item.name))
        value = read_only(value) if isinstance(value, np.ndarray) else value
        object.__setattr__(new, item.name, value)
    return new


def _check_batch(batch: _Batch) -> None:
    """Freeze the arrays of a ragged batch; check shapes, times and finiteness."""
    _freeze(batch, np.int64, offsets="N")
    _freeze(batch, t="M")
    check_offsets(batch.offsets, batch.t.size)
    n_samples, n_tracks = batch.t.size, _n_tracks(batch)
    for item in fields(batch):
        value, per = getattr(batch, item.name), item.metadata.get("per")
        if per == "sample" and value is not None:
            _freeze(batch, **{item.name: _sample_shape(item.name, n_samples)})
        elif per == "track" and value is not None and len(value) != n_tracks:
            raise ValueError(
                f"{item.name} must name {n_tracks} tracks, got {len(value)}"
            )
    check_times(batch.t, batch.offsets)
    largest = float(np.finfo(np.float64).max)
    if not within(batch.xy, -largest, largest):
        raise ValueError("a position is not finite")
    cov = getattr(batch, "cov", None)
    if cov is not None:
        _check_covariances(cov, noun="a covariance")


def _sample_shape(name: str, n_samples: int) -> tuple[int, ...]:
    """Return the shape of a field with an entry for each of M samples."""
    return (n_samples, *_SHAPES.get(name, ()))


def within(values: Floats, low: float, high: float) -> bool:
    """Return whether all values lie within both bounds; NaN does not."""
    # Minimum and maximum need no memory; comparing all values would.
    return values.size == 0 or bool(values.min() >= low and values.max() <= high)


def _check_estimate(xy: Floats, *, noun: str) -> None:
    # The sum of squares takes one pass: if it is within the limit, so are all values.
    is_small = np.vdot(xy, xy) <= ESTIMATE_LIMIT_M**2
    if not is_small and not within(xy, -ESTIMATE_LIMIT_M, ESTIMATE_LIMIT_M):
        is_far = np.isfinite(xy).all()
        fault = f"lies beyond {ESTIMATE_LIMIT_M:g} m" if is_far else "is not finite"
        raise ValueError(f"{noun} {fault}")


def _check_covariances(cov: Floats, *, noun: str) -> None:
    """Check that matrices (..., 2, 2) are covariances within rounding."""
    limit_m2 = ESTIMATE_LIMIT_M**2
    if not within(cov, -limit_m2, limit_m2):
        raise ValueError(f"{noun} is not finite or beyond {limit_m2:g} m^2")
    xx, xy, yx, yy = cov[..., 0, 0], cov[..., 0, 1], cov[..., 1, 0], cov[..., 1, 1]
    largest = np.maximum(np.abs(xx), np.abs(yy))
    if not (np.abs(xy - yx) <= _ROUNDING * largest).all():
        raise ValueError(f"{noun} is not symmetric")
    # No eigenvalue of a symmetric 2 x 2 matrix is negative if neither diagonal nor
    # determinant is.
    is_sound = np.minimum(xx, yy) >= -_ROUNDING * largest
    is_sound &= xx * yy - xy * yx >= -_ROUNDING * largest**2
    if not is_sound.all():
        raise ValueError(f"{noun} is not positive semidefinite")


def _freeze(
    container: object,
    kind: type[np.generic] = np.float64,
    /,
    **shapes: Sequence[int | str],
) -> None:
    """Turn fields into read-only arrays of a kind of numbers and check their shapes.

    A letter in a shape stands for any length.
    """
    for name, shape in shapes.items():
        given = getattr(container, name)
        if np.ma.isMaskedArray(given) or np.iscomplexobj(given):
            wrong = "complex" if np.iscomplexobj(given) else "masked"
            raise ValueError(
                f"{name} must hold real numbers, all of them, got a {wrong} array"
            )
        array = np.asarray(given)
        if array.ndim != len(shape):
            raise ValueError(
                f"{name} must have {len(shape)} dimension(s), got shape {array.shape}"
            )
        for want, got in zip(shape, array.shape, strict=True):
            if want != got and not isinstance(want, str):
                wanted = str(tuple(shape)).replace("'", "")
                raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
        if kind is np.int64 and array.dtype.kind not in "iu":
            raise ValueError(f"{name} must hold integers, got {array.dtype}")
        object.__setattr__(container, name, read_only(array.astype(kind, copy=False)))


_Scalar = TypeVar("_Scalar", bound=np.generic)


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return the array itself if it is read-only, else a read-only view."""
    if array.flags.writeable:
        # A copy of every release would double the memory of a block.
        array = array.view()
        array.flags.writeable = False
    return array


# Stretches of samples: the first, and the first after the end.
Runs: TypeAlias = list[tuple[int, int]]


def stretches(first: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Return the sample numbers of stretches, end to end, and the stretches' offsets.

    Stretch i has ``sizes[i]`` samples from ``first[i]`` on.
    """
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return np.repeat(first - offsets[:-1], sizes) + np.arange(offsets[-1]), offsets


def sample_runs(offsets: Ints, rows: Ints) -> tuple[Runs, Ints]:
    """Return the stretches of samples of some tracks, and the offsets of their copies.

    Adjacent tracks form one stretch. IndexError for a row that does not exist.
    """
    if rows.size and rows.min() < 0:
        raise IndexError(f"track {rows.min()} of {offsets.size - 1}")
    sizes = np.diff(offsets)[rows]
    ends = np.flatnonzero(np.diff(rows, append=-2) != 1)
    starts = np.append(0, ends[:-1] + 1)[: ends.size]
    firsts, after = offsets[rows[starts]].tolist(), offsets[rows[ends] + 1].tolist()
    runs = list(zip(firsts, after, strict=True))
    return runs, np.concatenate([[0], np.cumsum(sizes)])


def end_to_end(values: NDArray[_Scalar], runs: Runs) -> NDArray[_Scalar]:
    """Return stretches of samples one after the other; a view of a single stretch."""
    # Copying slices takes a fraction of the time of indexing every sample.
    parts = [values[first:end] for first, end in runs]
    return parts[0] if len(parts) == 1 else np.concatenate(parts or [values[:0]])


def lengths(vectors: Floats) -> Floats:
    """Return the lengths (...,) of vectors of the plane, (..., 2), without overflow."""
    return np.asarray(np.hypot(vectors[..., 0], vectors[..., 1]))


def squared_lengths(vectors: Floats) -> Floats:
    """Return the squared lengths (...,) of vectors of the plane, (..., 2).

    Their root takes a tenth of the time of np.hypot, whose guard against overflow is
    not needed here.
    """
    x, y = vectors[..., 0], vectors[..., 1]
    square: Floats = x * x
    square += y * y
    return square


def positive(name: str, value: float, *, finite: bool = True) -> float:
    """Return a positive number; ValueError for others, or infinity if `finite`."""
    if not value > 0 or (finite and not np.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)


def check_at_least(name: str, value: float, least: float, unit: str = "") -> None:
    """Raise ValueError if a parameter is below `least` or not finite.

    `name` and `unit`, such as ``" m"``, are for the message.
    """
    if not (np.isfinite(value) and value >= least):
        raise ValueError(f"{name} must be {least}{unit} or more, got {value}")


def check_offsets(offsets: Ints, n_samples: int) -> None:
    """Raise ValueError unless offsets cut the samples into tracks, none empty."""
    if offsets.size == 0 or offsets[0] != 0 or offsets[-1] != n_samples:
        raise ValueError(f"offsets must run from 0 to {n_samples}")
    if (np.diff(offsets) < 1).any():
        raise ValueError("every track needs at least one sample: offsets must increase")


def check_times(t: Floats, offsets: Ints) -> None:
    """Raise ValueError unless times are finite and rise within each track."""
    rising = t[1:] > t[:-1]  # False for NaN
    rising[offsets[1:-1] - 1] = True  # from one track to the next
    # Between two finite numbers all rising times are finite.
    ends = t[offsets[:-1]], t[offsets[1:] - 1]
    if not (rising.all() and np.isfinite(ends).all()):
        raise ValueError("times must be finite and strictly increasing within a track")


if not TYPE_CHECKING:  # type checkers are to know the names that are
    __getattr__ = renamed(__name__, {"runs_of": "sample_runs"})
