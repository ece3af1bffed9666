"""What attack checks are made of: an attack as each adversary runs it, and comparing answers."""

from __future__ import annotations

import dataclasses
import inspect
import sys
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias
from unittest import SkipTest

import numpy as np

from attacks.testing import _cases, _linkage_cases
from attacks.testing._releases import EPSILON_M, copied, without_sigma
from isac_track.errors import PluginError, told
from isac_track.protocols import AttackContext, grants, kind_of
from isac_track.rng import stream
from isac_track.testing.engine import attempt
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from isac_track.protocols import LinkageAttack, ReconstructionAttack
    from isac_track.types import Floats

Attack: TypeAlias = "ReconstructionAttack | LinkageAttack"
Case: TypeAlias = Any
"""`_cases.Case` or `_linkage_cases.LinkageCase`, by the kind of the attack."""
Answer: TypeAlias = Any
"""What `Case.read` makes of a result: `_cases.Estimate`, or scores (P, G)."""

SPREADS = 3.0
"""Two runs of an attack that draws may differ by so many times what two seeds differ by."""
_GIVES = {
    "reconstruction": (1, "from a release to a reconstruction"),
    "linkage": (2, "from two releases, probe and gallery, to a matrix of scores"),
}
"""How many releases the function from `fit` takes, and what it is."""


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it."""

    attack: Attack
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
        """Whether it sees the true frame and clock: the cases of linkage differ in that."""
        return Knowledge.SCENE in self.granted

    @property
    def ordinary(self) -> Case:
        """The case for checks that compare two runs."""
        if kind_of(self.attack) == "linkage":
            return _linkage_cases.ordinary(scene=self.scene)
        return _cases.ordinary()

    @property
    def another(self) -> Case:
        """What the function from `fit` may be asked after the ordinary case."""
        base = self.ordinary
        if kind_of(self.attack) == "linkage":
            return replace(_linkage_cases.another(scene=self.scene), train=base.train)
        # Repeats are of the walks of a case: another release of those is all that may be asked.
        if Knowledge.REPEATS not in self.granted:
            return replace(base, release=_cases.another().release)
        return replace(base, release=replace(base.repeats[0], pseudonym=base.release.pseudonym))

    def with_everything(self) -> Row:
        """Return the row given all that there is in its cases."""
        return replace(self, given=self.ordinary.everything)

    def strict(self) -> Row:
        """Return the row given what it was granted."""
        return replace(self, given=self.granted)

    def fail(self, case: Case, what: str) -> NoReturn:
        """Fail a check, with the row and the case."""
        raise AssertionError(f"{self}, {case.about}: {what}")

    def answer(self, case: Case, *, seed: int = 0) -> Answer:
        """Return what the attack makes of a case, given copies of all arrays."""
        return self.answers(case, seed=seed)[0]

    def answers(self, *cases: Case, seed: int = 0) -> list[Answer]:
        """Return what one call of `fit`, which is for the first case, makes of several in turn."""
        results = self.raw([copied(case) for case in cases], seed=seed)
        return [self.read(case, result) for case, result in zip(cases, results, strict=True)]

    def read(self, case: Case, result: object) -> Answer:
        """Return a result as arrays, or fail the check."""
        try:
            return case.read(result)
        except ValueError as error:
            raise AssertionError(f"{self}, {case.about}: {error}") from None

    def raw(self, cases: Sequence[Case], *, seed: int = 0) -> list[object]:
        """Return whatever the attack returns for each case, given what it is and no more.

        The context is that of the first case.

        Raises
        ------
        AssertionError
            For anything that the attack raises, with the line that did.
        """
        about = cases[0].about
        if Knowledge.SIGMA not in self.given:
            cases = [without_sigma(case) for case in cases]
        context = AttackContext(
            rng=stream(seed, "attacks", "testing", "attack"),
            epsilon_m=EPSILON_M,
            granted=self.given,
            mechanism=cases[0].mechanism,
            train=cases[0].train,
            repeats=cases[0].repeats,
        )
        n_releases, gives = _GIVES[kind_of(self.attack)]
        doing, fitted = "fit(context)", None

        def run() -> list[object]:
            nonlocal doing, fitted
            fitted = self.attack.fit(context)
            if not callable(fitted):
                raise TypeError(f"fit must return a function {gives}, got {fitted!r}")
            doing = "the function from fit"
            return [fitted(*(getattr(case, name) for name in case.asked)) for case in cases]

        def failing(error: BaseException) -> str:
            hint = ""
            if isinstance(error, TypeError) and _n_arguments(fitted) == 3 - n_releases:
                hint = f"; it takes a function {gives}: which `kind` is the attack?"
            where = _place(error, self.attack)
            return f"{self}, {about}: {doing} raised {told(error)}{where}{hint}"

        found: list[object] = attempt(run, failing=failing)
        return found


def rows(attack: Attack) -> Iterator[Row]:
    """Yield the rows of an attack, weakest adversary first, as all checks but one run them.

    An attack that touches what it was not granted fails the check about that. In all others it
    is given everything, or that one mistake would fail them all and hide the next one.
    """
    for adversary, granted in granted_rows(attack):
        row = Row(attack=attack, adversary=adversary, granted=granted, given=granted)
        try:
            row.raw([copied(row.ordinary)])
        except AssertionError:
            yield row.with_everything()
        else:
            yield row


def in_every_row(body: Callable[[Row], None], attack: Attack) -> None:
    """Hold the body of a check against every row of an attack, or those that it applies to."""
    exempt = None
    applied = False
    for row in rows(attack):
        try:
            body(row)
        except SkipTest as reason:
            exempt = reason
        else:
            applied = True
    if exempt is not None and not applied:
        raise exempt


def expect_same(
    row: Row,
    case: Case,
    *,
    got: Answer,
    expected: Answer,
    tolerance: float,
    what: str,
    hint: str,
) -> None:
    """Fail if two answers differ by more than rounding, or than chance if the attack draws.

    An attack that draws is compared with itself under another seed: of its draws, a check can
    only ask that they have the same spread, which `case` says.
    """
    plain = row.answer(case)
    spread = case.spread(plain)
    chance = max(map(rms, case.gaps(plain, row.answer(case, seed=1)))) / spread
    size: Callable[[Floats], float] = rms if chance > 0 else np.max
    gap = max(float(size(one)) for one in case.gaps(got, expected)) / spread
    if gap > tolerance + SPREADS * chance:
        unit = case.unit
        drawn = f" (two seeds differ by {chance:.3g}{unit})" if chance > 0 else ""
        row.fail(
            case,
            f"{what}: {case.compared} differ by {gap:.3g}{unit}{case.relative}, expected "
            f"at most {tolerance:g}{unit}{drawn}; {hint}",
        )


def rms(gaps: Floats) -> float:
    """Return the root of the mean square, whatever the scale."""
    # Scaled by the largest, lest the squares of tiny gaps vanish.
    largest = float(np.max(gaps, initial=0.0))
    if largest == 0 or not np.isfinite(largest):
        return largest
    return largest * float(np.sqrt(np.mean((gaps / largest) ** 2)))


def reject_what_is_no_attack(attack: object) -> None:
    """Raise for what cannot be an attack, with what to write instead.

    Raises
    ------
    PluginError
        As `isac_track.plugins` would, when the attack is named on a command line.
    """
    if isinstance(attack, type):
        raise PluginError(f"expected an attack, got its class: write {attack.__name__}()")
    name = type(attack).__name__
    parameters = getattr(type(attack), "__dataclass_params__", None)
    if not dataclasses.is_dataclass(attack) or parameters is None or not parameters.frozen:
        raise PluginError(f"attack {name} must be a frozen dataclass: @dataclass(frozen=True)")
    if not callable(getattr(attack, "fit", None)):
        raise PluginError(f"attack {name} has no method fit(context)")
    for attribute in ("requires", "uses"):
        declared = getattr(attack, attribute, None)
        if not isinstance(declared, frozenset) or not all(
            isinstance(one, Knowledge) for one in declared
        ):
            raise PluginError(
                f"attack {name} needs a class attribute {attribute}: a frozenset of Knowledge, "
                f"got {declared!r}"
            )
    try:
        kind_of(attack)
    except ValueError as error:
        raise PluginError(f"attack {name}: {error}") from None
    if not granted_rows(attack):  # type: ignore[arg-type]  # it has all that a row takes
        raise PluginError(
            f"attack {name} requires REPEATS, which nobody who links is granted: the repeats of a "
            "walk would be linked already"
        )


def granted_rows(
    attack: Attack,
) -> list[tuple[str, frozenset[Knowledge]]]:
    """Return (adversary, what it is granted) of every row that an attack makes here.

    What a linkage attack is granted depends on the task: some show the scene to everyone, the
    others to nobody, and none gives REPEATS. It makes the rows of both sorts, each once.
    """
    if kind_of(attack) == "reconstruction":
        return list(grants(attack).items())
    hidden = frozenset({Knowledge.REPEATS, Knowledge.SCENE})
    shown = frozenset({Knowledge.SCENE})
    made: dict[frozenset[Knowledge], str] = {}
    for everyone, nobody in ((frozenset(), hidden), (shown, hidden - shown)):
        for adversary, granted in grants(attack, everyone=everyone, nobody=nobody).items():
            made.setdefault(granted, adversary)
    return [(adversary, granted) for granted, adversary in made.items()]


def _n_arguments(fitted: object) -> int | None:
    """Return how many arguments a function cannot do without, or None if it does not say."""
    try:
        parameters = inspect.signature(fitted).parameters  # type: ignore[arg-type]  # or TypeError
    except (TypeError, ValueError):
        return None
    positional = {inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD}
    return sum(one.kind in positional and one.default is one.empty for one in parameters.values())


def _place(error: BaseException, attack: object) -> str:
    """Return the last line of the attack's own file on the way to an error."""
    module = sys.modules.get(type(attack).__module__)
    file = getattr(module, "__file__", None)
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == file] or frames[1:]
    return f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
