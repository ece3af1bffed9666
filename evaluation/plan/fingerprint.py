"""Keys of cells: digests of the code that computes them, and of their plug-ins."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sysconfig
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import isac_track

if TYPE_CHECKING:
    from evaluation.plan.axes import Axes
    from evaluation.plan.consumer import Consumer
    from isac_track.plugins import Plugin

# Sections of scenes. A section without a name here is a linkage task, by its name.
SHARING, RECONSTRUCTION = "sharing", "reconstruction"
PATROL: Final = "patrol"  # Robots on patrol, with all policies.
RETURNS: Final = "returns"  # People who come back: a task of whole passages.
TRACKING: Final = "tracking"  # Robots and logs with tracks of detections.
# The packages of the project.
OURS: Final = ("isac_track", "predictors", "attacks", "evaluation")
_COMMON: Final = (
    "isac_track.datasets",
    "isac_track.place",
    "isac_track.scenes",
    "isac_track.sensing",
    "evaluation.compute.sharing",
    "evaluation.compute.tables",
)
"""Modules that every unit of work depends on: releases, and the tables of its file."""
_SECTIONS: Final = {
    SHARING: ("evaluation.compute.forecasts", *_COMMON),
    RECONSTRUCTION: ("evaluation.compute.reconstruction", *_COMMON),
    PATROL: ("evaluation.compute.patrols", *_COMMON),
    RETURNS: ("evaluation.compute.returns", *_COMMON),
    TRACKING: (
        "evaluation.compute.tracking",
        "evaluation.compute.recipients",
        "evaluation.compute.track_policies",
        "evaluation.compute.track_links",
        *_COMMON,
    ),
}
_LINKAGE: Final = ("evaluation.compute.linkage", "attacks.tasks.build", *_COMMON)
_COMPUTES_NOTHING: Final = re.compile(
    r"evaluation|evaluation\.plan\.presets|isac_track\.plugins"
    r"|(attacks|isac_track)\.(templates|testing)(\..*)?"
)
"""Presets and the table of plug-ins only name computations; kits only test them."""
_MODULE: Final = re.compile(rf"({'|'.join(OURS)})(\.\w+)+(:\w+)?")


def code_hash() -> str:
    """Return a digest of all installed source that cells may come from."""
    sha = hashlib.sha256()
    root = Path(isac_track.__file__).parent.parent
    folders = (
        "isac_track",
        "predictors",
        "attacks",
        "evaluation/plan",
        "evaluation/compute",
    )
    paths = (path for name in folders for path in (root / name).rglob("*.py"))
    for path in sorted(paths):
        name = path.relative_to(root).as_posix()
        module = name.removesuffix(".py").replace("/", ".")
        if not _COMPUTES_NOTHING.fullmatch(module):
            sha.update(name.encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()[:16]


def sources(section: str, *plugins: Plugin) -> tuple[str, ...]:
    """Return the root modules whose source, with all it imports, a key covers."""
    modules = _SECTIONS.get(section, _LINKAGE) if section else ()
    return (*modules, *(plugin.origin.partition(":")[0] for plugin in plugins))


def has_user_plugins(run_axes: Axes) -> bool:
    """Whether the axes have a user's plug-in: it may end its process, or spoil it."""
    consumers = (
        *run_axes.consumers,
        *run_axes.patrol_consumers(),
        *run_axes.track_consumers(),
        *(link for _, link in run_axes.links),
    )
    used = (plugin for consumer in consumers for plugin in consumer.plugins)
    return any(map(is_user_plugin, (*run_axes.mechanisms, *used)))


def list_user_plugins(run_axes: Axes) -> dict[str, list[str]]:
    """Return the user's plug-ins by axis, by their names in the columns of the results.

    Axes without any are left out. Mechanisms have names without the level. A linker
    behind a reconstruction counts as soon as either is a user's.
    """
    links = dict.fromkeys(link for _, link in run_axes.links)
    strange = {
        "mechanisms": [
            level.name for level in filter(is_user_plugin, run_axes.mechanisms)
        ],
        "predictors": [
            robot.spec for robot in filter(is_user_plugin, run_axes.predictors)
        ],
        "policies": [
            policy.spec for policy in filter(is_user_plugin, run_axes.policies)
        ],
        "trackers": [
            release.name for release in filter(is_user_plugin, run_axes.track_releases)
        ],
        "attacks": [attack.spec for attack in filter(is_user_plugin, run_axes.attacks)],
    }
    strange["attacks"] += [
        link.spec for link in links if any(map(is_user_plugin, link.plugins))
    ]
    return {axis: [*dict.fromkeys(names)] for axis, names in strange.items() if names}


def is_user_plugin(plugin: Plugin) -> bool:
    """Whether a plug-in is a user's, not one of the project's own."""
    return plugin.origin.partition(":")[0].partition(".")[0] not in OURS


