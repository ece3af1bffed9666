"""Plug-ins by name: built-ins, entry points, and ``package.module:Class`` on the command line.

SPEC is ``name[:VALUE][,key=value...]``. VALUE sets the first field; for a mechanism that is the
level. ``fid:1..1000/10`` is a sweep of ten levels, spaced as the class says (``sweep``).
Parameters that differ from their default stay in the name: ``fid:adding=independent``.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import sys
import types
from dataclasses import dataclass
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import (
    TYPE_CHECKING,
    Any,
    Literal,
    TypeAlias,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from isac_track.command_line import may_be_ctrl_c
from isac_track.errors import IsacTrackError, PluginError, SettingsError, told

if TYPE_CHECKING:
    from isac_track.types import Knowledge

Kind: TypeAlias = Literal["mechanisms", "predictors", "attacks"]

_BUILT_IN: dict[Kind, dict[str, str]] = {
    "predictors": {
        "least_squares": "predictors.least_squares:LeastSquares",
        "kalman_cv": "predictors.kalman:KalmanCV",
        "kalman_ca": "predictors.kalman:KalmanCA",
        "kalman_imm": "predictors.kalman:KalmanIMM",
    },
    "attacks": {
        "identity": "attacks.reconstruction.identity:Identity",
        "moving_average": "attacks.reconstruction.moving_average:MovingAverage",
        "savgol": "attacks.reconstruction.savgol:Savgol",
        "kalman_rts": "attacks.reconstruction.kalman_rts:KalmanRTS",
        "radial_rts": "attacks.reconstruction.radial_rts:RadialRTS",
        "imm_rts": "attacks.reconstruction.imm_rts:ImmRTS",
        "gaussian_process": "attacks.reconstruction.gaussian_process:GaussianProcess",
        "averaging": "attacks.reconstruction.averaging:Averaging",
        "shape": "attacks.linkage.shape:Shape",
        "profile": "attacks.linkage.profile:Profile",
        "dtw": "attacks.linkage.dtw:DTW",
        "behaviour": "attacks.linkage.behaviour:Behaviour",
        "histogram": "attacks.linkage.histogram:Histogram",
        "kinematic": "attacks.linkage.kinematic:Kinematic",
    },
}
_MECHANISMS = ("isac_track.sharing", "isac_track.sharing_controls")
"""Modules with a table ``MECHANISMS``: one that is added there is known here."""
_METHOD: dict[Kind, str] = {"mechanisms": "share", "predictors": "predict", "attacks": "fit"}
_MOST_LEVELS = 1000
_MOST_SHOWN = 100
"""Characters of what a user typed."""
_WHOLE_LIMIT = 10**18
_LEVEL_LIMIT = 10**12
"""Of a level that is a whole number: names show 12 digits."""
_SINGULAR: dict[Kind, str] = {
    "mechanisms": "mechanism",
    "predictors": "predictor",
    "attacks": "attack",
}


@dataclass(frozen=True, slots=True)
class Plugin:
    """One configured plug-in: a mechanism at one level, a predictor or an attack."""

    name: str
    """As in the result columns: family and non-default parameters, without the level."""
    level: float | None
    """Level of a mechanism; None where it has none or it is not a number."""
    spec: str
    """Canonical SPEC that gives this very plug-in again."""
    origin: str
    """``module:Class``"""
    instance: Any
    """The frozen object."""
    family: str = ""
    """Its name without parameters."""
    adding: str = ""
    """Adding rule that a mechanism declares; empty if it has none."""


def names(kind: Kind) -> dict[str, str]:
    """Return ``{name: "module:Class"}`` of built-ins and entry points.

    None of them is imported but the built-in mechanisms.
    """
    known = dict(_BUILT_IN.get(kind, {}))
    if kind == "mechanisms":
        for module in _MECHANISMS:
            table = importlib.import_module(module).MECHANISMS
            known |= {name: f"{module}:{cls.__name__}" for name, cls in table.items()}
    for point in _entry_points(kind):
        known.setdefault(point.name, point.value)
    return known


def broken(kind: Kind) -> dict[str, str]:
    """Import every discovered third-party plug-in and return ``{name: what is wrong}``."""
    wrong = {}
    for point in _entry_points(kind):
        try:
            _load(kind, point.name)
        except PluginError as error:
            wrong[point.name] = str(error)
    return wrong


def parse(kind: Kind, spec: str) -> tuple[Plugin, ...]:
    """Return the plug-ins that a SPEC names: one, or one per level of a sweep.

    Raises
    ------
    SettingsError
        For a name, parameter or value that does not exist or does not fit.
    PluginError
        If the plug-in cannot be imported or is not what its kind must be.
    """
    name, value, options = _split(kind, spec)
    cls, origin = _load(kind, name)
    hints = _hints(cls, origin)
    items = [item for item in dataclasses.fields(cls) if item.init]
    given: dict[str, Any] = {}
    for key, text in options.items():
        if key not in hints or key not in {item.name for item in items}:
            raise SettingsError(
                f"{_shown(spec)}: {name} has no parameter {_shown(key)}"
                + _nearest(key, [item.name for item in items])
            )
        given[key] = _read(text, hints[key], where=f"{_shown(spec)}: {key}")
    first = items[0].name if items else None
    if value is None:
        values: list[Any] = [] if first is None or first not in given else [given.pop(first)]
    elif first is None:
        raise SettingsError(f"{_shown(spec)}: {name} takes no value")
    elif first in given:
        raise SettingsError(f"{_shown(spec)}: {first} is given twice")
    elif ".." in value:
        values = _sweep(value, spec=spec, spacing=getattr(cls, "sweep", "linear"))
        values = [
            _read(f"{level:.12g}", hints[first], where=f"{_shown(spec)}: {first}")
            for level in values
        ]
    else:
        values = [_read(value, hints[first], where=f"{_shown(spec)}: {first}")]
    changes = [{first: one, **given} for one in values] if first and values else [given]
    return tuple(
        _plugin(kind, name=name, cls=cls, origin=origin, changes=change, spec=spec)
        for change in changes
    )


def is_own_class(kind: Kind, spec: str) -> bool:
    """Whether a SPEC names a class by its module, ``package.module:Class``; imports nothing."""
    return ":" in _split(kind, spec)[0]


def parse_all(kind: Kind, specs: tuple[str, ...]) -> tuple[Plugin, ...]:
    """Return the plug-ins of several SPECs, each once, in the order given."""
    unique = {plugin.spec: plugin for spec in specs for plugin in parse(kind, spec)}
    return tuple(unique.values())


def _plugin(
    kind: Kind, *, name: str, cls: type, origin: str, changes: dict[str, Any], spec: str
) -> Plugin:
    instance = _made(cls, changes, name=name, origin=origin, spec=spec)
    if kind == "predictors":
        requires = _knowledge(instance, "requires", kind=kind, name=name, origin=origin)
        _check_granted(requires, name=name)
    elif kind == "attacks":
        _check_attack(instance, name=name, origin=origin)
    level: float | None = None
    parameters: list[str] = []
    for position, item in enumerate(item for item in dataclasses.fields(cls) if item.init):
        value = getattr(instance, item.name)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if position == 0 and kind == "mechanisms" and is_number:
            if isinstance(value, int) and abs(value) >= _LEVEL_LIMIT:
                raise SettingsError(
                    f"{_shown(spec)}: the level {item.name} must have at most 12 digits"
                )
            level = float(value)
            if not math.isfinite(level):
                raise SettingsError(f"{_shown(spec)}: the level {item.name} must be finite")
        elif not _same(value, item):
            parameters.append(f"{item.name}={_text(value)}")
    column = ":".join([name, *([",".join(parameters)] if parameters else [])])
    canonical = column if level is None else ",".join([f"{name}:{_text(level)}", *parameters])
    return Plugin(
        name=column,
        level=level,
        spec=canonical,
        origin=origin,
        instance=instance,
        family=name,
        adding=_adding(instance, name=name, origin=origin) if kind == "mechanisms" else "",
    )


def _made(cls: type, changes: dict[str, Any], *, name: str, origin: str, spec: str) -> Any:  # noqa: ANN401 - whatever class it is
    try:
        return cls(**changes)
    except IsacTrackError:
        raise
    except ValueError as error:
        why = told(error).removeprefix("ValueError: ")
        raise SettingsError(f"{_shown(spec)}: {why}") from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        needed = [
            item.name
            for item in dataclasses.fields(cls)
            if item.init
            and item.name not in changes
            and item.default is dataclasses.MISSING
            and item.default_factory is dataclasses.MISSING
        ]
        if needed and isinstance(error, TypeError):
            raise SettingsError(
                f"{_shown(spec)}: {name} needs a value for {', '.join(needed)}, as in {name}:VALUE"
            ) from None
        raise PluginError(
            f"{_shown(spec)}: {origin} cannot be made: {told(error)}; a plug-in refuses a value by "
            "a ValueError"
        ) from error


def _same(value: object, item: dataclasses.Field[Any]) -> bool:
    default = item.default
    if item.default_factory is not dataclasses.MISSING:
        default = item.default_factory()
    try:
        return bool(value == default)
    except ValueError:  # arrays compare element by element
        return value is default


def _knowledge(
    instance: object, attribute: str, *, kind: Kind, name: str, origin: str
) -> frozenset[Knowledge]:
    from isac_track.types import Knowledge  # noqa: PLC0415 - a list of names needs no numpy

    try:
        declared = getattr(instance, attribute, None)
    except Exception as error:  # it may be a property
        raise PluginError(
            f"{_SINGULAR[kind]} {name!r}: {origin}.{attribute}: {told(error)}"
        ) from error
    if not isinstance(declared, frozenset) or not all(
        isinstance(one, Knowledge) for one in declared
    ):
        raise PluginError(
            f"{_SINGULAR[kind]} {name!r}: {origin}.{attribute} must be a frozenset of Knowledge"
        )
    return declared


def _adding(instance: object, *, name: str, origin: str) -> str:
    from isac_track.types import Adding  # noqa: PLC0415 - a list of names needs no numpy

    try:
        # A rule for an error that is not there is none.
        declared = getattr(instance, "adding", "") if getattr(instance, "adds_error", True) else ""
    except Exception as error:  # it may be a property
        raise PluginError(f"mechanism {name!r}: {origin}.adding: {told(error)}") from error
    is_rule = isinstance(declared, str) and declared in get_args(Adding)
    return declared if is_rule else ""


def _check_attack(instance: object, *, name: str, origin: str) -> None:
    from isac_track.protocols import kind_of  # noqa: PLC0415 - a list of names needs no numpy

    for attribute in ("requires", "uses"):
        _knowledge(instance, attribute, kind="attacks", name=name, origin=origin)
    try:
        kind_of(instance)
    except ValueError as error:
        raise PluginError(f"attack {name!r}: {origin}: {error}") from None


def _check_granted(requires: frozenset[Knowledge], *, name: str) -> None:
    denied = sorted(one.name for one in requires if one.name != "SIGMA")
    if denied:
        raise PluginError(
            f"predictor {name!r} requires {', '.join(denied)}, which a robot is never granted"
        )


def _split(kind: Kind, spec: str) -> tuple[str, str | None, dict[str, str]]:
    name, _, rest = spec.strip().partition(":")
    if "." in name or _is_own_module(kind, name, rest):
        cls, _, rest = rest.partition(":")
        name = f"{name}:{cls}"
        if not cls.isidentifier():
            raise SettingsError(
                f"{_shown(spec)}: expected package.module:Class[:VALUE][,key=value...]"
            )
    if not name:
        raise SettingsError(f"{_shown(spec)}: a SPEC begins with a name")
    value: str | None = None
    options: dict[str, str] = {}
    for position, part in enumerate(rest.split(",") if rest else []):
        key, equals, text = part.partition("=")
        if equals and key.strip() and text.strip():
            if key.strip() in options:
                raise SettingsError(f"{_shown(spec)}: {key.strip()} is given twice")
            options[key.strip()] = text.strip()
        elif not equals and position == 0 and part.strip():
            value = part.strip()
        else:
            raise SettingsError(f"{_shown(spec)}: {_shown(part)} is not key=value")
    return name, value, options


def _is_own_module(kind: Kind, name: str, rest: str) -> bool:
    """Whether ``name:Class`` means a module without a package, such as a file of one's own."""
    attribute = rest.partition(":")[0]
    if name in names(kind) or not (name.isidentifier() and attribute.isidentifier()):
        return False
    return find_spec(name) is not None


