"""Plug-ins by name: built-in, by entry point, by ``package.module:Class``, or objects.

A SPEC is ``name[:VALUE][,key=value...]``. VALUE sets the first field; for a mechanism
that is the level. ``fid:1..1000/10`` is a sweep of ten levels, spaced as the class
declares (``sweep``). Parameters that differ from their default stay in the name:
``fid:adding=independent``.
"""

import contextlib
import dataclasses
import hashlib
import importlib
import math
import re
import secrets
import sys
import types
import typing
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Literal, TypeAlias, Union

from isac_track.command_line import may_be_ctrl_c
from isac_track.errors import (
    IsacTrackError,
    PluginError,
    SettingsError,
    did_you_mean,
    error_text,
    quoted,
)

Kind: TypeAlias = Literal["mechanisms", "predictors", "attacks", "policies", "trackers"]
_SINGULAR: dict[Kind, str] = {
    "mechanisms": "mechanism",
    "predictors": "predictor",
    "attacks": "attack",
    "policies": "policy",
    "trackers": "tracker",
}

KIND_BY_NOUN: dict[str, Kind] = {noun: kind for kind, noun in _SINGULAR.items()}
"""Kinds of plug-in by their nouns: `policy`, `attack`."""
_BUILT_IN: dict[Kind, dict[str, str]] = {
    "predictors": {
        "least_squares": "predictors.least_squares:LeastSquares",
        "constant_position": "predictors.constant_position:ConstantPosition",
        "kalman_cv": "predictors.kalman:KalmanCV",
        "kalman_ca": "predictors.kalman:KalmanCA",
        "kalman_imm": "predictors.kalman:KalmanIMM",
    },
    "attacks": {
        "identity": "attacks.reconstruction.averaging:Identity",
        "moving_average": "attacks.reconstruction.moving_windows:MovingAverage",
        "savgol": "attacks.reconstruction.moving_windows:Savgol",
        "kalman_rts": "attacks.reconstruction.kalman_rts:KalmanRTS",
        "radial_rts": "attacks.reconstruction.kalman_rts:RadialRTS",
        "ou_rts": "attacks.reconstruction.ou_rts:OuRTS",
        "gaussian_process": "attacks.reconstruction.gaussian_process:GaussianProcess",
        "averaging": "attacks.reconstruction.averaging:Averaging",
        "corrector": "attacks.reconstruction.corrector:Corrector",
        "shape": "attacks.linkage.alignment:Shape",
        "profile": "attacks.linkage.alignment:Profile",
        "likelihood_ratio": "attacks.linkage.likelihood_ratio:LikelihoodRatio",
        "dtw": "attacks.linkage.dtw:DTW",
        "behaviour": "attacks.linkage.behaviour:Behaviour",
        "gait": "attacks.linkage.gait:Gait",
        "histogram": "attacks.linkage.histogram:Histogram",
        "kinematic": "attacks.linkage.kinematic:Kinematic",
        "mean_distance": "attacks.linkage.mean_distance:MeanDistance",
    },
    "policies": {
        "everything": "isac_track.policies.samples:Everything",
        "window": "isac_track.policies.samples:Window",
        "near": "isac_track.policies.samples:Near",
        "ahead": "isac_track.policies.samples:Ahead",
        "random": "isac_track.policies.samples:RandomPeople",
        "state": "isac_track.policies.summaries:State",
        "flag": "isac_track.policies.summaries:Flag",
    },
    "trackers": {
        "oracle": "isac_track.tracking.methods:Oracle",
        "genie": "isac_track.tracking.methods:Genie",
        "gnn": "isac_track.tracking.methods:GNN",
        "jpda": "isac_track.tracking.methods:JPDA",
    },
}
_IN_PACKAGES: dict[Kind, dict[str, str]] = {
    "attacks": dict.fromkeys(("imm_rts", "posterior", "fusion"), "examples/attacks")
}
"""Plug-ins that were built in once: by name, the folder of their package."""
_MECHANISMS = (
    "isac_track.mechanisms.paper",
    "isac_track.mechanisms.controls",
    "isac_track.mechanisms.protections",
    "isac_track.mechanisms.literature",
    "isac_track.mechanisms.shaped",
    "isac_track.mechanisms.withholding",
)
"""Modules with a table ``MECHANISMS``, whose entries are built-in plug-ins."""
_METHOD: dict[Kind, str] = {
    "attacks": "fit",
    "mechanisms": "share",
    "predictors": "predict",
    "policies": "select",
    "trackers": "track",
}
# Kinds whose first parameter, if a number, is the level.
_WITH_LEVEL: tuple[Kind, ...] = ("mechanisms", "policies")
_MOST_LEVELS = 1000
_WHOLE_LIMIT = 10**12  # Names show 12 digits.
_PATH = re.compile(r"([A-Za-z]:(?=[\\/]|[^:,=]*\.py\b)|[\\/]|\.[\\/]|[^:,=]*\\)[^:]*")
"""A path at the beginning of a SPEC: ./x.py, /x.py, C:\\x.py, a\\x.py; not x, C:0.5."""
# A class name after a path; a value does not begin with a capital letter.
_IN_FOLDER = "; run it in the folder that holds it, or install the package"
_CLASS_NAME = re.compile(r"([A-Z]\w*)(?::|$)")


