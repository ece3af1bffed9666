"""What a check is made of: running an attack as one adversary, reading and comparing results."""

from __future__ import annotations

import dataclasses
import inspect
import sys
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from attacks.testing._cases import copied, ordinary, without_sigma
from attacks.testing._releases import EPSILON_M, copied_release
from isac_track.errors import PluginError, told
from isac_track.protocols import AttackContext, grants, kind_of
from isac_track.rng import stream
from isac_track.types import Knowledge

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from attacks.testing._cases import Case
    from isac_track.protocols import LinkageAttack, ReconstructionAttack
    from isac_track.types import Floats, Release

SPREADS = 3.0
"""Two runs of an attack that draws may differ by so many times what two seeds differ by."""
_GIVES = {
    "reconstruction": (1, "from a release to a reconstruction"),
    "linkage": (2, "from two releases, probe and gallery, to a matrix of scores"),
}
"""How many releases the function from `fit` takes, and what it is."""


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """What an attack returned, read as arrays."""

    xy: Floats
    """(M, 2) m"""
    std: Floats | None
    """(M,) m"""


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """An attack as one adversary runs it."""

    attack: ReconstructionAttack
    adversary: str
    granted: frozenset[Knowledge]
    """What the adversary grants it."""
    given: frozenset[Knowledge]
    """What it is given here: all there is, if it cannot keep to what it was granted."""

    def __str__(self) -> str:
        knows = ", ".join(sorted(one.name for one in self.granted)) or "nothing"
        return f"{type(self.attack).__name__} as {self.adversary} (granted {knows})"

    def raw(self, case: Case, *, seed: int = 0) -> object:
        """Return whatever the attack returns for the release of a case, on copies of all arrays."""
        (result,) = run(self.attack, copied(case), granted=self.given, seed=seed, who=str(self))
        return result

    def estimate(self, case: Case, *, seed: int = 0) -> Estimate:
        """Return what the attack makes of the release of a case."""
        return read(self.raw(case, seed=seed), case, who=str(self))

    def estimates(self, case: Case, releases: Sequence[Release]) -> list[Estimate]:
        """Return what one call of `fit`, for the case, makes of several releases in turn."""
        results = run(
            self.attack,
            copied(case),
            granted=self.given,
            who=str(self),
            releases=[copied_release(release) for release in releases],
        )
        return [
            read(result, replace(case, release=release), who=str(self))
            for result, release in zip(results, releases, strict=True)
        ]


def strict_rows(attack: ReconstructionAttack) -> Iterator[Row]:
    """Yield the rows of an attack, weakest adversary first, given what they are granted."""
    for adversary, granted in granted_rows(attack):
        yield Row(attack=attack, adversary=adversary, granted=granted, given=granted)


def rows(attack: ReconstructionAttack) -> Iterator[Row]:
    """Yield the rows of an attack as all checks but one run them.

    An attack that touches what it was not granted fails the check about that. In all others it
    is given everything, or that one mistake would fail them all and hide the next one.
    """
    for row in strict_rows(attack):
        try:
            row.raw(ordinary())
        except AssertionError:
            yield replace(row, given=frozenset(Knowledge))
        else:
            yield row


def run(
    attack: ReconstructionAttack,
    case: Case,
    *,
    granted: frozenset[Knowledge],
    who: str,
    seed: int = 0,
    releases: Sequence[Release] | None = None,
) -> list[object]:
    """Return whatever an attack returns for each release, given what was granted and no more.

    The context is that of the case; the releases are its own one, unless others are given.

    Raises
    ------
    AssertionError
        For anything that the attack raises, with the line that did.
    """
    asked = [case.release] if releases is None else list(releases)
    if Knowledge.SIGMA not in granted:
        case = without_sigma(case)
        asked = [release.without_sigma() for release in asked]
    context = AttackContext(
        rng=stream(seed, "attacks", "testing", "attack"),
        epsilon_m=EPSILON_M,
        granted=granted,
        mechanism=case.mechanism,
        train=case.train,
        repeats=case.repeats,
    )
    return answers(attack, context, [(release,) for release in asked], who=f"{who}, {case.about}")