def _load(kind: Kind, name: str) -> tuple[type, str]:
    known = names(kind)
    origin = name if ":" in name else known.get(name)
    singular = _SINGULAR[kind]
    if origin is None:
        raise SettingsError(f"unknown {singular} {_shown(name)}" + _nearest(name, list(known)))
    module_name, _, attribute = origin.partition(":")
    try:
        cls = getattr(importlib.import_module(module_name), attribute)
    except BaseException as error:  # a plug-in's import may do anything at all
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        raise PluginError(
            f"{singular} {name!r} cannot be loaded from {origin}: {told(error)}"
        ) from error
    method = _METHOD[kind]
    if not (isinstance(cls, type) and dataclasses.is_dataclass(cls)):
        raise PluginError(f"{singular} {name!r}: {origin} must be a frozen dataclass")
    if not cls.__dataclass_params__.frozen:  # type: ignore[attr-defined]  # set by the decorator
        raise PluginError(f"{singular} {name!r}: the dataclass {origin} must be frozen")
    if not callable(getattr(cls, method, None)):
        raise PluginError(f"{singular} {name!r}: {origin} has no method {method}()")
    return cls, origin


def _hints(cls: type, origin: str) -> dict[str, Any]:
    """Return the type of every parameter; of one that is inherited, as its own module reads it."""
    hints: dict[str, Any] = {}
    # Only the parameters: a ClassVar may well name a type that is not there at run time.
    for item in (item for item in dataclasses.fields(cls) if item.init):
        # An inherited field is the very object of the class that declares it.
        owner = next(
            one
            for one in reversed(cls.__mro__)
            if vars(one).get("__dataclass_fields__", {}).get(item.name) is item
        )
        holder = type("Parameter", (), {"__annotations__": {item.name: item.type}})
        try:
            hints |= get_type_hints(holder, globalns=vars(sys.modules[owner.__module__]))
        except NameError as error:
            raise PluginError(
                f"{origin}: {error}; a parameter's type must be imported at run time, "
                "not under TYPE_CHECKING"
            ) from error
        except Exception as error:  # an annotation is code
            raise PluginError(f"{origin}: the type of {item.name}: {told(error)}") from error
    return hints