@dataclass(frozen=True, slots=True)
class Plugin:
    """A mechanism or policy at a level, a predictor, an attack, or a tracker."""

    # As in the result columns: family and non-default parameters, without the level.
    name: str
    level: float | None
    """Level of a mechanism or policy; None without a level that is a number."""
    spec: str  # Canonical SPEC of this plug-in.
    origin: str  # ``module:Class``
    instance: Any  # The frozen object.
    family: str = ""  # Its name without parameters.
    adding: str = ""  # Adding rule that a mechanism declares; empty if it has none.
    protects: bool = True  # Whether a mechanism claims to protect: a control does not.
    # Digest of a plug-in given as an object; its cells depend on it besides the SPEC.
    digest: str = ""


def names(kind: Kind) -> dict[str, str]:
    """Return ``{name: "module:Class"}`` of all plug-ins of a kind.

    Only the modules of the built-in mechanisms are imported.
    """
    known = dict(_BUILT_IN.get(kind, {}))
    if kind == "mechanisms":
        known |= {
            name: f"{cls.__module__}:{cls.__name__}"
            for name, cls in built_in_mechanisms().items()
        }
    for point in _entry_points(kind):
        known.setdefault(point.name, point.value)
    return known


def built_in_mechanisms() -> dict[str, type[Any]]:
    """Return the class of each built-in mechanism, by its name in a SPEC."""
    return {
        name: cls
        for module in _MECHANISMS
        for name, cls in importlib.import_module(module).MECHANISMS.items()
    }


def broken(kind: Kind) -> dict[str, str]:
    """Import all plug-ins from entry points; return ``{name: message}`` of failures."""
    faults = {}
    for point in _entry_points(kind):
        try:
            _load_class(kind, point.name)
        except PluginError as error:
            faults[point.name] = str(error)
    return faults


# Installed plug-ins by kind; for the process: who installs another starts anew.
@cache
def _entry_points(kind: Kind) -> tuple[EntryPoint, ...]:
    return tuple(
        sorted(entry_points(group=f"isac_track.{kind}"), key=lambda point: point.name)
    )


def parse(kind: Kind, spec: str) -> tuple[Plugin, ...]:
    """Return the plug-ins that a SPEC names: one, or one per level of a sweep.

    SettingsError if a name, parameter or value does not exist or does not fit;
    PluginError if the plug-in cannot be imported or does not meet its interface.
    """
    name, pairs = _split_spec(kind, spec)
    cls, origin = _load_class(kind, name)
    with _name_spec_in_errors(spec):
        hints = _parameter_types(cls, origin)
        changes: list[dict[str, Any]] = [{}]
        for key, text in pairs:
            parameter = key or next(iter(hints), "")
            if not parameter:
                raise SettingsError(f"{name} takes no value")
            if parameter not in hints:
                fault = f"{name} has no parameter {quoted(parameter)}"
                raise SettingsError(f"{fault}{_nearest_hint(parameter, hints)}")
            if parameter in changes[0]:
                raise SettingsError(f"{parameter} is given twice")
            texts = [text]
            if not key and ".." in text:
                texts = _sweep_levels(
                    text, is_log=getattr(cls, "sweep", "linear") == "log"
                )
            values = [
                _read_value(value, hints[parameter], parameter) for value in texts
            ]
            changes = [
                {**change, parameter: value} for change in changes for value in values
            ]
        return tuple(configure(kind, name, cls, origin, change) for change in changes)


