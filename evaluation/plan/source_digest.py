"""Digests of source files: of one module with all that it imports, or of all code.

`source_digest` is for the keys of cells: they change with the modules that compute them
alone. `code_hash` covers all code that cells may come from. It tells whether two
processes, or two runs, have the same.
"""

import ast
import hashlib
import re
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Final, TypeAlias

import isac_track
from evaluation.plan.origins import OURS

DIGITS: Final = 16
"""Digits of a digest in the keys of cells, and of that of all code."""
_NOT_COUNTED: Final = re.compile(
    r"evaluation|evaluation\.plan\.presets|isac_track\.plugins"
    r"|(attacks|isac_track)\.(templates|testing)(\..*)?"
)
"""Modules that no number of a cell comes from.

Presets and the table of plug-ins name computations, kits test them, and templates are
copied for new plug-ins.
"""
_FOR_TYPES_ALONE: Final = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
_WHEN_RUN: Final = tuple(f"not {test}" for test in _FOR_TYPES_ALONE)
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
        if not _NOT_COUNTED.fullmatch(module):
            sha.update(name.encode() + b"\0" + path.read_bytes())
    return sha.hexdigest()[:DIGITS]


@dataclass(frozen=True, slots=True)
class _ModuleFile:
    """A module's file: its sha256, and the full names that it may import."""

    sha256: bytes
    imports: tuple[str, ...]


ModuleFiles: TypeAlias = dict[
    tuple[Path | None, tuple[str, ...], str], _ModuleFile | None
]
"""Files of modules by (folder, packages that count, name); None without a file."""


def source_digest(module: str, *, known: ModuleFiles | None = None) -> str:
    """Return the sha256 of a module and of all modules beside it that it imports.

    These are its own top-level package and, unless it was installed, all modules in the
    same folder as that; the project's own packages count as a folder. A module without
    a file, such as `__main__`, has the digest of no bytes.

    Imports are read from the sources, lazy imports too, and none is run. To look up the
    file of `module` itself, Python imports the packages around it. Of imports by a string
    only those of the project's own packages are seen, where the string is the whole name.
    Imports for types alone do not count.

    `known` holds files that are not read again, and takes those that are read. It is
    for digests of one plan: most of their files are the same.
    """
    root, packages = _import_root(module)
    known = {} if known is None else known
    digests: dict[str, bytes] = {}
    names, seen = [module], set[str]()
    while names:
        name = names.pop()
        if name in seen:
            continue
        seen.add(name)
        if (root, packages, name) not in known:
            known[root, packages, name] = _read_file(name, root=root, packages=packages)
        source = known[root, packages, name]
        if source is not None:
            digests[name] = source.sha256
            names += source.imports
    sha = hashlib.sha256()
    for name, file_digest in sorted(digests.items()):
        sha.update(name.encode() + b"\0" + file_digest)
    return sha.hexdigest()


def short_digest(module: str, *, known: ModuleFiles | None = None) -> str:
    """Return the first `DIGITS` of `source_digest`, as in the keys of cells."""
    return source_digest(module, known=known)[:DIGITS]


def _read_file(
    name: str, *, root: Path | None, packages: tuple[str, ...]
) -> _ModuleFile | None:
    """Read the file of a module; None where there is none, or it does not count."""
    content = _read_source(name, root=root, packages=packages)
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
        if has_source(module) and short_digest(module, known=known) != was
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


def _read_source(
    name: str, *, root: Path | None, packages: tuple[str, ...]
) -> tuple[bytes, bool] | None:
    """Return the bytes of a module's file and whether it is a package's; None without.

    None, too, for a module of another package than those that count, by `packages`.
    """
    is_outside = packages and name.partition(".")[0] not in packages
    if root is None or not name or is_outside or _NOT_COUNTED.fullmatch(name):
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
        # Imports for types alone do not count.
        elif isinstance(node, ast.If) and ast.unparse(node.test) in _FOR_TYPES_ALONE:
            nodes += node.orelse
        elif isinstance(node, ast.If) and ast.unparse(node.test) in _WHEN_RUN:
            nodes += node.body
        else:
            nodes += ast.iter_child_nodes(node)
    return tuple(names)