def _read(text: str, annotation: Any, *, where: str) -> Any:  # noqa: ANN401 - as annotated
    origin = get_origin(annotation)
    if origin in (Union, types.UnionType):
        return _read_union(text, get_args(annotation), where=where)
    choices = (True, False) if annotation is bool else get_args(annotation)
    if annotation is bool or origin is Literal:
        for choice in choices:
            if text.lower() == str(choice).lower():
                return choice
        raise SettingsError(
            f"{where} must be one of {', '.join(map(str, choices)).lower()}, got {_shown(text)}"
        )
    if annotation is str:
        return text
    if annotation in (int, float):
        return _read_number(text, annotation, where=where)
    raise PluginError(f"{where}: parameters of type {annotation} cannot be given as text")


def _read_union(text: str, options: tuple[Any, ...], *, where: str) -> Any:  # noqa: ANN401
    if text.lower() == "none" and type(None) in options:
        return None
    kinds = [option for option in options if option is not type(None)]
    for kind in kinds[:-1]:
        try:
            return _read(text, kind, where=where)
        except SettingsError:
            continue
    return _read(text, kinds[-1], where=where)


def _read_number(text: str, kind: type[int | float], *, where: str) -> float:
    try:
        number = kind(text)
    except ValueError:
        noun = "a whole number" if kind is int else "a number"
        raise SettingsError(f"{where} must be {noun}, got {_shown(text)}") from None
    if kind is int:
        if abs(number) >= _WHOLE_LIMIT:
            raise SettingsError(f"{where} must have at most 18 digits, got {_shown(text)}")
        return number
    if not math.isfinite(number):
        raise SettingsError(f"{where} must be finite, got {_shown(text)}")
    # The 12 digits that names show: what two spellings share is one level, not two.
    return float(f"{number:.12g}")