def resolve_plugins(kind: Kind, given: Any) -> tuple[Plugin, ...]:  # noqa: ANN401 - anything at all
    """Return the plug-ins of a SPEC, or of an object.

    An object has the name of its SPEC: that of a known plug-in, else `module:Class`.
    SettingsError and PluginError are raised as by `parse`, also for an object that is
    no plug-in.
    """
    if isinstance(given, str):
        return parse(kind, given)
    cls = given if isinstance(given, type) else type(given)
    if isinstance(given, type) or not hasattr(cls, "__dataclass_params__"):
        way_out = f": write {cls.__name__}()" if isinstance(given, type) else ""
        expected = f"{kind} are SPECs or objects of frozen dataclasses"
        raise SettingsError(f"{expected}, got {quoted(given)}{way_out}")
    origin = f"{cls.__module__}:{cls.__qualname__}"
    check_class(kind, cls, origin)
    name_by_origin = {origin: name for name, origin in names(kind).items()}
    values = {item.name: getattr(given, item.name) for item in _parameters(cls)}
    name = name_by_origin.get(origin, origin)
    plugin = configure(kind, name, cls, origin, values)
    if origin in name_by_origin:
        named = parse(kind, plugin.spec)
        if named[0].instance == given:
            return named  # shares its cells with the SPEC
    return (dataclasses.replace(plugin, instance=given, digest=_digest(given, origin)),)


def parse_all(kind: Kind, given: Iterable[Any]) -> tuple[Plugin, ...]:
    """Return the plug-ins of SPECs and objects, without repetition.

    SettingsError for two different plug-ins with the same name.
    """
    plugins: dict[str, Plugin] = {}
    for item in given:
        for plugin in resolve_plugins(kind, item):
            if plugins.setdefault(plugin.spec, plugin).digest != plugin.digest:
                raise SettingsError(
                    f"two {kind} are both called {plugin.spec!r}; rename one of them"
                )
    return tuple(plugins.values())


def _digest(given: object, origin: str) -> str:
    """Return a digest of an object and its class as they are sent to a worker.

    It is random if pickling gives different bytes each time.
    """
    from cloudpickle import dumps, loads  # noqa: PLC0415 - SPECs need none

    cls = type(given)
    own = dict(vars(cls))
    try:
        # Pickle writes shared parts once: compare only bytes of objects that were read.
        content = dumps(loads(dumps(given)))
        is_stable = content == dumps(loads(content))
        # Reading redefines a session's class in place: its methods lose their file, and
        # Python 3.13 loses the first line of the class. Restore the attributes.
        for name, value in own.items():
            if vars(cls).get(name) is not value:
                setattr(cls, name, value)
    except Exception as error:  # a third-party __reduce__ may raise anything
        raise PluginError(
            f"{origin} cannot be sent to a worker ({error_text(error)}); leave out what"
            " cannot be pickled"
        ) from error
    return (
        hashlib.sha256(content).hexdigest()[:16] if is_stable else secrets.token_hex(8)
    )


def find_kind(spec: str) -> Kind:
    """Return the kind of a SPEC by its name or its class's method, else attacks."""
    for kind in _METHOD:
        with contextlib.suppress(PluginError, SettingsError):
            _load_class(kind, _split_spec(kind, spec)[0])
            return kind
    return "attacks"


def is_own_class(kind: Kind, spec: str) -> bool:
    """Return whether a SPEC is ``package.module:Class``; imports nothing."""
    return ":" in _split_spec(kind, spec)[0]


@contextlib.contextmanager
def _name_spec_in_errors(spec: str) -> Iterator[None]:
    """Prefix the message of an error with the SPEC that caused it."""
    try:
        yield
    except IsacTrackError as error:
        kind = PluginError if isinstance(error, PluginError) else SettingsError
        raise kind(f"{quoted(spec)}: {error}") from error.__cause__


def _split_spec(kind: Kind, spec: str) -> tuple[str, list[tuple[str, str]]]:
    """Split a SPEC into its name and its parameters as text; VALUE has the key ""."""
    name, _, rest = _rewrite_path(kind, spec.strip()).partition(":")
    attribute = rest.partition(":")[0]
    may_be_module = (
        name.isidentifier() and attribute.isidentifier() and name not in names(kind)
    )
    pairs: list[tuple[str, str]] = []
    with _name_spec_in_errors(spec):
        # A module without a package is a file of the user.
        if "." in name or (may_be_module and find_spec(name) is not None):
            name, rest = f"{name}:{attribute}", rest.partition(":")[2]
            if not attribute.isidentifier():
                raise SettingsError(
                    "expected package.module:Class[:VALUE][,key=value...]"
                )
        elif (
            may_be_module
            and _CLASS_NAME.match(rest)
            and not did_you_mean(name, names(kind), quote="'")
        ):
            raise SettingsError(f"there is no module {quoted(name)}{_IN_FOLDER}")
        if not name:
            raise SettingsError("a SPEC begins with a name")
        for position, part in enumerate(rest.split(",") if rest else []):
            key, equals, text = (text.strip() for text in part.partition("="))
            if equals and key and text:
                pairs.append((key, text))
            elif not equals and position == 0 and key:
                pairs.append(("", key))
            else:
                raise SettingsError(f"{quoted(part)} is not key=value")
    return name, pairs