def consumer_key(consumer: Consumer, *, code: Iterable[str], keep_scores: bool) -> str:
    """Return the key of a consumer, from its plug-ins, its knowledge and its code.

    `code` has digests. A linkage attack or control with its raw scores has another key.
    """
    content = [
        consumer.spec,
        [
            [plugin.spec, plugin.origin, *filter(None, [plugin.digest])]
            for plugin in consumer.plugins
        ],
        consumer.adversary,
        sorted(item.name for item in consumer.granted),
        *code,
    ]
    if keep_scores and consumer.kind in {"linkage", "link_bound", "control"}:
        content.append("scores")
    if consumer.world:
        content.append(consumer.world.text)
    return digest(content)


def digest(content: object) -> str:
    """Return a short digest of a value that can be written as JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class _ModuleFile:
    """A module's file: its sha256, and the full names that it may import."""

    sha256: bytes
    imports: tuple[str, ...]


ModuleFiles: TypeAlias = dict[
    tuple[Path | None, tuple[str, ...], str], _ModuleFile | None
]
"""The files of modules by folder, packages that count and name; None without a file."""


def source_digest(module: str, *, known: ModuleFiles | None = None) -> str:
    """Return the sha256 of a module and of all modules beside it that it imports.

    These are its own top-level package and, unless it was installed, all modules in the
    same folder as that; the project's own packages count as a folder. Imports are
    read, not run, lazy imports too. Imports for types alone do not count, and imports
    that are composed at run time are not seen. A module without a file, such as
    `__main__`, has the digest of no bytes.

    `known` holds files that are not read again, and takes those that are read. It is
    for digests of one plan: most of their files are the same.
    """
    root, tops = _import_root(module)
    known = {} if known is None else known
    digests: dict[str, bytes] = {}
    names, seen = [module], set[str]()
    while names:
        name = names.pop()
        if name in seen:
            continue
        seen.add(name)
        if (root, tops, name) not in known:
            known[root, tops, name] = _read_file(name, root=root, tops=tops)
        source = known[root, tops, name]
        if source is not None:
            digests[name] = source.sha256
            names += source.imports
    sha = hashlib.sha256()
    for name, file_digest in sorted(digests.items()):
        sha.update(name.encode() + b"\0" + file_digest)
    return sha.hexdigest()


def _read_file(
    name: str, *, root: Path | None, tops: tuple[str, ...]
) -> _ModuleFile | None:
    """Read the file of a module; None where there is none, or it does not count."""
    content = _read(name, root=root, tops=tops)
    if content is None:
        return None
    source, is_package = content
    parent = name.rpartition(".")[0]  # its package runs first
    imports = _imported(source, package=name if is_package else parent)
    return _ModuleFile(hashlib.sha256(source).digest(), (*imports, parent))


def changed_modules(digests: Mapping[str, str]) -> list[str]:
    """Return the modules whose sources no longer have the short digests given."""
    known: ModuleFiles = {}
    return [
        module
        for module, was in digests.items()
        if has_source(module) and source_digest(module, known=known)[:16] != was
    ]


def has_source(module: str) -> bool:
    """Whether this system has a file of a module."""
    return _import_root(module)[0] is not None


def _import_root(module: str) -> tuple[Path | None, tuple[str, ...]]:
    """Return the folder that a module is imported from, and the packages that count."""
    try:
        spec = find_spec(module)
    except (ValueError, ImportError):  # a running script; a missing package
        spec = None
    if spec is None or not spec.origin or not Path(spec.origin).is_file():
        return None, ()
    path, top = Path(spec.origin), module.partition(".")[0]
    root = path.parents[module.count(".") + (path.name == "__init__.py")]
    if top in OURS:
        return root, OURS
    is_installed = root in {Path(folder) for folder in sysconfig.get_paths().values()}
    return root, (top,) if is_installed else ()


def _read(
    name: str, *, root: Path | None, tops: tuple[str, ...]
) -> tuple[bytes, bool] | None:
    is_user_plugin = tops and name.partition(".")[0] not in tops
    if root is None or not name or is_user_plugin or _COMPUTES_NOTHING.fullmatch(name):
        return None
    place = root.joinpath(*name.split("."))
    for path in (place.with_name(f"{place.name}.py"), place / "__init__.py"):
        if path.is_file():
            return path.read_bytes(), path.name == "__init__.py"
    return None


# The names in each source that was read; for the process.
@cache
def _imported(source: bytes, *, package: str) -> tuple[str, ...]:
    """Return the full names that a source may import; some are no modules."""
    names: list[str] = []
    try:
        nodes: list[ast.AST] = [ast.parse(source)]
    except (SyntaxError, ValueError):  # the import itself reports it
        return ()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            above = parts[: len(parts) - node.level + 1] if node.level else []
            base = ".".join([*above, *filter(None, [node.module])])
            prefix = f"{base}." if base else ""
            names += (base, *(f"{prefix}{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Constant):
            if isinstance(node.value, str) and _MODULE.fullmatch(node.value):
                names.append(node.value.partition(":")[0])  # for import_module
        elif isinstance(node, ast.If) and ast.unparse(node.test).endswith(
            "TYPE_CHECKING"
        ):
            nodes += node.orelse
        else:
            nodes += ast.iter_child_nodes(node)
    return tuple(names)
