"""Frozen containers: flat arrays and offsets, checked once at the door.

A ragged batch of N tracks with M samples in all is flat arrays of length M and
`offsets` of length N + 1, as in Arrow: track i owns the samples ``offsets[i]:offsets[i
+ 1]``. Tracks differ in length by 20x, so nothing is padded. Arrays are read-only;
``len``, iteration and indexing give zero-copy views of one track, so that a plug-in can
be a plain loop.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Floats: TypeAlias = NDArray[np.float64]
Complexes: TypeAlias = NDArray[np.complex128]
Ints: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
ErrorLaw: TypeAlias = Literal["radial", "isotropic", "fixed_direction"]
Adding: TypeAlias = Literal["linear", "independent"]

SHARED_LIMIT_M: Final = 1e10
"""Of a coordinate or std that is shared: ten times what is recorded, and no power overflows."""
# Of what is estimated from it: an extrapolation goes beyond it.
ESTIMATE_LIMIT_M: Final = 1e12
# Of a covariance over the larger variance: float32 after many steps.
_ROUNDING: Final = 1e-5


class Knowledge(Enum):
    """What a receiver of a release may be granted beyond times, positions and pseudonyms."""

    MECHANISM = (  # The frozen mechanism object with its parameters (Kerckhoffs).
        "mechanism"
    )
    SIGMA = "sigma"  # The standard deviation declared with each sample.
    # Releases of other people, with their truth, perturbed by the same mechanism.
    TRAIN = "train"
    SCENE = "scene"  # The true frame and clock; without it both are random per release.
    REPEATS = "repeats"  # Further releases of the same walks.
    ANCHOR = (  # One true position of every walk, at its instant: a door, a camera.
        "anchor"
    )
    COMPANIONS = "companions"  # Releases of who walks along, with errors of their own.


_SAMPLE: Mapping[str, str] = {"per": "sample"}
TRACK: Mapping[str, str] = {
    "per": "track"
}  # Metadata of a field that holds one value a track.
_Batch = TypeVar("_Batch", "Tracks", "Sensed", "Release")


def _n_tracks(batch: _Batch) -> int:
    return batch.offsets.size - 1


def _one_track(batch: _Batch, index: int) -> _Batch:
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
    return derived(batch, **part)  # one of sound tracks is sound


def _each_track(batch: _Batch) -> Iterator[_Batch]:
    return (_one_track(batch, index) for index in range(_n_tracks(batch)))


@dataclass(frozen=True, eq=False, slots=True)
class Tracks:
    """The truth: N recorded or interpolated walks, M samples in all.

    `source` and `group` never reach a predictor or an attack.
    """

    t: Floats = field(metadata=_SAMPLE)  # (M,) s, strictly increasing within a track.
    xy: Floats = field(metadata=_SAMPLE)  # (M, 2) m, true position.
    offsets: Ints  # (N + 1,) first sample of each track, then M.
    source: tuple[str, ...] = field(
        metadata=TRACK
    )  # (N,) id of the recorded track, unique.
    group: tuple[str, ...] = field(metadata=TRACK)
    """(N,) the cluster of every interval: people who walk together share one."""
    person: tuple[str, ...] | None = field(default=None, kw_only=True, metadata=TRACK)
    """(N,) who it is; of several sessions None unless ids last over them."""
    session: tuple[str, ...] | None = field(default=None, kw_only=True, metadata=TRACK)
    """(N,) in which session, if there are several."""

    def __post_init__(self) -> None:
        _check_batch(self)
        if len(set(self.source)) != len(self.source):
            raise ValueError("source ids must be unique")

    def __repr__(self) -> str:
        """Return how many tracks and samples there are, in a line."""
        return f"<Tracks: {len(self):,} tracks, {self.t.size:,} samples>"

    __len__, __getitem__, __iter__ = _n_tracks, _one_track, _each_track


@dataclass(frozen=True, eq=False, slots=True)
class Scenes:
    """S scenes of one robot and A agents; agent a of scene s is track ``s * A + a``.

    Times are those of each agent's own recording; step h of the prediction grid is
    ``t_future[:, h]``, with h = 0 at the last history sample (eq. future_time_grid).
    """

    t: Floats  # (M,) s, history times of the S * A agents.
    xy: Floats  # (M, 2) m, true history after the shift into the scene.
    offsets: Ints  # (S * A + 1,)
    # (S * A,) row of the source track in the `Tracks` that the scenes were made of.
    track: Ints
    index: Ints  # (S,) number of the scene in the run: the key of its random streams.
    t_future: Floats  # (S * A, H) s, prediction grid.
    xy_future: Floats  # (S * A, H, 2) m, true positions on the grid.
    robot_start: Floats  # (S, 2) m
    robot_destination: Floats  # (S, 2) m
    # (S,) m, true minimum separation between robot and agents over the horizon.
    separation: Floats
    conflict: Bools  # (S,) ground-truth label c (eq. conflict_rule on the true future).
    # (S,) agents whose placement ran out of redraws and kept the last draw.
    exhausted: Ints
    time_to_conflict_s: Floats = field(default_factory=lambda: np.empty(0))
    """(S,) s until any agent is inside; 0: one is already; NaN: no conflict, or it is not known."""

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
        """Whether somebody is inside the safety radius at step 0 already, (S,)."""
        return np.asarray(self.time_to_conflict_s == 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Sensed:
    """What the sensing network holds about N tracks; a mechanism sees this and no ids.

    The truth is ``xy - sigma_raw[:, None] * unit_error``: a mechanism is trusted.
    """

    t: Floats = field(metadata=_SAMPLE)  # (M,) s, strictly increasing within a track.
    xy: Floats = field(metadata=_SAMPLE)  # (M, 2) m, raw estimate.
    unit_error: Floats = field(
        metadata=_SAMPLE
    )  # (M, 2) raw error in units of `sigma_raw`.
    sigma_raw: Floats = field(
        metadata=_SAMPLE
    )  # (M,) m, std of the raw error under `law`.
    information: Floats = field(
        metadata=_SAMPLE
    )  # (M,) 1/m^2, Fisher information (eq. swarm_fi).
    fid: Floats = field(
        metadata=_SAMPLE
    )  # (M,) 1/(m^2 s), density of it (eq. swarm_fid).
    offsets: Ints  # (N + 1,)
    law: ErrorLaw = "radial"
    """Law of the raw error: `radial` (the norm is |N(0, sigma)|), `isotropic` (N(0, sigma) per
    axis) or `fixed_direction` (as `radial`, on one line through the truth along a
    track)."""

    walk: Ints = field(
        default_factory=lambda: np.empty(0, dtype=np.int64), metadata=TRACK
    )
    """(N,) opaque numbers: equal for releases of one walk in one session; by default all differ."""

    def __post_init__(self) -> None:
        if np.size(self.walk) == 0:
            object.__setattr__(self, "walk", np.arange(np.size(self.offsets) - 1))
        _freeze(self, np.int64, walk="N")
        _check_batch(self)
        if not (self.sigma_raw >= 0).all():
            raise ValueError("sigma_raw must not be negative or NaN")

    __len__, __getitem__, __iter__ = _n_tracks, _one_track, _each_track


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class Release:
    """All that a robot or an adversary ever receives. N tracks, M samples in all."""

    t: Floats = field(metadata=_SAMPLE)  # (M,) s, strictly increasing within a track.
    xy: Floats = field(metadata=_SAMPLE)  # (M, 2) m, shared position.
    sigma: Floats | None = field(
        metadata=_SAMPLE
    )  # (M,) m, std declared; None without SIGMA.
    offsets: Ints  # (N + 1,)
    pseudonym: tuple[str, ...] = field(
        metadata=TRACK
    )  # (N,) opaque, fresh for every release.

    def __post_init__(self) -> None:
        _check_batch(self)

    __len__, __getitem__, __iter__ = _n_tracks, _one_track, _each_track

    def tracks(self, rows: Ints | Sequence[int]) -> Release:
        """Return some of the tracks, in the order of `rows`."""
        rows = np.asarray(rows, dtype=np.int64)
        names = self.pseudonym
        runs, offsets = runs_of(self.offsets, rows)
        return derived(
            self,
            t=end_to_end(self.t, runs),
            xy=end_to_end(self.xy, runs),
            sigma=None if self.sigma is None else end_to_end(self.sigma, runs),
            offsets=offsets,
            pseudonym=tuple([names[row] for row in rows.tolist()]),
        )

    def without_sigma(self) -> Release:
        """Return the same release as a receiver without `Knowledge.SIGMA` gets it."""
        return derived(self, sigma=None)


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """Predicted positions of N tracks on a grid of H future times."""

    mean: Floats  # (N, H, 2) m
    # (N, H, 2, 2) m^2, symmetric positive semidefinite; None without.
    cov: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, mean=("N", "H", 2))
        _check_estimate(self.mean, what="a predicted position")
        if self.cov is not None:
            _freeze(self, cov=(*self.mean.shape, 2))
            _check_covariances(self.cov)


@dataclass(frozen=True, eq=False, slots=True)
class Reconstruction:
    """An adversary's estimate of where the N people of a release were, sample by sample."""

    xy: Floats  # (M, 2) m, in the frame of the release.
    # (M,) m, standard deviation per axis that the attack claims, if any.
    std: Floats | None = None

    def __post_init__(self) -> None:
        _freeze(self, xy=("M", 2))
        _check_estimate(self.xy, what="a reconstructed position")
        if self.std is not None:
            _freeze(self, std=self.xy.shape[:1])
            if not within(self.std, 0.0, ESTIMATE_LIMIT_M):
                limit = f"at most {ESTIMATE_LIMIT_M:g} m"
                raise ValueError(f"std must be finite and not negative, and {limit}")