def _sweep(value: str, *, spec: str, spacing: str) -> list[float]:
    try:
        bounds, _, count_text = value.partition("/")
        low, high = (float(bound) for bound in bounds.split(".."))
        count = int(count_text)
    except ValueError:
        raise SettingsError(
            f"{_shown(spec)}: a sweep is LOW..HIGH/COUNT, as in fid:1..1000/10, got {_shown(value)}"
        ) from None
    if count > _MOST_LEVELS:
        raise SettingsError(
            f"{_shown(spec)}: a sweep has at most {_MOST_LEVELS} levels, got {count}"
        )
    if count < 2 or not (math.isfinite(low) and math.isfinite(high)) or low == high:  # noqa: PLR2004
        raise SettingsError(
            f"{_shown(spec)}: a sweep needs two finite ends that differ and COUNT >= 2"
        )
    share = [step / (count - 1) for step in range(count)]
    if spacing == "log":
        if low <= 0 or high <= 0:
            raise SettingsError(
                f"{_shown(spec)}: this sweep is logarithmic; both ends must be positive"
            )
        levels = [low * (high / low) ** part for part in share]
    else:
        levels = [low + (high - low) * part for part in share]
    return [float(f"{level:.12g}") for level in levels]


def _shown(text: str) -> str:
    """Return what a user typed in quotes, cut to a length."""
    return repr(text) if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]!r}..."


def _text(value: object) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _nearest(name: str, known: list[str]) -> str:
    near = get_close_matches(name, known, n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(sorted(known))}" if known else "; it has none"


def _entry_points(kind: Kind) -> tuple[EntryPoint, ...]:
    return tuple(sorted(entry_points(group=f"isac_track.{kind}"), key=lambda point: point.name))
