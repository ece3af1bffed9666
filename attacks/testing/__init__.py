"""The kits: what every attack, mechanism or predictor must do, as named checks.

With pytest, every check of every attack becomes a test of its own::

    @parametrize_attack_checks([MyAttack(), MyAttack(window_s=2.0)])
    def test_attack(attack, check):
        check(attack)

so that ``pytest -k null_stays_at_chance`` runs one of them. From the command line::

    python -m attacks check my_module:MyAttack

`CHECKS` are those of reconstruction attacks, `LINKAGE_CHECKS` those of linkage attacks.
Every check of an attack runs once for each adversary that grants it something else
(`isac_track.protocols.grants`). All draws are seeded: a check never flickers.
"""

import dataclasses
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, TypeAlias, cast
from unittest import SkipTest

from attacks.tasks.task_list import TASKS
from attacks.testing import _checks, _plugin_checks
from attacks.testing._attack_cases import LinkageCase, ReconstructionCase
from attacks.testing._checks import Row
from attacks.testing._releases import copied
from isac_track import plugins, protocols
from isac_track.errors import PluginError, SettingsError
from isac_track.protocols import ADVERSARIES, grants, kind_of
from isac_track.testing import engine
from isac_track.testing.engine import Check
from isac_track.testing.engine import Outcome as CheckResult
from isac_track.types import Knowledge

__all__ = [
    "CHECKS",
    "LINKAGE_CHECKS",
    "MECHANISM_CHECKS",
    "PREDICTOR_CHECKS",
    "CheckResult",
]
__all__ += ["adversaries_of", "checks_for", "parametrize_attack_checks", "run_checks"]
__all__ += ["parametrize_mechanism_checks", "parametrize_predictor_checks"]

Attack: TypeAlias = protocols.ReconstructionAttack | protocols.LinkageAttack
Subject: TypeAlias = Attack | protocols.Mechanism | protocols.Predictor


def _in_every_row(body: engine.Body, subject: Hashable) -> None:
    """Hold the body of a check against every row of a plug-in, or those that it applies to."""
    rows, exempt = _rows(subject), []
    for row in rows:
        try:
            body(row)
        except SkipTest as reason:
            exempt.append(reason)
    if len(exempt) == len(rows):
        raise exempt[-1]


@lru_cache(maxsize=16)
def _rows(subject: Hashable) -> list[Row]:
    """Return the rows of a plug-in, weakest adversary first, as all checks but one run them."""
    world, _ = _WORLDS[_kind(subject)]
    rows = []
    for granted, adversary in _granted(subject).items():
        same_steps = bool(getattr(subject, "one_stretch", False))
        cases = world.ordinary_and_another(granted, same_steps=same_steps)
        row = Row(subject, adversary, granted, granted, *cases)
        try:
            row.raw(copied(row.ordinary))
        except AssertionError:
            # Given everything, lest this one mistake fail all checks and hide the next
            # one.
            row = dataclasses.replace(row, given=row.ordinary.everything)
        rows.append(row)
    return rows


def _granted(
    subject: Any,  # noqa: ANN401 - a stranger's
) -> dict[frozenset[Knowledge], str]:
    """Return the adversary of every row that a plug-in makes here, by what it is granted.

    Of linkage these are the rows of all tasks, each once; no plug-in but attacks has an
    adversary.
    """
    nothing = frozenset[Knowledge]()
    if noun_of(subject) != "attack":
        return {getattr(subject, "requires", nothing): ""}
    tasks = [(nothing, nothing)]
    if kind_of(subject) == "linkage":
        tasks = [(task.everyone, task.nobody) for task in TASKS.values()]
    made: dict[frozenset[Knowledge], str] = {}
    for everyone, nobody in tasks:
        for adversary, granted in grants(
            subject, everyone=everyone, nobody=nobody
        ).items():
            made.setdefault(granted, adversary)
    if not made:
        why = (
            "which nobody who links is granted: the repeats of a walk would be linked"
            " already"
        )
        raise PluginError(f"attack {type(subject).__name__} requires REPEATS, {why}")
    return made


