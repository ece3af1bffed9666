"""The kits: named checks that every attack, mechanism, or other plug-in passes.

With pytest, every check of every plug-in becomes a test of its own::

    test_my_attack = kit_test(MyAttack(), MyAttack(window_s=2.0))

so that ``pytest -k null_stays_at_chance`` runs one of them. From the command line::

    python -m attacks check my_module:MyAttack

`CHECKS` are those of reconstruction attacks, `LINKAGE_CHECKS` those of linkage attacks.
Every check of an attack runs once for each adversary that grants it another knowledge
(`isac_track.protocols.grants`). All draws are seeded: a check always has one result.
"""

import dataclasses
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, TypeAlias
from unittest import SkipTest

from attacks.tasks.task_list import TASKS
from attacks.testing import _checks, _plugin_checks, _policy_checks, _tracker_checks
from attacks.testing._attack_cases import LinkageCase, ReconstructionCase
from attacks.testing._checks import Row
from attacks.testing._releases import copied
from isac_track import plugins, protocols
from isac_track.errors import PluginError, SettingsError
from isac_track.protocols import (
    ADVERSARIES,
    attack_kind,
    grants,
    links_same_stretch,
)
from isac_track.renamed import renamed
from isac_track.testing import engine
from isac_track.testing.engine import Check
from isac_track.testing.engine import Outcome as CheckResult
from isac_track.tracking.methods import REFERENCE_TYPES
from isac_track.types import Knowledge

__all__ = [
    "CHECKS",
    "LINKAGE_CHECKS",
    "MECHANISM_CHECKS",
    "POLICY_CHECKS",
    "PREDICTOR_CHECKS",
    "TRACKER_CHECKS",
    "CheckResult",
    "checks_for",
    "kit_test",
    "list_adversaries",
    "parametrize_attack_checks",
    "parametrize_mechanism_checks",
    "parametrize_policy_checks",
    "parametrize_predictor_checks",
    "parametrize_tracker_checks",
    "run_checks",
]

Attack: TypeAlias = protocols.ReconstructionAttack | protocols.LinkageAttack
Subject: TypeAlias = (
    Attack
    | protocols.Mechanism
    | protocols.Predictor
    | protocols.Policy
    | protocols.Tracker
)


def _in_every_row(body: engine.Body, subject: Hashable) -> None:
    """Run the body of a check on every row of a plug-in to which it applies.

    SkipTest if it applies to none.
    """
    rows, exempt = _rows(subject), []
    for row in rows:
        try:
            body(row)
        except SkipTest as reason:
            exempt.append(reason)
    if len(exempt) == len(rows):
        raise exempt[-1]


# Of the newest plug-ins; the 17th makes the oldest go.
@lru_cache(maxsize=16)
def _rows(subject: Hashable) -> list[Row]:
    """Return the rows of a plug-in, weakest adversary first, for nearly all checks.

    The exception is `only_granted_knowledge_is_touched`.
    """
    case_type = _CASE_TYPES[_kind(subject)]
    rows = []
    for granted, adversary in _granted(subject).items():
        same_steps = links_same_stretch(subject)
        ordinary, another = case_type.ordinary_and_another(
            granted, same_steps=same_steps
        )
        row = Row(subject, adversary, granted, granted, ordinary, another)
        try:
            row.raw(copied(row.ordinary))
        except AssertionError:
            # Give everything, so that this mistake does not fail all other checks.
            row = dataclasses.replace(row, given=row.ordinary.everything)
        rows.append(row)
    return rows


def _granted(
    subject: Any,  # noqa: ANN401 - a stranger's
) -> dict[frozenset[Knowledge], str]:
    """Return the adversary of every row of a plug-in, by the granted knowledge.

    For linkage these are the rows of all tasks, each once. Others have no
    adversary.
    """
    nothing = frozenset[Knowledge]()
    if plugin_noun(subject) != "attack":
        return {getattr(subject, "requires", nothing): ""}
    tasks = [(nothing, nothing)]
    if attack_kind(subject) == "linkage":
        tasks = [(task.granted_to_all, task.granted_to_none) for task in TASKS.values()]
    adversary_by_grant: dict[frozenset[Knowledge], str] = {}
    for everyone, nobody in tasks:
        for adversary, granted in grants(
            subject, everyone=everyone, nobody=nobody
        ).items():
            adversary_by_grant.setdefault(granted, adversary)
    if not adversary_by_grant:
        why = (
            "which nobody who links is granted: the repeats of a walk would be linked"
            " already"
        )
        raise PluginError(f"attack {type(subject).__name__} requires REPEATS, {why}")
    return adversary_by_grant


def _make_kit(bodies: Mapping[str, engine.Body]) -> dict[str, Check]:
    """Return checks by name, each of which runs in every row of a plug-in."""
    return {
        name: Check(name, engine.read_statement(body), partial(_in_every_row, body))
        for name, body in bodies.items()
    }


# The checks of each kind of plug-in by name, in the order in which they run.
CHECKS = _make_kit(_checks.RECONSTRUCTION)
LINKAGE_CHECKS = _make_kit(_checks.LINKAGE)
MECHANISM_CHECKS = _make_kit(_plugin_checks.MECHANISM)
PREDICTOR_CHECKS = _make_kit(_plugin_checks.PREDICTOR)
POLICY_CHECKS = _make_kit(_policy_checks.POLICY)
TRACKER_CHECKS = _make_kit(_tracker_checks.TRACKER)
_KITS = {
    "reconstruction": CHECKS,
    "linkage": LINKAGE_CHECKS,
    "mechanism": MECHANISM_CHECKS,
    "predictor": PREDICTOR_CHECKS,
    "policy": POLICY_CHECKS,
    "tracker": TRACKER_CHECKS,
}
_CASE_TYPES: dict[str, Any] = {
    "reconstruction": ReconstructionCase,
    "linkage": LinkageCase,
    "mechanism": _plugin_checks.MechanismCase,
    "predictor": _plugin_checks.PredictorCase,
    "policy": _policy_checks.PolicyCase,
    "tracker": _tracker_checks.TrackerCase,
}
_NOUNS = {
    "fit": "attack",
    "share": "mechanism",
    "predict": "predictor",
    "select": "policy",
    "track": "tracker",
}