def _rewrite_path(kind: Kind, spec: str) -> str:
    """Rewrite a path to a Python file or its folder as `package.module:Class[...]`.

    A folder made by `attacks new` needs no ./ if nothing else has its name. The path
    may be a Windows path. A class follows it, unless its name follows from the file's.
    """
    match = _PATH.match(spec)
    path = match[0] if match else spec.partition(":")[0]
    _, colon, rest = spec[len(path) :].partition(":")
    if not match:
        is_free = (
            path.isidentifier()
            and path not in names(kind)
            and find_spec(path) is not None
        )
        if not (is_free and any(Path().glob(f"{path}/{path}.py"))):
            return spec
    parts = parts_below(path.removesuffix(".py"), folder=str(Path.cwd()))
    if parts is None:
        file = path.replace("\\", "/").rpartition("/")[2].rpartition(":")[2]
        raise SettingsError(
            f"{quoted(spec)}: a file is named from the folder that a run starts in,"
            f" which holds it: go there and write {quoted(f'./{file}{colon}{rest}')}"
        )
    if not parts or not all(part.isidentifier() for part in parts):
        raise SettingsError(
            f"{quoted(spec)}: ./ is followed by a Python file, or its folder"
        )
    class_name = "".join(part.capitalize() for part in parts[-1].split("_"))
    if named := _CLASS_NAME.match(rest):
        class_name = named[1]
        _, colon, rest = rest.partition(":")
    module = ".".join(parts if path.endswith(".py") else (*parts, parts[-1]))
    return f"{module}:{class_name}{colon}{rest}"


def parts_below(path: str, *, folder: str) -> tuple[str, ...] | None:
    """Return the parts of a path below a folder, POSIX or Windows; None if outside."""
    is_windows = "\\" in path or path[1:2] == ":"
    pure = PureWindowsPath(path) if is_windows else PurePosixPath(path)
    if not pure.anchor:
        return pure.parts
    base = type(pure)(folder)
    return pure.relative_to(base).parts if pure.is_relative_to(base) else None


def _folder_hint(error: BaseException, module_name: str) -> str:
    """Return the way out if the module of a plug-in, or its package, is missing."""
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    if missing and f"{module_name}.".startswith(f"{missing}."):
        return _IN_FOLDER
    return ""


def _load_class(kind: Kind, name: str) -> tuple[type, str]:
    """Import the class of a name; return it and its ``module:Class``.

    SettingsError for an unknown name, PluginError for a class that cannot be used.
    """
    known = names(kind)
    origin = name if ":" in name else known.get(name)
    singular = _SINGULAR[kind]
    if origin is None:
        hint = _package_hint(kind, name) or _nearest_hint(name, known)
        raise SettingsError(f"unknown {singular} {quoted(name)}{hint}")
    module_name, _, attribute = origin.partition(":")
    try:
        cls = getattr(importlib.import_module(module_name), attribute)
    except BaseException as error:  # a plug-in's import may raise anything
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        fault = f"{singular} {name!r} cannot be loaded from {origin}"
        raise PluginError(
            f"{fault}: {error_text(error)}{_folder_hint(error, module_name)}"
        ) from error
    check_class(kind, cls, f"{singular} {name!r}: {origin}")
    return cls, origin


def check_class(kind: Kind, cls: Any, subject: str) -> None:  # noqa: ANN401 - anything
    """Raise PluginError unless `cls` is the class of a plug-in.

    `subject` begins the message.
    """
    declared = getattr(cls, "__dataclass_params__", None)
    if not (isinstance(cls, type) and declared and declared.frozen):
        raise PluginError(
            f"{subject} must be a frozen dataclass: @dataclass(frozen=True)"
        )
    method = _METHOD[kind]
    if not callable(getattr(cls, method, None)):
        raise PluginError(f"{subject} has no method {method}()")


