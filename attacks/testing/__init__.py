"""The attack kit: what every attack must do, as named checks for either kind.

With pytest, every check of every attack becomes a test of its own::

    @parametrize_attack_checks([MyAttack(), MyAttack(window_s=2.0)])
    def test_attack(attack, check):
        check(attack)

so that ``pytest -k null_stays_at_chance`` runs one of them. From the command line::

    python -m attacks check my_module:MyAttack

`CHECKS` are those of reconstruction attacks, `LINKAGE_CHECKS` those of linkage attacks; which of
them an attack gets goes by its kind (`isac_track.protocols.kind_of`). Every check runs once for
each adversary that grants the attack something else (`isac_track.protocols.grants`). All draws
are seeded: a check never flickers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Literal
from unittest import SkipTest

from attacks.testing._checks import CHECKS
from attacks.testing._kit import granted_rows, reject_what_is_no_attack
from attacks.testing._linkage_checks import LINKAGE_CHECKS
from isac_track.errors import PluginError, SettingsError
from isac_track.protocols import ADVERSARIES, kind_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from isac_track.protocols import LinkageAttack, ReconstructionAttack

__all__ = [
    "CHECKS",
    "LINKAGE_CHECKS",
    "CheckResult",
    "adversaries_of",
    "checks_for",
    "parametrize_attack_checks",
    "run_checks",
]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What became of one check."""

    name: str
    status: Literal["passed", "failed", "skipped"]
    message: str = ""
    """What was expected and what came, or why the check does not apply."""

    @property
    def passed(self) -> bool:
        """Whether the check ran and what it states holds."""
        return self.status == "passed"


def checks_for(
    attack: ReconstructionAttack | LinkageAttack,
) -> dict[str, Callable[[Any], None]]:
    """Return the checks of an attack of this kind by name, in the order in which they run.

    Raises
    ------
    PluginError
        If it is no attack at all.
    """
    reject_what_is_no_attack(attack)
    return dict(LINKAGE_CHECKS if kind_of(attack) == "linkage" else CHECKS)


def adversaries_of(attack: ReconstructionAttack | LinkageAttack) -> tuple[str, ...]:
    """Return the names of the adversaries whose rows an attack makes, weakest first.

    Those of a linkage attack are the adversaries of a task that shows what it requires: SCENE is
    then granted to everyone.

    Raises
    ------
    PluginError
        If it is no attack at all.
    """
    reject_what_is_no_attack(attack)
    named = {adversary for adversary, _ in granted_rows(attack)}
    return tuple(adversary for adversary in ADVERSARIES if adversary in named)


def run_checks(
    attack: ReconstructionAttack | LinkageAttack, *, names: Sequence[str] | None = None
) -> tuple[CheckResult, ...]:
    """Run the checks on an attack; one that fails ends nothing.

    Parameters
    ----------
    attack : ReconstructionAttack or LinkageAttack
    names : sequence of str, optional
        Only these checks; by default all.

    Raises
    ------
    PluginError
        If it is no attack at all.
    SettingsError
        For a check that does not exist.
    """
    checks = checks_for(attack)
    for name in names or ():
        if name not in checks:
            near = get_close_matches(name, checks, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(checks)}"
            raise SettingsError(f"unknown check {name!r} of a {kind_of(attack)} attack; {hint}")
    return tuple(
        _result(name, checks[name], attack) for name in (checks if names is None else names)
    )


def parametrize_attack_checks(
    attacks: Iterable[ReconstructionAttack | LinkageAttack],
) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once per attack and check.

    The test takes `attack` and `check`, and calls ``check(attack)``. A check that does not
    apply to an attack is skipped, with the reason.

    Parameters
    ----------
    attacks : iterable of ReconstructionAttack or LinkageAttack
        Instances; one attack may come several times, with different parameters.

    Raises
    ------
    PluginError
        If one of them is no attack, with what to write instead.
    SettingsError
        Without any attack.
    """
    import pytest  # noqa: PLC0415 - only those who test with pytest need it

    if not isinstance(attacks, Iterable):
        raise PluginError(
            f"expected a list of attacks, got {attacks!r}: write parametrize_attack_checks([...])"
        )
    given = list(attacks)
    if not given:
        raise SettingsError("no attack to check: the list is empty")
    return pytest.mark.parametrize(
        ("attack", "check"),
        [
            pytest.param(attack, check, id=f"{_label(attack)}-{name}")
            for attack in given
            for name, check in checks_for(attack).items()
        ],
    )


def _result(name: str, check: Callable[[Any], None], attack: object) -> CheckResult:
    try:
        check(attack)
    except AssertionError as error:
        return CheckResult(name=name, status="failed", message=str(error))
    except SkipTest as reason:
        return CheckResult(name=name, status="skipped", message=str(reason))
    return CheckResult(name=name, status="passed")


def _label(attack: Any) -> str:  # noqa: ANN401 - a frozen dataclass
    """Return the class, with the parameters that differ from their defaults."""
    changed = [
        f"{item.name}={getattr(attack, item.name)}"
        for item in dataclasses.fields(attack)
        if item.init and repr(getattr(attack, item.name)) != repr(item.default)
    ]
    name = type(attack).__name__
    return f"{name}({','.join(changed)})" if changed else name
