"""Plug-ins that are objects: what a notebook names instead of a SPEC."""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

from isac_track import plugins
from isac_track.errors import PluginError, SettingsError, quoted, told

if TYPE_CHECKING:
    from isac_track.plugins import Kind, Plugin


def plugins_of(kind: Kind, given: Any) -> tuple[Plugin, ...]:  # noqa: ANN401 - anything at all
    """Return the plug-ins that a SPEC or an object stands for.

    An object is called as its SPEC would be: by its name if it has one, else `module:Class`.

    Raises SettingsError and PluginError as `plugins.parse`, and for what is no plug-in.
    """
    if isinstance(given, str):
        return plugins.parse(kind, given)
    cls = given if isinstance(given, type) else type(given)
    if isinstance(given, type) or not hasattr(cls, "__dataclass_params__"):
        way_out = f": write {cls.__name__}()" if isinstance(given, type) else ""
        what = f"{kind} are SPECs or objects of frozen dataclasses"
        raise SettingsError(f"{what}, got {quoted(given)}{way_out}")
    origin = f"{cls.__module__}:{cls.__qualname__}"
    plugins.check_class(kind, cls, origin)
    known = {its: name for name, its in plugins.names(kind).items()}
    values = {one.name: getattr(given, one.name) for one in fields(given) if one.init}
    found = plugins.configured(kind, known.get(origin, origin), cls, origin, values)
    if origin in known and (named := plugins.parse(kind, found.spec))[0].instance == given:
        return named  # the same cells
    return (replace(found, instance=given, digest=_digest(given, origin)),)


def all_of(kind: Kind, given: Iterable[Any]) -> tuple[Plugin, ...]:
    """Return the plug-ins of several SPECs and objects, each once, in the order given.

    Raises SettingsError as `plugins_of`, and for two that are called the same but are not.
    """
    found: dict[str, Plugin] = {}
    for one in (plugin for some in given for plugin in plugins_of(kind, some)):
        if found.setdefault(one.spec, one).digest != one.digest:
            raise SettingsError(
                f"two {kind} are both called {one.spec!r}; rename one of the classes"
            )
    return tuple(found.values())


def _digest(given: object, origin: str) -> str:
    """Return a digest of an object as it travels; one that is no other's where that is unstable.

    Of a class that no module has, the code travels along.
    """
    from cloudpickle import dumps, loads  # noqa: PLC0415 - SPECs need none

    try:
        # What two objects share is written once, so that only what was read is written alike.
        content = dumps(loads(dumps(given)))
        is_stable = content == dumps(loads(content))
    except Exception as error:  # a stranger's __reduce__ may do anything
        raise PluginError(
            f"{origin} cannot be sent to a worker ({told(error)}); leave out what cannot be pickled"
        ) from error
    return hashlib.sha256(content).hexdigest()[:16] if is_stable else secrets.token_hex(8)