def _parameter_types(cls: type, origin: str) -> dict[str, Any]:
    """Return the type of every parameter, resolved in the module that declares it."""
    known: dict[str, Any] = {}
    for base in reversed(cls.__mro__):
        known |= vars(sys.modules[base.__module__])
    hints: dict[str, Any] = {}
    # Only for the parameters: a ClassVar may name a type that does not exist at run
    # time.
    for item in _parameters(cls):
        holder = type("Parameter", (), {"__annotations__": {item.name: item.type}})
        try:
            hints |= typing.get_type_hints(holder, globalns=known)
        except Exception as error:  # an annotation is code
            raise PluginError(
                f"{origin}: the type of {item.name}: {error_text(error)};"
                " it must be imported at run time, not under TYPE_CHECKING"
            ) from error
    return hints


def _parameters(cls: type) -> list[dataclasses.Field[Any]]:
    return [item for item in dataclasses.fields(cls) if item.init]


def _read_value(text: str, annotation: Any, key: str) -> Any:  # noqa: ANN401 - as annotated
    """Convert text to the type of a parameter."""
    if typing.get_origin(annotation) in (Union, types.UnionType):
        kinds = [kind for kind in typing.get_args(annotation) if kind is not type(None)]
        if text.lower() == "none" and type(None) in typing.get_args(annotation):
            return None
        for kind in kinds[:-1]:
            with contextlib.suppress(IsacTrackError):
                return _read_value(text, kind, key)
        return _read_value(text, kinds[-1], key)
    if annotation is bool or typing.get_origin(annotation) is Literal:
        choices = (True, False) if annotation is bool else typing.get_args(annotation)
        for choice in choices:
            if text.lower() == str(choice).lower():
                return choice
        known = ", ".join(map(str, choices)).lower()
        raise SettingsError(f"{key} must be one of {known}, got {quoted(text)}")
    if annotation is str:
        return text
    if annotation in (int, float):
        return _read_number(text, annotation, key)
    raise PluginError(f"{key}: parameters of type {annotation} cannot be given as text")


def _read_number(text: str, kind: type[int | float], key: str) -> float:
    try:
        number = kind(text)
    except ValueError:
        noun = "a whole number" if kind is int else "a number"
        raise SettingsError(f"{key} must be {noun}, got {quoted(text)}") from None
    if kind is int and abs(number) >= _WHOLE_LIMIT:
        raise SettingsError(f"{key} must have at most 12 digits, got {quoted(text)}")
    if not math.isfinite(number):
        raise SettingsError(f"{key} must be finite, got {quoted(text)}")
    # Names show 12 digits: spellings that agree in them are the same level.
    return number if kind is int else float(f"{number:.12g}")


def _sweep_levels(value: str, *, is_log: bool) -> list[str]:
    """Return the levels of LOW..HIGH/COUNT, as text."""
    try:
        bounds, _, count_text = value.partition("/")
        low, high = (float(bound) for bound in bounds.split(".."))
        count = int(count_text)
    except ValueError:
        usage = "a sweep is LOW..HIGH/COUNT, as in fid:1..1000/10"
        raise SettingsError(f"{usage}, got {quoted(value)}") from None
    if count > _MOST_LEVELS:
        raise SettingsError(f"a sweep has at most {_MOST_LEVELS} levels, got {count}")
    if count < 2 or not (math.isfinite(low) and math.isfinite(high)) or low == high:  # noqa: PLR2004 - a sweep has two ends
        raise SettingsError("a sweep needs two finite ends that differ and COUNT >= 2")
    if is_log and (low <= 0 or high <= 0):
        raise SettingsError("this sweep is logarithmic; both ends must be positive")
    levels = [
        low * (high / low) ** share if is_log else low + (high - low) * share
        for share in (step / (count - 1) for step in range(count))
    ]
    return [f"{level:.12g}" for level in levels]


def configure(
    kind: Kind, name: str, cls: type, origin: str, changes: dict[str, Any]
) -> Plugin:
    """Return the checked plug-in of a class and its parameters, with its names."""
    needed = [
        item.name
        for item in _parameters(cls)
        if item.name not in changes
        and item.default is item.default_factory is dataclasses.MISSING
    ]
    if needed:
        raise SettingsError(
            f"{name} needs a value for {', '.join(needed)}, as in {name}:VALUE"
        )
    try:
        instance = cls(**changes)
    except IsacTrackError:
        raise
    except ValueError as error:
        raise SettingsError(error_text(error).removeprefix("ValueError: ")) from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and may_be_ctrl_c():
            raise
        reason = f"{error_text(error)}; a plug-in refuses a value by a ValueError"
        raise PluginError(f"{origin} cannot be made: {reason}") from error
    adding = check_declared(kind, instance, origin)
    level, parameters = _split_level(kind, cls, instance, changes)
    column = f"{name}:{','.join(parameters)}" if parameters else name
    spec = column
    if level is not None:
        spec = ",".join([f"{name}:{_format_value(level)}", *parameters])
    return Plugin(
        name=column,
        level=level,
        spec=spec,
        origin=origin,
        instance=instance,
        family=name,
        adding=adding,
        protects=kind != "mechanisms" or claims_protection(instance, origin),
    )


