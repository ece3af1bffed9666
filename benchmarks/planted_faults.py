"""Plant one-line faults, one at a time, and count those that the tests notice.

`python benchmarks/planted_faults.py --tree DIR` works on a copy of the tree. The tests run once
with coverage.py, which tells which of them reach which line; a fault is then shown only to those
that reach it, the fastest first, until one fails. What fixtures reach is reached by all tests of
their file. A line that no test reaches in its own process
(those of workers) is shown to a few end-to-end tests. The draw depends on the seed and on the
tree alone: every statement of the package weighs as much as it has lines.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

try:
    import coverage
except ImportError:  # the benchmark says so
    coverage = None

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

ROOT = Path(__file__).resolve().parent.parent
END_TO_END = tuple(
    f"test_{name}*" for name in ("matrix", "command", "run", "execute", "dask", "faults")
)
"""Names of test files that are shown the lines that no test reaches in its own process."""
_HANGS_S: Final = 60.0
"""Tests that take this much, and 20 times what they took, hang: the fault is noticed."""
_NOT_COPIED = shutil.ignore_patterns(".git", "*.pyc", ".*_cache", ".hypothesis", "mutants")
_NOT_RUN = re.compile("TYPE_CHECKING|__main__")
_NOT_OF_STATEMENT = ("annotation", "returns", "decorator_list", "bases", "keywords")
_PROSE = frozenset({"help", "description", "epilog", "metavar"})
_WORD = re.compile(r"[A-Za-z0-9_.-]+")
_SWAPPED: Final = {
    one: other
    for pair in (
        *((ast.Lt, ast.GtE), (ast.Gt, ast.LtE), (ast.Eq, ast.NotEq), (ast.In, ast.NotIn)),
        *((ast.Is, ast.IsNot), (ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.FloorDiv, ast.Mod)),
        *((ast.BitAnd, ast.BitOr), (ast.And, ast.Or)),
    )
    for one, other in (pair, reversed(pair))
}
_NAMES_SWAPPED = {
    one: other
    for pair in ("min max", "any all", "nanmin nanmax", "argmin argmax", "minimum maximum")
    for one, other in (pair.split(), reversed(pair.split()))
}

Rewrite: TypeAlias = "tuple[str, ast.AST, str]"
"""Kind of fault, what is replaced, and the text instead."""


class Statement(NamedTuple):
    """A statement without those that stand in it: file below the root of the tree, and lines."""

    file: str
    first: int
    last: int
    reached_by: range
    """Lines whose tests are those of the statement; empty: those that use what it names."""
    names: tuple[str, ...]
    """What a statement outside of any function gives a value."""
    rewrites: tuple[Rewrite, ...]


def statements(path: Path, *, root: Path) -> list[Statement]:
    """Return the statements of a file in which a fault can be planted."""
    found: list[Statement] = []

    def visit(body: Sequence[ast.stmt], *, inside: bool, owner: str) -> None:
        for node in body:
            if isinstance(node, ast.If) and _NOT_RUN.search(ast.unparse(node.test)):
                continue
            inner = [getattr(node, name, []) for name in ("body", "orelse", "finalbody")]
            inner += [one.body for name in ("handlers", "cases") for one in getattr(node, name, [])]
            inner = [part for part in inner if part]
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            first = node.lineno
            last = min(part[0].lineno for part in inner) - 1 if inner else node.end_lineno
            last = max(first, last or first)
            lines = range(first, last + 1)
            if is_function:  # its defaults have their values before it runs
                lines = range(inner[0][0].lineno, (node.end_lineno or last) + 1)
            rewrites = tuple(_rewrites(node))
            if rewrites:
                given = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
                assigned = (one.id for one in given if isinstance(one.ctx, ast.Store))
                is_in = inside or is_function
                names = () if is_in else (owner,) if owner else tuple(assigned)
                lines = lines if is_in else range(0)
                file = str(path.relative_to(root))
                found.append(Statement(file, first, last, lines, names, rewrites))
            below = node.name if isinstance(node, ast.ClassDef) else owner
            for part in inner:
                visit(part, inside=inside or is_function, owner=below)

    visit(ast.parse(path.read_bytes()).body, inside=False, owner="")
    return found


def _rewrites(node: ast.stmt) -> Iterator[Rewrite]:
    """Yield every fault of a statement."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring
    if isinstance(node, ast.If | ast.While | ast.Assert):
        yield "condition negated", node.test, f"not ({ast.unparse(node.test)})"
    if isinstance(node, ast.Return) and node.value is not None:
        yield "return value replaced", node.value, "None"
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "call dropped", node, "pass"
    if isinstance(node, ast.AugAssign) and type(node.op) in _SWAPPED:
        yield "operator swapped", node, _with(node, op=_SWAPPED[type(node.op)]())
    for one in _expressions(node):
        yield from _of_call(one) if isinstance(one, ast.Call) else _of_expression(one)
        for test in [one.test] if isinstance(one, ast.IfExp) else getattr(one, "ifs", []):
            yield "condition negated", test, f"(not ({ast.unparse(test)}))"


