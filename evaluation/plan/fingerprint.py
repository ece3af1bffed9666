"""What a cell depends on: the code that computes it, its plug-ins, and the keys made of both."""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sysconfig
from collections.abc import Iterable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import isac_track

if TYPE_CHECKING:
    from evaluation.plan.axes import Axes, Consumer
    from isac_track.plugins import Plugin

SHARING, RECONSTRUCTION = (
    "sharing",
    "reconstruction",
)  # Stages of scenes; others: linkage tasks.
OURS: Final = (
    "isac_track",
    "predictors",
    "attacks",
    "evaluation",
)  # The packages of the project.
_COMMON: Final = (
    "isac_track.datasets",
    "isac_track.place",
    "isac_track.scenes",
    "isac_track.sensing",
    "evaluation.compute.sharing",
    "evaluation.compute.tables",
)
"""Where the releases of every unit of work come from, and what its file holds."""
_STAGES: Final = {
    SHARING: ("evaluation.compute.forecasts", *_COMMON),
    RECONSTRUCTION: ("evaluation.compute.reconstruction", *_COMMON),
}
_LINKAGE: Final = ("evaluation.compute.linkage", "attacks.tasks.build", *_COMMON)
_COMPUTES_NOTHING: Final = re.compile(
    r"evaluation|evaluation\.experiment\.presets|isac_track\.plugins"
    r"|(attacks|isac_track)\.(templates|testing)(\..*)?"
)
"""Presets and the table of plug-ins only name what is computed; kits only test it."""
_MODULE: Final = re.compile(rf"({'|'.join(OURS)})(\.\w+)+(:\w+)?")


def code_hash() -> str:
    """Return a digest of all installed source that cells may come from, which tells runs apart."""
    whole = hashlib.sha256()
    root = Path(isac_track.__file__).parent.parent
    folders = (
        "isac_track",
        "predictors",
        "attacks",
        "evaluation/plan",
        "evaluation/compute",
    )
    for path in sorted(
        path for name in folders for path in (root / name).rglob("*.py")
    ):
        name = path.relative_to(root).as_posix()
        if not _COMPUTES_NOTHING.fullmatch(name.removesuffix(".py").replace("/", ".")):
            whole.update(name.encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()[:16]


def sources(stage: str, *plugins: Plugin) -> tuple[str, ...]:
    """Return the modules whose import closures a stage, or some plug-ins, are computed by."""
    of_stage = _STAGES.get(stage, _LINKAGE) if stage else ()
    return (*of_stage, *(one.origin.partition(":")[0] for one in plugins))


def has_strangers(crossed: Axes) -> bool:
    """Return whether not all plug-ins are ours: others may end their process, or spoil it."""
    consumers = (*crossed.consumers, *(link for _, link in crossed.links))
    used = (one for consumer in consumers for one in consumer.plugins)
    return any(map(is_strange, (*crossed.mechanisms, *used)))


def strangers_in(crossed: Axes) -> dict[str, list[str]]:
    """Return what is not built in by axis, as the columns of the results call it; only if any.

    Of mechanisms these are names without the level; a linker behind a reconstruction
    counts as soon as one of both is not built in.
    """
    links = dict.fromkeys(link for _, link in crossed.links)
    strange = {
        "mechanisms": [one.name for one in crossed.mechanisms if is_strange(one)],
        "predictors": [one.spec for one in crossed.predictors if is_strange(one)],
        "attacks": [
            *(one.spec for one in crossed.attacks if is_strange(one)),
            *(link.spec for link in links if any(map(is_strange, link.plugins))),
        ],
    }
    return {axis: [*dict.fromkeys(names)] for axis, names in strange.items() if names}


def is_strange(plugin: Plugin) -> bool:
    """Return whether a plug-in is none of the project's own."""
    return plugin.origin.partition(":")[0].partition(".")[0] not in OURS


def consumer_key(consumer: Consumer, *, code: Iterable[str], keep_scores: bool) -> str:
    """Return the key of a consumer: its plug-ins, what it is granted, and digests of its code."""
    # That of a linkage attack or control with its raw scores is another.
    has_scores = keep_scores and consumer.kind in {"linkage", "control"}
    content = [
        consumer.spec,
        [
            [one.spec, one.origin, *filter(None, [one.digest])]
            for one in consumer.plugins
        ],
        consumer.knowledge,
        sorted(one.name for one in consumer.granted),
        *code,
        *(["scores"] if has_scores else []),
        *([consumer.world] if consumer.world else []),
    ]
    return digest(content)


def digest(content: object) -> str:
    """Return a short digest of anything that can be written as JSON."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def source_digest(module: str) -> str:
    """Return the sha256 of a module and of all that it imports from beside itself.

    That is its own top-level package and, unless it was installed, whatever stands in
    the same folder as that; the project's own packages are one. Imports are read, not
    run, the lazy ones too; those for types alone do not count, and those that are
    composed at run time are not seen. A module without a file, such as `__main__`, has
    the digest of nothing.
    """
    root, tops = _where(module)
    known: dict[str, bytes] = {}
    names = [module]
    while names:
        name = names.pop()
        found = None if name in known else _read(name, root=root, tops=tops)
        if found is not None:
            known[name], is_package = found
            around = name.rpartition(".")[0]  # packages around it run first
            names += [
                *_imported(known[name], package=name if is_package else around),
                around,
            ]
    whole = hashlib.sha256()
    for name, source in sorted(known.items()):
        whole.update(name.encode() + b"\0" + hashlib.sha256(source).digest())
    return whole.hexdigest()


def can_be_found(module: str) -> bool:
    """Whether there is a file of a module here."""
    return _where(module)[0] is not None


def _where(module: str) -> tuple[Path | None, tuple[str, ...]]:
    """Return the folder that a module is imported from, and which packages in it count."""
    try:
        found = find_spec(module)
    except (ValueError, ImportError):  # a script that runs; a package that is gone
        found = None
    if found is None or not found.origin or not Path(found.origin).is_file():
        return None, ()
    path, top = Path(found.origin), module.partition(".")[0]
    root = path.parents[module.count(".") + (path.name == "__init__.py")]
    if top in OURS:
        return root, OURS
    return root, (
        (top,) if root in {Path(one) for one in sysconfig.get_paths().values()} else ()
    )


def _read(
    name: str, *, root: Path | None, tops: tuple[str, ...]
) -> tuple[bytes, bool] | None:
    is_strange = tops and name.partition(".")[0] not in tops
    if root is None or not name or is_strange or _COMPUTES_NOTHING.fullmatch(name):
        return None
    place = root.joinpath(*name.split("."))
    for path in (place.with_name(f"{place.name}.py"), place / "__init__.py"):
        if path.is_file():
            return path.read_bytes(), path.name == "__init__.py"
    return None


@cache
def _imported(source: bytes, *, package: str) -> tuple[str, ...]:
    """Return the full names of what a source may import; some are no modules."""
    names: list[str] = []
    try:
        nodes: list[ast.AST] = [ast.parse(source)]
    except (SyntaxError, ValueError):  # it is told when somebody imports it
        return ()
    while nodes:
        node = nodes.pop()
        if isinstance(node, ast.Import):
            names += (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join(
                [*(above if node.level else []), *filter(None, [node.module])]
            )
            names += (
                base,
                *(f"{base}.{one.name}" if base else one.name for one in node.names),
            )
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
