"""What a linkage check is made of: running a linker as one adversary, comparing its scores."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from attacks.testing._kit import SPREADS, answers, granted_rows, rms
from attacks.testing._linkage_cases import LinkageCase, copied, ordinary, without_sigma
from attacks.testing._releases import EPSILON_M
from isac_track.protocols import AttackContext
from isac_track.rng import stream
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from isac_track.protocols import LinkageAttack
    from isac_track.types import Floats, Ints

NEVER_GRANTED = frozenset({Knowledge.REPEATS})
"""The repeats of a walk would be linked already."""


@dataclass(frozen=True, eq=False, slots=True)
class LinkageRow:
    """A linkage attack as one adversary runs it."""

    attack: LinkageAttack
    adversary: str
    granted: frozenset[Knowledge]
    """What the adversary grants it."""
    given: frozenset[Knowledge]
    """What it is given here: all there is, if it cannot keep to what it was granted."""

    def __str__(self) -> str:
        knows = ", ".join(sorted(one.name for one in self.granted)) or "nothing"
        return f"{type(self.attack).__name__} as {self.adversary} (granted {knows})"

    @property
    def scene(self) -> bool:
        """Whether it sees the true frame and clock: cases differ in that."""
        return Knowledge.SCENE in self.granted

    def with_everything(self) -> LinkageRow:
        """Return the row given all that there is in its case."""
        withheld = NEVER_GRANTED if self.scene else NEVER_GRANTED | {Knowledge.SCENE}
        return replace(self, given=frozenset(Knowledge) - withheld)

    def raw(self, case: LinkageCase, *, seed: int = 0) -> object:
        """Return whatever the attack returns for a case, on copies of all arrays."""
        (result,) = run(self.attack, [copied(case)], granted=self.given, seed=seed, who=str(self))
        return result

    def scores(self, case: LinkageCase, *, seed: int = 0) -> Floats:
        """Return the scores of the probes of a case against its gallery, (P, G)."""
        return read(self.raw(case, seed=seed), case, who=str(self))

    def scores_in_turn(self, cases: Sequence[LinkageCase]) -> list[Floats]:
        """Return the scores of several cases from one call of `fit`, which is for the first."""
        results = run(self.attack, list(map(copied, cases)), granted=self.given, who=str(self))
        return [
            read(result, case, who=str(self)) for result, case in zip(results, cases, strict=True)
        ]


def strict_rows(attack: LinkageAttack) -> Iterator[LinkageRow]:
    """Yield the rows of an attack, weakest adversary first, given what they are granted."""
    for adversary, granted in granted_rows(attack):
        yield LinkageRow(attack=attack, adversary=adversary, granted=granted, given=granted)


def rows(attack: LinkageAttack) -> Iterator[LinkageRow]:
    """Yield the rows of an attack as all checks but one run them.

    An attack that touches what it was not granted fails the check about that. In all others it
    is given everything, or that one mistake would fail them all and hide the next one.
    """
    for row in strict_rows(attack):
        try:
            row.raw(ordinary(scene=row.scene))
        except AssertionError:
            yield row.with_everything()
        else:
            yield row


def run(
    attack: LinkageAttack,
    cases: Sequence[LinkageCase],
    *,
    granted: frozenset[Knowledge],
    who: str,
    seed: int = 0,
) -> list[object]:
    """Return whatever an attack returns for each case, given what was granted and no more.

    The context is that of the first case.

    Raises
    ------
    AssertionError
        For anything that the attack raises, with the line that did.
    """
    about = cases[0].about
    if Knowledge.SIGMA not in granted:
        cases = list(map(without_sigma, cases))
    context = AttackContext(
        rng=stream(seed, "attacks", "testing", "attack"),
        epsilon_m=EPSILON_M,
        granted=granted,
        mechanism=cases[0].mechanism,
        train=cases[0].train,
    )
    asked = [(case.probe, case.gallery) for case in cases]
    return answers(attack, context, asked, who=f"{who}, {about}")


def read(result: Any, case: LinkageCase, *, who: str) -> Floats:  # noqa: ANN401 - a stranger's
    """Return a result as an array; the check of its type is another one.

    Raises
    ------
    AssertionError
        If it is not one finite real number for each probe and gallery track.
    """
    expected = (len(case.probe), len(case.gallery))
    try:
        scores = np.asarray(result)
    except ValueError:  # rows of different lengths
        scores = np.asarray(None)
    if scores.dtype.kind not in "fiub":
        shown = type(result).__name__ if scores.ndim == 0 else f"an array of {scores.dtype}"
        raise AssertionError(
            f"{who}, {case.about}: expected real numbers of shape (P, G) = {expected}, got {shown}"
        )
    if scores.shape != expected:
        turned = " (turned round?)" if scores.shape == expected[::-1] else ""
        raise AssertionError(
            f"{who}, {case.about}: scores of shape {scores.shape}, expected (P, G) = {expected}: "
            f"a row for every probe, a column for every gallery track{turned}"
        )
    read_as = scores.astype(np.float64)
    if not np.isfinite(read_as).all():
        raise AssertionError(
            f"{who}, {case.about}: {np.count_nonzero(~np.isfinite(read_as))} of {read_as.size} "
            "scores are not finite; who cannot tell gives all candidates the same score"
        )
    return read_as


def expect_same(
    row: LinkageRow,
    case: LinkageCase,
    *,
    got: Floats,
    expected: Floats,
    tolerance: float,
    what: str,
    hint: str,
) -> None:
    """Fail if scores differ by more than rounding, or than chance if the attack draws.

    Scores have no unit: all gaps are shares of their spread, from the lowest to the highest. An
    attack that draws is compared with itself under another seed: of its draws, a check can only
    ask that they have the same spread.

    Parameters
    ----------
    row : LinkageRow
    case : LinkageCase
        Where the spread and the chance are taken from.
    got, expected : (P, G)
    tolerance : float
        Share of the spread.
    what, hint : str
        For the message.
    """
    plain = row.scores(case)
    # Where all scores are alike there is no spread; their size will do.
    spread = float(np.ptp(plain)) or float(np.abs(plain).max()) or 1.0
    chance = rms(np.abs(plain - row.scores(case, seed=1))) / spread
    gaps = np.abs(got - expected)
    gap = (rms(gaps) if chance > 0 else float(gaps.max())) / spread
    if gap > tolerance + SPREADS * chance:
        drawn = f" (two seeds differ by {chance:.3g})" if chance > 0 else ""
        raise AssertionError(
            f"{row}, {case.about}: {what}: scores differ by {gap:.3g} of their spread, expected "
            f"at most {tolerance:g}{drawn}; {hint}"
        )


def hits(scores: Floats, mate: Ints) -> float:
    """Return how many probes have their mate first, as expected if equals are drawn from."""
    own = scores[np.arange(len(mate)), mate]
    best = scores.max(axis=1)
    ties = (scores == best[:, None]).sum(axis=1)
    return float(np.sum((own == best) / ties))


def log_ranks(scores: Floats, mate: Ints) -> Floats:
    """Return the logarithm of the rank of each probe's mate, (P,): 0 is first.

    Among equals a mate is in the middle.
    """
    own = scores[np.arange(len(mate)), mate][:, None]
    better, equal = (scores > own).sum(axis=1), (scores == own).sum(axis=1)
    ranks: Floats = np.log(better + (equal + 1) / 2)
    return ranks