_Container = TypeVar("_Container", bound="DataclassInstance")


def derived(container: _Container, **changes: object) -> _Container:
    """Return a container with other values that are sound because those it had are.

    As `dataclasses.replace`, but what was checked when the container was made is not
    again.
    """
    new: _Container = object.__new__(type(container))
    for item in fields(container):
        value = changes.get(item.name, getattr(container, item.name))
        value = read_only(value) if isinstance(value, np.ndarray) else value
        object.__setattr__(new, item.name, value)
    return new


def _check_batch(batch: _Batch) -> None:
    """Freeze the arrays of a ragged batch and check shapes, times and finiteness."""
    _freeze(batch, np.int64, offsets="N")
    _freeze(batch, t="M")
    check_offsets(batch.offsets, batch.t.size)
    n_samples, n_tracks = batch.t.size, _n_tracks(batch)
    for item in fields(batch):
        value, per = getattr(batch, item.name), item.metadata.get("per")
        if per == "sample" and value is not None:
            is_planar = item.name in {"xy", "unit_error"}
            _freeze(batch, **{item.name: (n_samples, 2) if is_planar else (n_samples,)})
        elif per == "track" and value is not None and len(value) != n_tracks:
            raise ValueError(
                f"{item.name} must name {n_tracks} tracks, got {len(value)}"
            )
    check_times(batch.t, batch.offsets)
    largest = float(np.finfo(np.float64).max)
    if not within(batch.xy, -largest, largest):
        raise ValueError("a position is not finite")