def _split_level(
    kind: Kind, cls: type, instance: object, changes: dict[str, Any]
) -> tuple[float | None, list[str]]:
    """Return the level of a plug-in, if any, and its other changed parameters."""
    level: float | None = None
    parameters: list[str] = []
    for position, item in enumerate(_parameters(cls)):
        value = getattr(instance, item.name)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if position == 0 and kind in _WITH_LEVEL and is_number:
            level = float(value)
        elif item.name in changes and value != item.default:
            parameters.append(f"{item.name}={_format_value(value)}")
    return level, parameters


def _read_declaration(
    instance: object, origin: str, attribute: str, default: object = None
) -> Any:  # noqa: ANN401 - third-party
    """Return an attribute of a plug-in; PluginError if a property raises an error."""
    try:
        return getattr(instance, attribute, default)
    except Exception as error:
        raise PluginError(f"{origin}.{attribute}: {error_text(error)}") from error


def claims_protection(mechanism: object, origin: str) -> bool:
    """Return whether a mechanism claims protection; PluginError if not a bool."""
    protects = _read_declaration(mechanism, origin, "protects", default=True)
    if not isinstance(protects, bool):
        raise PluginError(
            f"{origin}.protects must be True or False, got {quoted(protects)}"
        )
    return protects


def check_form(policy: object, origin: str) -> None:
    """Raise PluginError for a policy whose form of answers is unknown."""
    from isac_track.policies.query import (  # noqa: PLC0415 - a list of names needs no numpy
        Form,
    )

    form = _read_declaration(policy, origin, "form")
    known_forms = typing.get_args(Form)
    if form not in known_forms:
        wanted = ", ".join(known_forms)
        raise PluginError(f"{origin}.form must be one of {wanted}, got {quoted(form)}")


def check_declared(kind: Kind, instance: object, origin: str) -> str:
    """Check the declarations of a plug-in; return a mechanism's adding rule, or "".

    PluginError for a wrong declaration.
    """
    from isac_track.protocols import (  # noqa: PLC0415 - a list of names needs no numpy
        attack_kind,
    )
    from isac_track.types import (  # noqa: PLC0415 - a list of names needs no numpy
        Adding,
        Knowledge,
    )

    declared = partial(_read_declaration, instance, origin)
    if kind == "mechanisms":
        claims_protection(instance, origin)
        # Without an added error no rule applies.
        adding = declared("adding") if declared("adds_error", default=True) else ""
        is_rule = isinstance(adding, str) and adding in typing.get_args(Adding)
        return adding if is_rule else ""
    if kind == "policies":
        check_form(instance, origin)
    if kind in ("policies", "trackers"):
        return ""
    for attribute in ("requires", "uses") if kind == "attacks" else ("requires",):
        needs = declared(attribute)
        if not isinstance(needs, frozenset) or not all(
            isinstance(item, Knowledge) for item in needs
        ):
            raise PluginError(f"{origin}.{attribute} must be a frozenset of Knowledge")
    if kind == "predictors" and (denied := needs - {Knowledge.SIGMA}):
        denied_names = ", ".join(sorted(item.name for item in denied))
        raise PluginError(
            f"{origin} requires {denied_names}, which a robot is never granted"
        )
    try:
        attack_kind(instance)
    except ValueError as error:
        raise PluginError(f"{origin}: {error}") from None
    return ""


def _format_value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()  # as in a SPEC
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def _package_hint(kind: Kind, name: str) -> str:
    """Return how to get a plug-in that has a package of its own; "" for any other."""
    folder = _IN_PACKAGES.get(kind, {}).get(name)
    return f"; it has a package of its own: pip install ./{folder}" if folder else ""


def _nearest_hint(name: str, known: Collection[str]) -> str:
    listed = f"; known: {', '.join(sorted(known))}" if known else "; it has none"
    return did_you_mean(name, known, quote="'") or listed
