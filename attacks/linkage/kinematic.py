"""Link walks across a silent gap by the Kalman states on both of its sides."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, NamedTuple

import numpy as np

from attacks.linkage.learning import (
    can_learn,
    learn_parameters,
    make_linker,
    mated_rows,
)
from attacks.linkage.noise_levels import ASSUMED, NoiseModel, fitted_model, log_ratios
from attacks.linkage.signals import load_loops
from attacks.parameters import candidate_values, require_positive
from attacks.remembered import memoised_by_track, noise_m2
from isac_track.kalman import Batch, kalman_last
from isac_track.protocols import AttackContext, LinkageTrainingSet, Linker
from isac_track.types import Floats, Ints, Knowledge, Release, derived

_PRIOR_STD = (100.0, 1.4)  # m around the first sample and m/s around rest: nobody runs.
# Degrees of freedom: people turn and stop in a gap more than under white noise.
_TAIL = 5.0
_SLACK_S = 0.5
# A longer gap counts as this long: a state says nothing about a later time.
_LONGEST_S = 60.0


@dataclass(frozen=True, slots=True)
class Kinematic:
    """Likelihood that a gallery walk starts in the state predicted from a probe.

    A constant-velocity filter runs along every probe and, back in time, along every
    gallery walk. The probe's last state, predicted across the gap, differs from the
    gallery walk's first. The score is the log density of that difference under both
    covariances and the process noise of the gap. The density is Student's t with five
    degrees of freedom: its heavy tail rules no pair out entirely. The score also
    contains the log likelihood ratio of the noise levels on both sides
    (`noise_levels.log_ratios`).

    References
    ----------
    Gruteser, Hoh, "On the anonymity of periodic location samples", SPC 2005
    (multi-target tracking as an attack on pseudonyms); Wiedersheim, Ma, Kargl,
    Papadimitratos, "Privacy in inter-vehicular networks: why simple pseudonym change is
    not enough", WONS 2010. Bar-Shalom, Li, Kirubarajan, *Estimation with Applications
    to Tracking and Navigation*, 2001, ch. 6.2.
    """

    # m^2/s^3; None: learnt from the training set, or `DEFAULT_Q`.
    q: float | None = None
    floor_m2: float | None = None
    """Least error variance per axis; None: learnt, or `DEFAULT_FLOOR_M2`.

    A smoother's errors are correlated and do not show in the innovations.
    """

    noise_correlation: float | None = None
    """Between the log noise levels of a person on both sides, in [0, 1).

    0 leaves the levels out. None: learnt, or that of `noise_levels.ASSUMED`.
    """

    kind: ClassVar[str] = "linkage"
    across_gap: ClassVar[bool] = True
    requires: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.SCENE})
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_Q: ClassVar[float] = 0.05
    DEFAULT_FLOOR_M2: ClassVar[float] = 0.01

    def __post_init__(self) -> None:
        require_positive(q=self.q, floor_m2=self.floor_m2)
        if not (self.noise_correlation is None or 0.0 <= self.noise_correlation < 1.0):
            raise ValueError(
                "noise_correlation must be from 0 to below 1, got"
                f" {self.noise_correlation}"
            )

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        model = fitted_model(context.train) if can_learn(context) else ASSUMED
        if self.noise_correlation is not None:
            model = replace(model, correlation=self.noise_correlation)
        densities = candidate_values(self.q, (self.DEFAULT_Q, 0.0125, 0.2))
        floors_m2 = candidate_values(self.floor_m2, (self.DEFAULT_FLOOR_M2, 0.001, 0.1))
        scores = partial(_scores, model=model)
        return make_linker(
            evidence,
            *learn_parameters(context, (densities, floors_m2), scores=scores),
            model,
        )


def _scores(
    train: LinkageTrainingSet, *, model: NoiseModel
) -> Callable[[float, float], Floats]:
    """Return the function from q and floor to the scores of a training set, (P, G)."""
    # As releases of their own: filters over the people of the whole release would cost
    # more than memoising them saves.
    sides, gap_s = (
        (derived(train.probe), derived(train.gallery)),
        mate_gap_range_s(train),
    )
    noise = level_ratios(train.probe, train.gallery, model)
    return lambda q, floor_m2: continuations(*sides, q, floor_m2, gap_s=gap_s) + noise


def mate_gap_range_s(train: LinkageTrainingSet) -> tuple[float, float]:
    """Return the least and the longest gap, s, of possible mates in a training set."""
    # Where pseudonyms rotate more than once, two walks may be mates only if their gap
    # is that of one rotation.
    rows = mated_rows(train)
    starts_s = train.gallery.t[train.gallery.offsets[train.mate[rows]]]
    gaps_s = starts_s - train.probe.t[train.probe.offsets[rows + 1] - 1]
    return float(gaps_s.min()) - _SLACK_S, float(gaps_s.max()) + _SLACK_S


def evidence(
    probe: Release, gallery: Release, q: float, floor_m2: float, model: NoiseModel
) -> Floats:
    """Return `continuations` plus the log likelihood ratio of noise levels, (P, G)."""
    motion = continuations(probe, gallery, q, floor_m2)
    return motion + level_ratios(probe, gallery, model)


def level_ratios(probe: Release, gallery: Release, model: NoiseModel) -> Floats | float:
    """Return the log likelihood ratio of noise levels, (P, G); 0 if uncorrelated."""
    return log_ratios(probe, gallery, model) if model.correlation > 0.0 else 0.0


def continuations(
    probe: Release,
    gallery: Release,
    q: float,
    floor_m2: float,
    gap_s: tuple[float, float] = (-np.inf, np.inf),
) -> Floats:
    """Return the log density of each gallery walk continuing each probe, (P, G).

    Up to a constant; `q` in m^2/s^3, `floor_m2` the least error variance per axis.
    There is no density where the gap is not within `gap_s`.
    """
    ends = _end_states(probe, q, floor_m2, 1)
    starts = _end_states(gallery, q, floor_m2, -1)
    density = np.empty((len(probe), len(gallery)))
    load_loops().continuation_densities(
        np.concatenate([ends.t, starts.t]),
        np.concatenate([ends.mean, starts.mean]),
        np.concatenate([ends.cov, starts.cov]),
        q,
        (*gap_s, _LONGEST_S),
        _TAIL,
        density,
    )
    return density


class _EndStates(NamedTuple):
    """Kalman states of N walks at one of their ends."""

    t: Floats  # (N,) s, back in time at the starts.
    mean: Floats  # (N, 2, 2) m and m/s: per axis position and velocity.
    cov: Floats  # (N, 2, 2) m^2, m^2/s, m^2/s^2

    def walks(self, rows: Ints) -> "_EndStates":
        """Return the states of some of the walks."""
        return _EndStates(self.t[rows], self.mean[rows], self.cov[rows])


@memoised_by_track(_EndStates.walks)
def _end_states(
    release: Release, q: float, floor_m2: float, direction: int
) -> _EndStates:
    """Return the states at the ends of walks (`direction` 1) or at starts (-1)."""
    t, xy, sizes = release.t, release.xy, np.diff(release.offsets)
    if direction < 0:  # Back in time: from the last sample of a walk to its first.
        ends = release.offsets[:-1] + release.offsets[1:] - 1
        turned = np.repeat(ends, sizes) - np.arange(t.size)
        t, xy = -t[turned], xy[turned]
    variance_m2 = np.repeat(np.maximum(noise_m2(release), floor_m2), sizes)
    state = kalman_last(Batch(t, xy, variance_m2, release.offsets, _PRIOR_STD), q=q)
    return _EndStates(t[release.offsets[1:] - 1], state.mean, state.cov)