def within(values: Floats, low: float, high: float) -> bool:
    """Whether all values lie within both bounds; NaN lies nowhere."""
    # Smallest and largest take no room; a comparison of all would.
    return values.size == 0 or bool(values.min() >= low and values.max() <= high)


def _check_estimate(xy: Floats, *, what: str) -> None:
    # If the sum of the squares, which takes one pass, is not beyond the limit's, no
    # coordinate is.
    is_small = np.vdot(xy, xy) <= ESTIMATE_LIMIT_M**2
    if not is_small and not within(xy, -ESTIMATE_LIMIT_M, ESTIMATE_LIMIT_M):
        is_far = np.isfinite(xy).all()
        fault = f"lies beyond {ESTIMATE_LIMIT_M:g} m" if is_far else "is not finite"
        raise ValueError(f"{what} {fault}")


def _check_covariances(cov: Floats) -> None:
    """Check that (..., 2, 2) could be covariances: what rounding does to them is let pass."""
    limit_m2 = ESTIMATE_LIMIT_M**2
    if not within(cov, -limit_m2, limit_m2):
        raise ValueError(
            f"a predicted covariance is not finite or beyond {limit_m2:g} m^2"
        )
    xx, xy, yx, yy = cov[..., 0, 0], cov[..., 0, 1], cov[..., 1, 0], cov[..., 1, 1]
    largest = np.maximum(np.abs(xx), np.abs(yy))
    if not (np.abs(xy - yx) <= _ROUNDING * largest).all():
        raise ValueError("a predicted covariance is not symmetric")
    # No eigenvalue of a symmetric 2 x 2 matrix is negative if neither diagonal nor
    # determinant is.
    is_sound = np.minimum(xx, yy) >= -_ROUNDING * largest
    is_sound &= xx * yy - xy * yx >= -_ROUNDING * largest**2
    if not is_sound.all():
        raise ValueError("a predicted covariance is not positive semidefinite")


