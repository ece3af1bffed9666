"""Read a secret out of the low-order digits of shared positions.

Noise of decimetres leaves the digits below a centimetre uniform, and independent of
where a person is. A mechanism that writes the true position into them protects nobody,
while every other attack takes them for noise. The attack learns from other people which
pair of decimal digits says most about the truth. It cannot see a secret that a key
hides: such digits look random to everybody without the key.
"""

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from attacks.reconstruction.kalman_rts import RadialRTS
from isac_track.protocols import AttackContext, Reconstructor
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Reconstruction,
    Release,
    derived,
)

Target: TypeAlias = Literal["place", "error"]
PLACES: Final = tuple(range(1, 10))
"""Numbers of decimals before the pair of digits: 2 is the pair of 1 mm and 0.1 mm."""
LEAST_EXPLAINED: Final = 0.2
"""Share of the variance on held-out people above which digits count as a message.

docs/protocol.md has the shares that built-in mechanisms show.
"""
_VALUES: Final = 100  # Of a pair of digits.
_FEWEST: Final = 200  # Samples to learn from.
_LEAST_MORE: Final = 0.02  # Of the remaining variance, that a further pair explains.
_MOST_PAIRS: Final = 4


class Pair(NamedTuple):
    """What a pair of digits says about positions, beyond the pairs before it."""

    place: int  # Decimals before the pair.
    table: Floats  # (100, 2) mean of the target's residual, m, by the pair.


class Message(NamedTuple):
    """What pairs of digits say about positions, learnt from some people."""

    target: Target  # The true place, or the error of the sample.
    pairs: tuple[Pair, ...]  # The first says most.
    explained: float  # Share of the target's variance on people held out.

    @property
    def place(self) -> int:
        """Decimals before the first pair."""
        return self.pairs[0].place

    @property
    def is_message(self) -> bool:
        """Whether the digits say more than chance."""
        return self.explained > LEAST_EXPLAINED

    def read(self, xy: Floats) -> Floats:
        """Return what the digits of positions say, (M, 2) m."""
        return np.asarray(np.sum([_said(pair, xy) for pair in self.pairs], axis=0))


@dataclass(frozen=True, slots=True)
class LowDigits:
    """The attack; without a message it returns positions as they are shared."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset(
        {Knowledge.TRAIN, Knowledge.SCENE}
    )
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context: AttackContext) -> Reconstructor:
        """Learn from the training set, and return the reader of releases."""
        train = context.train
        message = read_message(
            train.release.xy, train.truth, offsets=train.release.offsets
        )

        smooth = RadialRTS().fit(
            AttackContext(rng=context.rng, epsilon_m=context.epsilon_m)
        )

        def reconstruct(release: Release) -> Reconstruction:
            if message is None or not message.is_message:
                return Reconstruction(release.xy, None)
            said = message.read(release.xy)
            is_error = message.target == "error"
            xy = release.xy + said if is_error else said
            # What was hidden has the error of the sensor, which a smoother removes.
            return smooth(derived(release, xy=xy, sigma=None))

        return reconstruct


def digit_pairs(xy: Floats, place: int) -> Ints:
    """Return the two digits behind `place` decimals of each coordinate, 0 to 99."""
    scaled = np.abs(xy) * 10.0**place
    pairs = np.floor((scaled - np.floor(scaled)) * _VALUES).astype(np.int64)
    return np.minimum(pairs, _VALUES - 1)


def read_message(xy: Floats, truth: Floats, *, offsets: Ints) -> Message | None:
    """Return the pairs of digits that say most about other people; None if too few.

    `xy` and `truth`, (M, 2) m, are shared and true positions of N tracks. Tables are
    learnt on every other track and judged on the rest, so that a person who stands
    still, with the same digits all the time, is no message. Further pairs are read as
    long as they explain something: a place may need more digits than two.
    """
    owner = np.repeat(np.arange(offsets.size - 1), np.diff(offsets))
    is_learnt = owner % 2 == 0
    if min(is_learnt.sum(), (~is_learnt).sum()) < _FEWEST:
        return None
    targets: dict[Target, Floats] = {"place": truth, "error": truth - xy}
    messages = [
        _message(target, wanted, xy, is_learnt) for target, wanted in targets.items()
    ]
    return max(messages, key=lambda message: message.explained)


def _message(target: Target, wanted: Floats, xy: Floats, is_learnt: Bools) -> Message:
    """Return what digits say of a target, (M, 2) m."""
    total = _squares(wanted, is_learnt)
    pairs: list[Pair] = []
    rest = wanted
    for _ in range(_MOST_PAIRS):
        tried = [Pair(place, _table(place, xy, rest, is_learnt)) for place in PLACES]
        best = min(tried, key=lambda pair: _squares(rest - _said(pair, xy), is_learnt))
        after = rest - _said(best, xy)
        least = (1.0 - _LEAST_MORE) * _squares(rest, is_learnt)
        if pairs and not _squares(after, is_learnt) < least:
            break
        pairs.append(best)
        rest = after
    left = _squares(rest, is_learnt)
    explained = 1.0 - left / total if total > 0.0 else 0.0
    return Message(target, tuple(pairs), explained)


def _squares(values: Floats, is_learnt: Bools) -> float:
    """Return the squares of the judged values about the mean of the learnt values."""
    return float(((values[~is_learnt] - values[is_learnt].mean(axis=0)) ** 2).sum())


def _table(place: int, xy: Floats, wanted: Floats, is_learnt: Bools) -> Floats:
    """Return the mean of a target by the value of a pair, (100, 2) m."""
    pairs, values = digit_pairs(xy[is_learnt], place), wanted[is_learnt]
    columns = []
    for axis in range(2):
        count = np.bincount(pairs[:, axis], minlength=_VALUES)
        total = np.bincount(pairs[:, axis], values[:, axis], minlength=_VALUES)
        mean = np.full(_VALUES, values[:, axis].mean())
        np.divide(total, count, out=mean, where=count > 0)
        columns.append(mean)
    return np.stack(columns, axis=1)


def _said(pair: Pair, xy: Floats) -> Floats:
    """Return the entries of a table for the digits of positions, (M, 2) m."""
    digits = digit_pairs(xy, pair.place)
    return np.stack([pair.table[digits[:, axis], axis] for axis in range(2)], axis=1)