def answers(
    attack: ReconstructionAttack | LinkageAttack,
    context: AttackContext,
    asked: Sequence[tuple[Release, ...]],
    *,
    who: str,
) -> list[object]:
    """Return what the function from one call of `fit` answers, question by question.

    Raises
    ------
    AssertionError
        For anything that the attack raises, with the line that did.
    """
    n_releases, gives = _GIVES[kind_of(attack)]
    doing, fitted = "fit(context)", None
    try:
        fitted = attack.fit(context)
        if not callable(fitted):
            raise TypeError(  # noqa: TRY301 - reported as what the attack raises
                f"fit must return a function {gives}, got {fitted!r}"
            )
        doing = "the function from fit"
        return [fitted(*releases) for releases in asked]
    except (Exception, SystemExit) as error:
        hint = ""
        if isinstance(error, TypeError) and _n_arguments(fitted) == 3 - n_releases:
            hint = f"; it takes a function {gives}: which `kind` is the attack?"
        raise AssertionError(
            f"{who}: {doing} raised {told(error)}{_place(error, attack)}{hint}"
        ) from error


def read(result: Any, case: Case, *, who: str) -> Estimate:  # noqa: ANN401 - a stranger's
    """Return a result as arrays; positions alone will do, the check of the type is another one.

    Raises
    ------
    AssertionError
        If it is not one finite position per sample.
    """
    expected = case.release.xy.shape
    try:
        xy = np.asarray(getattr(result, "xy", result), dtype=np.float64)
    except (TypeError, ValueError):
        raise AssertionError(
            f"{who}, {case.about}: expected a Reconstruction, got {type(result).__name__}"
        ) from None
    if xy.shape != expected:
        raise AssertionError(
            f"{who}, {case.about}: positions of shape {xy.shape}, expected {expected}: one for "
            "every sample of the release, in its order"
        )
    if not np.isfinite(xy).all():
        raise AssertionError(
            f"{who}, {case.about}: {np.count_nonzero(~np.isfinite(xy).all(axis=1))} of "
            f"{len(xy)} positions are not finite"
        )
    std = getattr(result, "std", None) if hasattr(result, "xy") else None  # arrays have a std()
    return Estimate(xy=xy, std=None if std is None else np.asarray(std, dtype=np.float64))


def expect_same(
    row: Row,
    case: Case,
    *,
    got: Estimate,
    expected: Estimate,
    tolerance_m: float,
    what: str,
    hint: str,
) -> None:
    """Fail if two results differ by more than rounding, or than chance if the attack draws.

    An attack that draws is compared with itself under another seed: of its draws, a check can
    only ask that they have the same spread.
    """
    plain = row.estimate(case)
    other = row.estimate(case, seed=1)
    chance_m = _rms_m(plain, other)
    gap_m = _rms_m(got, expected) if chance_m > 0 else _largest_m(got, expected)
    if gap_m > tolerance_m + SPREADS * chance_m:
        drawn = f" (two seeds differ by {chance_m:.3g} m)" if chance_m > 0 else ""
        raise AssertionError(
            f"{row}, {case.about}: {what}: positions or std differ by {gap_m:.3g} m, expected "
            f"at most {tolerance_m:g} m{drawn}; {hint}"
        )


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
    attack: ReconstructionAttack | LinkageAttack,
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


def _largest_m(first: Estimate, second: Estimate) -> float:
    return max((float(np.max(part)) for part in _gaps(first, second)), default=0.0)


def _rms_m(first: Estimate, second: Estimate) -> float:
    return max(rms(part) for part in _gaps(first, second))


def rms(gaps: Floats) -> float:
    """Return the root of the mean square, whatever the scale."""
    # Scaled by the largest, lest the squares of tiny gaps vanish.
    largest = float(np.max(gaps, initial=0.0))
    if largest == 0 or not np.isfinite(largest):
        return largest
    return largest * float(np.sqrt(np.mean((gaps / largest) ** 2)))


def _gaps(first: Estimate, second: Estimate) -> list[Floats]:
    gaps: list[Floats] = [np.hypot(*(first.xy - second.xy).T)]
    if first.std is not None and second.std is not None and first.std.shape == second.std.shape:
        gaps.append(np.abs(first.std - second.std))
    elif (first.std is None) != (second.std is None):
        gaps.append(np.array([np.inf]))
    return gaps


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
