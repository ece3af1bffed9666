"""Link walks by matching histograms of speed and turning rate."""

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from scipy.special import xlogy

from attacks.linkage.learning import learn_parameters, make_linker
from attacks.linkage.signals import Signals, load_loops, release_motion, width_factors
from attacks.parameters import candidate_values, require_positive
from attacks.remembered import memoised_by_track
from isac_track.protocols import AttackContext, Linker
from isac_track.types import Floats, Ints, Knowledge, Release

_FASTEST_M_S = 2.2
# Pairs at a time: all pairs of thousands of people would take half a gigabyte.
_AT_ONCE = 2**20
# Mated pairs to learn from: four candidates on all would cost too much.
_TAUGHT_BY = 64
_TURNS_RAD_S = np.array([-0.5, -0.2, 0.0, 0.2, 0.5])


@dataclass(frozen=True, slots=True)
class Histogram:
    """Likelihood that two walks' speeds and turning rates have one distribution.

    Every quarter of a second of a walk counts for a cell of speed and signed turning
    rate, split among the four nearest centres. With counts a and b in the cells and
    f(x) = x log x, the score is the generalised log likelihood ratio of "one
    multinomial" to "two":

        sum_k [f(a_k + b_k) - f(a_k) - f(b_k)] - [f(A + B) - f(A) - f(B)],   A = sum a,
        B = sum b

    It is 0 for equal shapes and negative otherwise. Order in time does not enter.

    References
    ----------
    Naini, Unnikrishnan, Thiran, Vetterli, "Where you are is who you are: user
    identification by matching statistics", IEEE Trans. Information Forensics and
    Security 11(2), 2016, 358-372; Unnikrishnan, "Asymptotically optimal matching of
    multiple sequences to source distributions and training sequences", IEEE Trans.
    Information Theory 61(1), 2015, 452-468.
    """

    # Of `signals.widths_s`; None: learnt from the training set, or 1.
    factor: float | None = None
    # Centres from 0 to 2.2 m/s; None: learnt, or `DEFAULT_SPEEDS`.
    speeds: int | None = None

    kind: ClassVar[str] = "linkage"
    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset({Knowledge.TRAIN})
    DEFAULT_SPEEDS: ClassVar[int] = 12

    def __post_init__(self) -> None:
        require_positive(factor=self.factor)
        if self.speeds is not None and self.speeds < 2:  # noqa: PLR2004 - both ends
            raise ValueError(f"speeds must be at least 2, got {self.speeds}")

    def fit(self, context: AttackContext) -> Linker:
        """Return the linker, its parameters learnt from the training set, if any."""
        factor, speeds = learn_parameters(
            context,
            (
                width_factors(context, self.factor),
                candidate_values(self.speeds, (self.DEFAULT_SPEEDS, 24)),
            ),
            most=_TAUGHT_BY,
            scores=lambda train: partial(_score, train.probe, train.gallery),
        )
        return make_linker(_score, factor, speeds)


def _score(probe: Release, gallery: Release, factor: float, speeds: int) -> Floats:
    return same_source_ratio(
        _counts(probe, factor, speeds), _counts(gallery, factor, speeds)
    )


@memoised_by_track()
def _counts(release: Release, factor: float, speeds: int) -> Floats:
    return count_cells(release_motion(release, factor), speeds=speeds)


def count_cells(motion: Signals, *, speeds: int) -> Floats:
    """Return how often each walk is at each speed and turning rate, (N, speeds * 5)."""
    _, n_tracks, n_cells = motion.values.shape
    speed, turn = motion.values[:, np.arange(n_cells) < motion.sizes[:, None]]
    owner = np.repeat(np.arange(n_tracks), motion.sizes)
    below_speed, share_speed = _between(speed, np.linspace(0.0, _FASTEST_M_S, speeds))
    below_turn, share_turn = _between(turn, _TURNS_RAD_S)
    size = speeds * _TURNS_RAD_S.size
    cell = owner * size + below_speed * _TURNS_RAD_S.size + below_turn
    corners = [0, 1, _TURNS_RAD_S.size, _TURNS_RAD_S.size + 1]
    index = np.concatenate([cell + corner for corner in corners])
    below, above = 1.0 - share_speed, share_speed
    right, left = 1.0 - share_turn, share_turn
    share = np.concatenate([below * right, below * left, above * right, above * left])
    counts: Floats = np.bincount(index, share, n_tracks * size).astype(np.float64)
    return counts.reshape(n_tracks, size)


def _between(values: Floats, centres: Floats) -> tuple[Ints, Floats]:
    """Return the centre below each value and the share of the next centre."""
    position = np.interp(values, centres, np.arange(centres.size, dtype=np.float64))
    below = np.minimum(position.astype(np.int64), centres.size - 2)
    return below, position - below


def same_source_ratio(a: Floats, b: Floats) -> Floats:
    """Return the log likelihood ratio of one source to two for each pair, (P, G).

    `a` are counts in K cells, (P, K), `b` those of the gallery, (G, K).
    """
    ratio, all_b, log_b = np.empty((len(a), len(b))), b.sum(axis=1), xlogy(b, b)
    n_at_once = max(1, _AT_ONCE // max(1, len(b)))
    for first in range(0, len(a), n_at_once):
        a_block, block = a[first : first + n_at_once], ratio[first : first + n_at_once]
        load_loops().shared_cells(a_block, b, xlogy(a_block, a_block), log_b, block)
        all_a = a_block.sum(axis=1)[:, None]
        total = all_a + all_b
        block += xlogy(all_a, all_a) + xlogy(all_b, all_b) - xlogy(total, total)
    return ratio
