"""What a cell depends on: the code that computes it, its plug-ins, and the name made of both."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sysconfig
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import isac_track

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.experiment.axes import Consumer
    from isac_track.plugins import Plugin

_COMPUTING = ("isac_track", "predictors", "attacks")
_CELL_SOURCES = ("experiment", "cells")


def code_hash() -> str:
    """Return a digest of the installed source that cells come from: their code version.

    What only gathers and shows finished cells is left out.
    """
    digest = hashlib.sha256()
    root = Path(isac_track.__file__).parent.parent
    sources = [path for package in _COMPUTING for path in (root / package).rglob("*.py")]
    sources += [
        path for name in _CELL_SOURCES for path in (root / "evaluation" / name).rglob("*.py")
    ]
    for path in sorted(sources):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0")
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cell_name(
    *,
    identity: Mapping[str, Any],
    code: str,
    block: int,
    mechanism: Plugin,
    consumer: Consumer,
) -> str:
    """Return the file name of a cell: readable, and keyed by all that its rows depend on."""
    key = {
        "identity": dict(identity),
        "code": code,
        "block": block,
        "mechanism": _plugin_key(mechanism),
        "consumer": [
            consumer.spec,
            *(_plugin_key(one) for one in (consumer.plugin, consumer.behind) if one is not None),
        ],
        "knowledge": [consumer.knowledge, *sorted(one.name for one in consumer.granted)],
    }
    digest = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:16]
    slug = re.sub(r"[^A-Za-z0-9.=]+", "-", f"{mechanism.spec}_{consumer.label}")[:80]
    return f"{slug}_{block:05d}_{digest}.parquet"


def _plugin_key(plugin: Plugin) -> dict[str, str]:
    module = plugin.origin.partition(":")[0]
    if module.partition(".")[0] in _COMPUTING:  # the code hash covers them
        return {"spec": plugin.spec, "origin": plugin.origin}
    return {"spec": plugin.spec, "origin": plugin.origin, "source": source_digest(module)}


def source_digest(module: str) -> str:
    """Return the sha256 of a module and of all that it imports from beside itself.

    That is its own top-level package and, unless it was installed, whatever stands in the same
    folder as that. Imports are read, not run; those that are composed at run time are not seen.

    Parameters
    ----------
    module : str
        Name of an importable module. One without a file, such as `__main__`, has the digest of
        nothing.
    """
    try:
        found = find_spec(module)
    except ValueError:  # a script that runs
        found = None
    digest = hashlib.sha256()
    if found is None or not found.origin or not Path(found.origin).is_file():
        return digest.hexdigest()
    path = Path(found.origin)
    depth = module.count(".") + (path.name == "__init__.py")
    root = path.parents[depth]
    installed = {Path(folder) for folder in sysconfig.get_paths().values()}
    top = module.partition(".")[0] if root in installed else ""
    known: dict[str, Path] = {}
    names = [module]
    while names:
        name = names.pop()
        file = _file(name, root=root)
        if name in known or file is None or (top and name.partition(".")[0] != top):
            continue
        known[name] = file
        names += _imported(file, name=name)
        names += name.rpartition(".")[:1]  # the packages around it run first
    for name in sorted(known):
        digest.update(name.encode() + b"\0")
        digest.update(hashlib.sha256(known[name].read_bytes()).digest())
    return digest.hexdigest()


def _file(name: str, *, root: Path) -> Path | None:
    if not name:
        return None
    place = root.joinpath(*name.split("."))
    for path in (place.with_name(f"{place.name}.py"), place / "__init__.py"):
        if path.is_file():
            return path
    return None


def _imported(file: Path, *, name: str) -> Iterator[str]:
    """Yield the full names of what a file may import; some are no modules."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # it is told when somebody imports it
        return
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(above if node.level else []), *filter(None, [node.module])])
            yield base
            yield from (f"{base}.{one.name}" if base else one.name for one in node.names)