def _freeze(
    container: object,
    kind: type[np.generic] = np.float64,
    /,
    **shapes: Sequence[int | str],
) -> None:
    """Make fields read-only arrays of one kind of numbers; a letter in a shape is any length."""
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
    """Return the array as nobody can write to it."""
    if array.flags.writeable:
        # A view, not a copy: a copy of every release would double the memory of a
        # block.
        array = array.view()
        array.flags.writeable = False
    return array


Runs: TypeAlias = list[
    tuple[int, int]
]  # Stretches of samples: from which on, and before which.


def stretches(first: Ints, sizes: Ints) -> tuple[Ints, Ints]:
    """Return so many samples from each first one on, end to end, and the offsets among them."""
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    return np.repeat(first - offsets[:-1], sizes) + np.arange(offsets[-1]), offsets


def runs_of(offsets: Ints, rows: Ints) -> tuple[Runs, Ints]:
    """Return the stretches that some tracks fill, and the offsets of the tracks among them.

    Neighbours are one stretch. IndexError for a row that is none.
    """
    if rows.size and rows.min() < 0:
        raise IndexError(f"track {rows.min()} of {offsets.size - 1}")
    sizes = np.diff(offsets)[rows]
    ends = np.flatnonzero(np.diff(rows, append=-2) != 1)
    starts = np.append(0, ends[:-1] + 1)[: ends.size]
    runs = zip(
        offsets[rows[starts]].tolist(), offsets[rows[ends] + 1].tolist(), strict=True
    )
    return list(runs), np.concatenate([[0], np.cumsum(sizes)])


def end_to_end(values: NDArray[_Scalar], runs: Runs) -> NDArray[_Scalar]:
    """Return stretches of samples one after the other; a view if it is but one."""
    # To copy slices takes a fraction of the time of an index for every sample.
    parts = [values[first:end] for first, end in runs]
    return parts[0] if len(parts) == 1 else np.concatenate(parts or [values[:0]])


def squared_lengths(vectors: Floats) -> Floats:
    """Return the squared lengths (...,) of vectors of the plane, (..., 2).

    Their root is a tenth of the work of np.hypot, whose guard against overflow nobody
    needs.
    """
    x, y = vectors[..., 0], vectors[..., 1]
    square: Floats = x * x
    square += y * y
    return square


def positive(name: str, value: float, *, finite: bool = True) -> float:
    """Return a number, or raise ValueError if it is not positive, or infinite where `finite`."""
    if not value > 0 or (finite and not np.isfinite(value)):
        raise ValueError(f"{name} must be positive, got {value}")
    return float(value)


def check_offsets(offsets: Ints, n_samples: int) -> None:
    """Raise ValueError unless the offsets cut so many samples into tracks, none of them empty."""
    if offsets.size == 0 or offsets[0] != 0 or offsets[-1] != n_samples:
        raise ValueError(f"offsets must run from 0 to {n_samples}")
    if (np.diff(offsets) < 1).any():
        raise ValueError("every track needs at least one sample: offsets must increase")


def check_times(t: Floats, offsets: Ints) -> None:
    """Raise ValueError unless times are finite and rise within each track."""
    rising = t[1:] > t[:-1]  # False for NaN
    rising[offsets[1:-1] - 1] = True  # from one track to the next
    # What rises from a finite number to another is finite.
    ends = t[offsets[:-1]], t[offsets[1:] - 1]
    if not (rising.all() and np.isfinite(ends).all()):
        raise ValueError("times must be finite and strictly increasing within a track")