_WORLDS: dict[str, tuple[Any, Mapping[str, engine.Body]]] = {
    "reconstruction": (ReconstructionCase, _checks.RECONSTRUCTION),
    "linkage": (LinkageCase, _checks.LINKAGE),
    "mechanism": (_plugin_checks.MechanismCase, _plugin_checks.MECHANISM),
    "predictor": (_plugin_checks.PredictorCase, _plugin_checks.PREDICTOR),
}  # What makes up the cases of each kind of plug-in, and what holds for it.
_KITS = {
    kind: {
        name: Check(name, engine.statement_of(one), partial(_in_every_row, one))
        for name, one in bodies.items()
    }
    for kind, (_, bodies) in _WORLDS.items()
}
# All checks of each kind by name, in the order in which they run.
CHECKS, LINKAGE_CHECKS, MECHANISM_CHECKS, PREDICTOR_CHECKS = _KITS.values()
_NOUNS = {"fit": "attack", "share": "mechanism", "predict": "predictor"}


def noun_of(subject: object) -> str:
    """Return what somebody's object is, by its method; an attack if nothing says otherwise."""
    return next(
        (noun for method, noun in _NOUNS.items() if hasattr(subject, method)), "attack"
    )


def _kind(subject: object) -> str:
    noun = noun_of(subject)
    return kind_of(subject) if noun == "attack" else noun


def checks_for(subject: Any) -> dict[str, Check]:  # noqa: ANN401 - a stranger's
    """Return the checks of a plug-in of this kind by name, in the order in which they run.

    It is a PluginError, with what to write instead, if it is no plug-in at all.
    """
    noun = noun_of(subject)
    if isinstance(subject, type):
        raise PluginError(
            f"expected an object, got its class: write {subject.__name__}()"
        )
    kind, name = cast("plugins.Kind", f"{noun}s"), f"{noun} {type(subject).__name__}"
    plugins.check_class(kind, type(subject), name)
    plugins.check_declared(kind, subject, name)
    _granted(subject)
    return _KITS[_kind(subject)]


def adversaries_of(attack: Attack) -> tuple[str, ...]:
    """Return the names of the adversaries whose rows an attack makes, weakest first.

    Of a linkage attack those of a task that shows what it requires. Raises as
    `checks_for`.
    """
    named = _granted(attack).values()
    return tuple(adversary for adversary in ADVERSARIES if adversary in named)


def run_checks(
    subject: Subject, *, names: Sequence[str] | None = None
) -> tuple[CheckResult, ...]:
    """Run all checks on a plug-in, or those called `names`; one that fails ends nothing.

    Raises as `checks_for`, and SettingsError for a check that does not exist.
    """
    checks = checks_for(subject)
    kit = f" of a {_kind(subject)}{' attack' * (noun_of(subject) == 'attack')}"
    chosen = engine.select(checks, names, kit=kit, known=f"known: {', '.join(checks)}")
    return tuple(engine.outcomes(chosen, subject))


def _parametrized(noun: str, subjects: Iterable[Subject]) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    cases = [
        (f"{_label(subject)}-{name}", (subject, check))
        for subject in subjects
        for name, check in checks_for(subject).items()
    ]
    if not cases:
        raise SettingsError(f"no {noun} to check: the list is empty")
    return engine.parametrize(f"{noun},check", cases)


parametrize_attack_checks = partial(_parametrized, "attack")
"""Return a pytest decorator that runs a test once per attack and check.

The test takes `attack` and `check`, and calls ``check(attack)``. A check that does not
apply to an attack is skipped, with the reason. Attacks are instances. Raises as
`checks_for`, and SettingsError without any attack. The two below do the same for
mechanisms and predictors.
"""
parametrize_mechanism_checks = partial(_parametrized, "mechanism")
parametrize_predictor_checks = partial(_parametrized, "predictor")


def _label(subject: Any) -> str:  # noqa: ANN401 - a frozen dataclass
    """Return the class, with the parameters that differ from their defaults."""
    held = [
        (one, getattr(subject, one.name))
        for one in dataclasses.fields(subject)
        if one.init
    ]
    changed = [
        f"{one.name}={value}" for one, value in held if repr(value) != repr(one.default)
    ]
    return type(subject).__name__ + (f"({','.join(changed)})" if changed else "")