def _expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions of a statement that are run with it; none of text to be read."""
    for name, value in ast.iter_fields(node):
        if name in _NOT_OF_STATEMENT and isinstance(node, ast.stmt | ast.arg):
            continue
        for child in value if isinstance(value, list) else [value]:
            # Places within an f-string are not those of the file in Python 3.11.
            if isinstance(child, ast.JoinedStr | ast.stmt | ast.excepthandler | ast.match_case):
                continue
            if isinstance(child, ast.AST) and getattr(child, "arg", None) not in _PROSE:
                yield child
                yield from _expressions(child)


def _of_expression(node: ast.AST) -> Iterator[Rewrite]:
    if isinstance(node, ast.Constant):
        changes = {
            bool: lambda value: str(not value),
            int: lambda value: repr(value + 1),
            float: lambda value: repr(2.0 * value or 1.0),
            str: lambda value: repr(value + "x") if _WORD.fullmatch(value) else None,
        }
        text = changes.get(type(node.value), lambda _value: None)(node.value)
        if text is not None:
            yield "constant changed", node, text
    elif isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            if type(op) in _SWAPPED:
                ops = [*node.ops[:place], _SWAPPED[type(op)](), *node.ops[place + 1 :]]
                yield "comparison flipped", node, f"({_with(node, ops=ops)})"
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in _SWAPPED:
        yield "operator swapped", node, f"({_with(node, op=_SWAPPED[type(node.op)]())})"
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield "sign or not dropped", node, f"({ast.unparse(node.operand)})"


def _of_call(node: ast.Call) -> Iterator[Rewrite]:
    for one in node.keywords:
        if one.arg is not None and one.arg not in _PROSE:
            fewer = [other for other in node.keywords if other is not one]
            yield "argument dropped", node, _with(node, keywords=fewer)
    key = "id" if isinstance(node.func, ast.Name) else "attr"
    other = _NAMES_SWAPPED.get(getattr(node.func, key, ""))
    if other:
        yield "function swapped", node.func, _with(node.func, **{key: other})


def _with(node: ast.AST, **changes: object) -> str:
    """Return the text of a node with some of its fields changed."""
    changed = copy.copy(node)
    for name, value in changes.items():
        setattr(changed, name, value)
    return ast.unparse(changed)


def rewritten(source: bytes, node: ast.expr | ast.stmt, text: str) -> bytes:
    """Return a source with the text of one node replaced."""
    lines = source.splitlines(keepends=True)
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    return source[:start] + text.encode() + source[end:]


def drawn(
    found: Sequence[Statement], *, root: Path, count: int, seed: int
) -> Iterator[tuple[Statement, dict[str, Any], bytes]]:
    """Yield some statements, no two alike, each with a fault and the file that holds it.

    The kind of a fault is drawn from those that its statement can have, then the fault itself.
    """
    rng = np.random.default_rng(seed)
    weights = np.array([one.last - one.first + 1.0 for one in found])
    order = rng.choice(len(found), size=len(found), replace=False, p=weights / weights.sum())
    for one in (found[place] for place in order):
        kinds = sorted({kind for kind, _, _ in one.rewrites})
        kind = kinds[rng.integers(len(kinds))]
        choices = [rewrite for rewrite in one.rewrites if rewrite[0] == kind]
        _, node, text = choices[rng.integers(len(choices))]
        source = (root / one.file).read_bytes()
        faulty = rewritten(source, node, text)
        with contextlib.suppress(SyntaxError):
            if count > 0 and ast.dump(ast.parse(faulty)) != ast.dump(ast.parse(source)):
                count -= 1
                before = ast.get_source_segment(source.decode(), node) or ""
                fault = {"file": one.file, "line": node.lineno, "kind": kind}
                yield one, fault | {"before": before, "after": text}, faulty


def pytest(
    tests: Sequence[str], *, root: Path, limit_s: float | None = None, measured: Path | None = None
) -> tuple[dict[str, float], list[str], str]:
    """Run tests in a copy of the tree: all with coverage, or up to the first failure.

    Returns the seconds of every test that ran, those that failed, and how it ended if that was odd.
    """
    said = root.parent / "said.xml"
    said.unlink(missing_ok=True)
    words = [sys.executable, "-m"]
    words += ["coverage", "run", f"--rcfile={measured}", "-m"] if measured else []
    words += ["pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={said}", *tests]
    words += [f"--basetemp={root.parent / 'pytest'}", *([] if measured else ["-x"])]
    own = {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    own["HYPOTHESIS_STORAGE_DIRECTORY"] = str(root.parent / "hypothesis")
    with (root.parent / "output.txt").open("w") as output:
        streams = {"stdout": output, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(
            words, cwd=root, env=os.environ | own, start_new_session=True, **streams
        )
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return {}, [], "time limit"
    try:
        cases = [*ET.parse(said).iter("testcase")]  # noqa: S314 - pytest wrote it
    except (FileNotFoundError, ET.ParseError):  # it died before, or while it told
        return {}, [], f"pytest ended with {code}"
    seconds, failed = {}, []
    for case in cases:
        # A test's class comes after the module of its file.
        parts = case.get("classname", "").split(".")
        lengths = [
            n for n in range(len(parts) + 1) if (root / f"{'/'.join(parts[:n])}.py").is_file()
        ]
        n = max(lengths, default=0)
        name = "::".join([f"{'/'.join(parts[:n])}.py", *parts[n:], case.get("name", "")])
        if case.find("skipped") is None:
            seconds[name] = seconds.get(name, 0.0) + float(case.get("time", 0.0))
        if case.find("failure") is not None or case.find("error") is not None:
            failed.append(name)
    return seconds, failed, ""


def reached(options: argparse.Namespace, *, root: Path) -> dict[str, Any]:
    """Return seconds of all tests that pass, those that fail, and by file and line who reaches it.

    As known already, or of runs with coverage; a file that ends its process costs no other.
    """
    kept = options.reach or root.parent / "reach.json"
    found: dict[str, Any] = {"seconds": {}, "failed": [], "lines": {}, "files": []}
    if kept.is_file():
        found = json.loads(kept.read_text(encoding="utf-8"))
    settings, data = root.parent / "coverage.ini", root.parent / "coverage"
    settings.write_text(
        f"[run]\ndata_file={data}\ndynamic_context=test_function\n"
        f"include={root / options.package}/*\n",
        encoding="utf-8",
    )
    files = [
        str(file.relative_to(root))
        for name in options.tests
        for file in (sorted((root / name).rglob("test_*.py")) or [root / name])
    ]
    for file in [file for file in files if file not in found["files"]]:
        data.unlink(missing_ok=True)
        seconds, failed, note = pytest([file], root=root, measured=settings)
        say(f"{file}, with coverage: {sum(seconds.values()):.0f} s {note}")
        found["failed"] += failed
        found["seconds"] |= {name: took for name, took in seconds.items() if name not in failed}
        found["files"].append(file)
        lines = coverage.CoverageData(str(data))
        lines.read()
        for path in lines.measured_files():
            known = found["lines"].setdefault(str(Path(path).relative_to(root)), {})
            for line, contexts in lines.contexts_by_lineno(path).items():
                # A test's name in its file, or the file where that is not known.
                by = {f"{file}::{one.rpartition('.')[2]}" if one else file for one in contexts}
                known[str(line)] = sorted({*known.get(str(line), ()), *by})
        kept.write_text(json.dumps(found), encoding="utf-8")
    return found


def tests_of(one: Statement, *, reach: dict[str, Any], root: Path, package: str) -> list[str]:
    """Return the tests that reach a statement, or what it gives a value; the fastest first."""

    def contexts(file: str, lines: Iterable[int] | None) -> set[str]:
        known = reach["lines"].get(file, {})
        places = known if lines is None else map(str, lines)
        return {context for place in places for context in known.get(place, ())}

    found = contexts(one.file, one.reached_by)
    if not one.reached_by:
        for path in sorted((root / package).rglob("*.py")):
            nodes = ast.walk(ast.parse(path.read_bytes()))
            named = ((node, getattr(node, "id", getattr(node, "attr", ""))) for node in nodes)
            lines = [node.lineno for node, name in named if name in one.names]
            found |= contexts(str(path.relative_to(root)), lines)
        found = found or contexts(one.file, None)
    tests = []
    for test in reach["seconds"]:
        file, *_, name = test.partition("[")[0].split("::")
        if file in found or f"{file}::{name}" in found:
            tests.append(test)
    return sorted(tests, key=reach["seconds"].__getitem__)


def measure(options: argparse.Namespace, *, scratch: Path) -> list[dict[str, Any]]:
    """Plant the faults in a copy of the tree; return what became of them."""
    root = scratch / "tree"

    def left_out(folder: str, names: list[str]) -> set[str]:
        # Results of runs lie beside the packages; evaluation/runs is one of them.
        return _NOT_COPIED(folder, names) | ({"runs"} if Path(folder) == options.tree else set())

    shutil.copytree(options.tree, root, ignore=left_out)
    reach = reached(options, root=root)
    for test in reach["failed"]:
        say(f"left out, it fails without any fault: {test}")
    paths = sorted((root / options.package).rglob("*.py"))
    found = [one for path in paths for one in statements(path, root=root)]
    faults: list[dict[str, Any]] = []
    finished = earlier(options)
    for one, planted, faulty in drawn(found, root=root, count=options.faults, seed=options.seed):
        fault = finished.get(tuple(planted.values()))
        if fault is None:
            tests = tests_of(one, reach=reach, root=root, package=options.package)
            by = "tests that reach it"
            if not tests:
                by = "end-to-end tests"
                files = {test: Path(test.partition("::")[0]) for test in reach["seconds"]}
                tests = [one for one, at in files.items() if any(map(at.match, options.end_to_end))]
            place, started = root / planted["file"], time.monotonic()
            sound = place.read_bytes()
            place.write_bytes(faulty)
            killed_by, note = judged(tests, reach=reach, root=root, most_s=options.limit)
            place.write_bytes(sound)
            took = round(time.monotonic() - started, 1)
            fault = planted | {"killed_by": killed_by, "seconds": took, "tests": len(tests)}
            fault |= {"shown_to": by, "note": note}
            survived = fault["killed_by"] or "SURVIVED"
            say(f"{len(faults) + 1}: {fault['file']}:{fault['line']} {fault['kind']}: {survived}")
        faults.append(fault)
        write(options, reach, faults)
    return faults


def judged(
    tests: Sequence[str], *, reach: dict[str, Any], root: Path, most_s: float
) -> tuple[str, str]:
    """Run tests; return which failed, if one did, and how it ended if that was odd."""
    if not tests:
        return "", "no test reaches it"
    # Far beyond what they took it is noticed, too: something hangs.
    usual_s = _HANGS_S + 20.0 * sum(reach["seconds"][test] for test in tests)
    names = list(dict.fromkeys(test.partition("[")[0] for test in tests))
    names += [f"--deselect={test}" for test in reach["failed"]]
    _, failed, note = pytest(names, root=root, limit_s=min(most_s, usual_s))
    if note == "time limit" and usual_s < most_s:
        note = "pytest hangs"
    return failed[0] if failed else note if note.startswith("pytest") else "", note


def say(text: str) -> None:
    """Tell how far it is."""
    print(text, file=sys.stderr, flush=True)


def write(options: argparse.Namespace, reach: dict[str, Any], faults: list[dict[str, Any]]) -> None:
    """Write what is known so far as JSON, if a file was asked for."""
    if options.json is not None:
        took = round(sum(reach["seconds"].values()), 1)
        suite = {"tests": len(reach["seconds"]), "seconds": took, "failed": reach["failed"]}
        killed = sum(bool(one["killed_by"]) for one in faults)
        found = {"tree": str(options.tree), "package": options.package, "seed": options.seed}
        found |= {"suite": suite, "planted": len(faults), "killed": killed, "faults": faults}
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def earlier(options: argparse.Namespace) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Return the faults of an earlier start of the same command that was cut short."""
    found: dict[str, Any] = {"faults": []}
    if options.json is not None and options.json.is_file():
        found = json.loads(options.json.read_text(encoding="utf-8"))
        if (found["tree"], found["seed"]) != (str(options.tree), options.seed):
            return {}
    names = ("file", "line", "kind", "before", "after")
    return {tuple(one[name] for name in names): one for one in found["faults"]}