def plugin_noun(subject: object) -> str:
    """Return the kind of a plug-in by its method; by default it is an attack.

    Predictors and attacks, which declare `requires`, may have a method `track`, too.
    """
    for method, noun in _NOUNS.items():
        if noun == "tracker" and hasattr(subject, "requires"):
            continue
        if callable(getattr(subject, method, None)):
            return noun
    return "attack"


def _kind(subject: object) -> str:
    noun = plugin_noun(subject)
    return attack_kind(subject) if noun == "attack" else noun


def checks_for(subject: Any) -> dict[str, Check]:  # noqa: ANN401 - a stranger's
    """Return the checks of a plug-in of this kind by name, in the order of their runs.

    PluginError, with advice, if the object is no plug-in.
    """
    noun = plugin_noun(subject)
    if isinstance(subject, type):
        raise PluginError(
            f"expected an object, got its class: write {subject.__name__}()"
        )
    kind, name = plugins.KIND_BY_NOUN[noun], f"{noun} {type(subject).__name__}"
    plugins.check_class(kind, type(subject), name)
    plugins.check_declared(kind, subject, name)
    if isinstance(subject, REFERENCE_TYPES):
        raise PluginError(f"{name} reads the truth: it is a reference, no plug-in")
    _granted(subject)
    return _KITS[_kind(subject)]


def list_adversaries(attack: Attack) -> tuple[str, ...]:
    """Return the names of the adversaries for whom an attack runs, weakest first.

    For a linkage attack these are the adversaries of all tasks that show what it
    requires. Raises as `checks_for`.
    """
    named = _granted(attack).values()
    return tuple(adversary for adversary in ADVERSARIES if adversary in named)


def run_checks(
    subject: Subject, *, names: Sequence[str] | None = None
) -> tuple[CheckResult, ...]:
    """Run all checks on a plug-in, or those called `names`; none ends the run.

    Parameters
    ----------
    subject : attack, mechanism, predictor, policy or tracker
        An object, not its class. Its method decides which kit checks it: ``fit``,
        ``share``, ``predict``, ``select`` or ``track``.
    names : sequence of str, optional
        Checks to run, by default all of the kit.

    Returns
    -------
    tuple of CheckResult
        For each check its `name`, its `status` (``passed``, ``failed`` or ``skipped``)
        and a `message`: the counterexample of a failure, or the reason of a skip.

    Raises
    ------
    PluginError
        If the object is no plug-in, with advice.
    SettingsError
        For a check that does not exist.

    Examples
    --------
    >>> from attacks.testing import run_checks
    >>> from isac_track.sharing import Fixed
    >>> results = run_checks(Fixed(0.5))
    >>> [result.name for result in results if result.status == "failed"]
    []
    """
    checks = checks_for(subject)
    kit = f" of a {_kind(subject)}"
    if plugin_noun(subject) == "attack":
        kit += " attack"
    chosen = engine.select(checks, names, kit=kit, known=f"known: {', '.join(checks)}")
    return tuple(engine.outcomes(chosen, subject))


def kit_test(*subjects: Subject) -> Any:  # noqa: ANN401 - a pytest mark; pytest is not imported here
    """Return a test that pytest runs once for each plug-in and check of its kit.

    Parameters
    ----------
    *subjects : attack, mechanism, predictor, policy or tracker
        Objects, not their classes; of different kinds if you like. A check that does
        not apply to an object is skipped, with the reason.

    Returns
    -------
    function
        Give it a name that pytest collects: it begins with ``test``.

    Raises
    ------
    PluginError
        If an object is no plug-in, with advice.
    SettingsError
        Without any object.

    Examples
    --------
    >>> from attacks.testing import kit_test
    >>> from isac_track.sharing import Fixed
    >>> test_fixed_noise = kit_test(Fixed(0.5), Fixed(0.5, adding="independent"))
    """

    def test(plugin: Subject, check: Check) -> None:
        check(plugin)

    return _parametrized("plugin", subjects)(test)


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

The test takes `attack` and `check`, and calls ``check(attack)``: for a test of your own
body or with marks. Else `kit_test` is shorter. The four below do the same for
mechanisms, predictors, policies and trackers.
"""
parametrize_mechanism_checks = partial(_parametrized, "mechanism")
parametrize_predictor_checks = partial(_parametrized, "predictor")
parametrize_policy_checks = partial(_parametrized, "policy")
parametrize_tracker_checks = partial(_parametrized, "tracker")


def _label(subject: Any) -> str:  # noqa: ANN401 - a frozen dataclass
    """Return the class, with the parameters that differ from their defaults."""
    changed = []
    for item in dataclasses.fields(subject):
        if item.init:
            value = getattr(subject, item.name)
            if repr(value) != repr(item.default):
                changed.append(f"{item.name}={value}")
    name = type(subject).__name__
    return f"{name}({','.join(changed)})" if changed else name


if not TYPE_CHECKING:  # type checkers are to know the names that are
    __getattr__ = renamed(__name__, {"adversaries_of": "list_adversaries"})
