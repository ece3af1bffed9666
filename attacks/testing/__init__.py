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
from functools import partial
from typing import TYPE_CHECKING, Any

from attacks.testing import _linkage_checks, _reconstruction_checks
from attacks.testing._rows import granted_rows, in_every_row, reject_what_is_no_attack
from isac_track.errors import PluginError, SettingsError
from isac_track.protocols import ADVERSARIES, kind_of
from isac_track.testing import engine
from isac_track.testing.engine import Check
from isac_track.testing.engine import Outcome as CheckResult

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from attacks.testing._rows import Attack, Row

__all__ = [
    "CHECKS",
    "LINKAGE_CHECKS",
    "CheckResult",
    "adversaries_of",
    "checks_for",
    "parametrize_attack_checks",
    "run_checks",
]


def _kit(bodies: Iterable[Callable[[Row], None]]) -> dict[str, Check]:
    return {
        body.__name__: Check(
            name=body.__name__,
            statement=engine.statement_of(body),
            body=partial(in_every_row, body),
        )
        for body in bodies
    }


CHECKS = _kit(_reconstruction_checks.ALL)
"""All checks of reconstruction attacks by name, in the order in which they run."""

LINKAGE_CHECKS = _kit(_linkage_checks.ALL)
"""All checks of linkage attacks by name, in the order in which they run."""


def checks_for(attack: Attack) -> dict[str, Check]:
    """Return the checks of an attack of this kind by name, in the order in which they run.

    Raises
    ------
    PluginError
        If it is no attack at all.
    """
    reject_what_is_no_attack(attack)
    return dict(LINKAGE_CHECKS if kind_of(attack) == "linkage" else CHECKS)


def adversaries_of(attack: Attack) -> tuple[str, ...]:
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


def run_checks(attack: Attack, *, names: Sequence[str] | None = None) -> tuple[CheckResult, ...]:
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
    kit, known = f" of a {kind_of(attack)} attack", f"known: {', '.join(checks)}"
    return tuple(engine.outcomes(engine.select(checks, names, kit=kit, known=known), attack))


def parametrize_attack_checks(
    attacks: Iterable[Attack],
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
    if not isinstance(attacks, Iterable):
        raise PluginError(
            f"expected a list of attacks, got {attacks!r}: write parametrize_attack_checks([...])"
        )
    given = list(attacks)
    if not given:
        raise SettingsError("no attack to check: the list is empty")
    cases = (
        (f"{_label(attack)}-{name}", (attack, check))
        for attack in given
        for name, check in checks_for(attack).items()
    )
    return engine.parametrize("attack,check", cases)


def _label(attack: Any) -> str:  # noqa: ANN401 - a frozen dataclass
    """Return the class, with the parameters that differ from their defaults."""
    changed = [
        f"{item.name}={getattr(attack, item.name)}"
        for item in dataclasses.fields(attack)
        if item.init and repr(getattr(attack, item.name)) != repr(item.default)
    ]
    name = type(attack).__name__
    return f"{name}({','.join(changed)})" if changed else name