def show(faults: Sequence[dict[str, Any]]) -> None:
    """Print how many faults of each kind were noticed, and every one that was not."""
    planted = Counter(one["kind"] for one in faults)
    killed = Counter(one["kind"] for one in faults if one["killed_by"])
    print(f"{'kind of fault':<24} planted  killed")
    for kind in sorted(planted):
        print(f"{kind:<24} {planted[kind]:>7} {killed[kind]:>7}")
    print(f"{'all':<24} {len(faults):>7} {killed.total():>7}")
    for one in faults:
        if not one["killed_by"]:
            where = f"{one['file']}:{one['line']}: {one['kind']}"
            print(f"\n{where}, survived {one['tests']} {one['shown_to']}")
            print(f"  - {' '.join(one['before'].split())}\n  + {one['after']}")


def parser() -> argparse.ArgumentParser:
    """Return the options of the command."""
    command = argparse.ArgumentParser(
        description="Plant one-line faults, one at a time, and count those the tests notice.",
        epilog="exit codes: 0 done, 2 wrong usage, or coverage.py is missing",
        allow_abbrev=False,
    )
    add = command.add_argument
    add("--tree", type=Path, default=ROOT, metavar="DIR", help="the repository; it is copied")
    add("--package", default="evaluation", help="folder to plant faults in")
    add("--tests", nargs="+", default=["tests/evaluation"], metavar="PATH", help="their tests")
    add("--faults", type=int, default=60, metavar="N")
    add("--seed", type=int, default=1)
    add("--limit", type=float, default=300.0, metavar="S", help="seconds of tests for a fault")
    add("--end-to-end", nargs="+", default=END_TO_END, metavar="GLOB", help="names of test files")
    add("--reach", type=Path, metavar="FILE", help="keep which tests reach what, or go on from it")
    add("--json", type=Path, metavar="FILE", help="write every fault, or go on from it")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    options = parser().parse_args(arguments)
    options.tree = options.tree.resolve()
    if not (options.tree / options.package).is_dir():
        say(f"error: {options.tree} has no folder {options.package}")
        return 2
    if coverage is None:
        say("error: coverage.py is missing: nothing else tells which tests reach a line")
        return 2
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        faults = measure(options, scratch=Path(folder).resolve())
    show(faults)
    return 0


if __name__ == "__main__":
    sys.exit(main())
