"""The attack kit: what every reconstruction attack must do, as named checks.

With pytest, every check of every attack becomes a test of its own::

    @parametrize_attack_checks([MyAttack(), MyAttack(window_s=2.0)])
    def test_attack(attack, check):
        check(attack)

so that ``pytest -k null_stays_at_chance`` runs one of them. From the command line::

    python -m attacks check my_module:MyAttack

Every check runs once for each adversary that grants the attack something else
(`isac_track.protocols.grants`). All draws are seeded: a check never flickers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Literal
from unittest import SkipTest

from attacks.testing._checks import CHECKS
from attacks.testing._kit import reject_what_is_no_attack
from isac_track.errors import PluginError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from isac_track.protocols import ReconstructionAttack

__all__ = ["CHECKS", "CheckResult", "parametrize_attack_checks", "run_checks"]


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


def run_checks(
    attack: ReconstructionAttack, *, names: Sequence[str] | None = None
) -> tuple[CheckResult, ...]:
    """Run the checks on an attack; one that fails ends nothing.

    Parameters
    ----------
    attack : ReconstructionAttack
    names : sequence of str, optional
        Only these checks; by default all.

    Raises
    ------
    PluginError
        If it is no attack at all.
    SettingsError
        For a check that does not exist.
    """
    reject_what_is_no_attack(attack)
    for name in names or ():
        if name not in CHECKS:
            near = get_close_matches(name, CHECKS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(CHECKS)}"
            raise SettingsError(f"unknown check {name!r}; {hint}")
    return tuple(_result(name, attack) for name in (CHECKS if names is None else names))


def parametrize_attack_checks(attacks: Iterable[ReconstructionAttack]) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a pytest decorator that runs a test once per attack and check.

    The test takes `attack` and `check`, and calls ``check(attack)``. A check that does not
    apply to an attack is skipped, with the reason.

    Parameters
    ----------
    attacks : iterable of ReconstructionAttack
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
    for attack in given:
        reject_what_is_no_attack(attack)
    return pytest.mark.parametrize(
        ("attack", "check"),
        [
            pytest.param(attack, check, id=f"{_label(attack)}-{name}")
            for attack in given
            for name, check in CHECKS.items()
        ],
    )


def _result(name: str, attack: ReconstructionAttack) -> CheckResult:
    try:
        CHECKS[name](attack)
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
