"""Plant one-line faults, one at a time, and count those that the tests notice.

`python benchmarks/planted_faults.py --tree DIR` works on two copies of the tree. The tests run once
with a probe at the place of every fault, which tells which of them get there, in whatever process;
a fault is then shown only to those, the fastest first, until one fails. The draw depends on the
seed and on the tree alone: every statement of the package weighs as much as it has lines.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import importlib.util
import json
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

ROOT = Path(__file__).resolve().parent.parent
PROBE = Path(__file__).with_name("planted_probe.py")
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
    before: int
    """Line before which it can be told that the statement is reached; 0: outside of functions."""
    names: tuple[str, ...]
    """What a statement outside of any function gives a value."""
    rewrites: tuple[Rewrite, ...]


def statements(path: Path, *, root: Path) -> list[Statement]:
    """Return all statements of a file, with the faults that can be planted in each."""
    source = path.read_bytes()
    text = source.splitlines()
    found: list[Statement] = []

    def visit(body: Sequence[ast.stmt], *, inside: bool, owner: str, before: int = 0) -> None:
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
            # No line can stand before an elif; defaults have their values before a function runs.
            place = before if text[first - 1].lstrip().startswith(b"elif") else first
            if is_function:
                place = next((one.lineno for one in inner[0] if not _is_text(one)), 0)
            is_in = inside or is_function
            given = [one for one in ast.walk(node) if isinstance(one, ast.Name)]
            assigned = (one.id for one in given if isinstance(one.ctx, ast.Store))
            names = () if is_in else (owner,) if owner else tuple(assigned)
            file = str(path.relative_to(root))
            rewrites = tuple(_rewrites(node))
            found.append(Statement(file, first, last, place * is_in, names, rewrites))
            below = node.name if isinstance(node, ast.ClassDef) else owner
            for part in inner:
                visit(part, inside=is_in, owner=below, before=place)

    visit(ast.parse(source).body, inside=False, owner="")
    return found


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _rewrites(node: ast.stmt) -> Iterator[Rewrite]:
    """Yield every fault of a statement."""
    if _is_text(node):
        return
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
    found = [one for one in found if one.rewrites]
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


def probed(source: bytes, *, faults: Mapping[int, Iterable[int]]) -> bytes:
    """Return a source that says, before some of its lines, that the places of faults are reached.

    The lines that are there stay what they are.
    """
    lines = source.splitlines(keepends=True)
    for number, which in sorted(faults.items(), reverse=True):
        line = lines[number - 1]
        indent = line[: len(line) - len(line.lstrip())]
        names = ", ".join(repr(str(fault)) for fault in sorted(which))
        lines.insert(number - 1, indent + f"__import__('{PROBE.stem}').hit({names})\n".encode())
    return b"".join(lines)


def places(one: Statement, *, found: Sequence[Statement], root: Path) -> set[tuple[str, int]]:
    """Return where it shows that a statement is reached: file and line before which to ask.

    For one outside of functions, where what it gives a value is used; all of its file if nowhere.
    """
    if one.before:
        return {(one.file, one.before)}
    used: set[tuple[str, int]] = set()
    for file in {other.file for other in found}:
        nodes = ast.walk(ast.parse((root / file).read_bytes()))
        named = ((node, getattr(node, "id", getattr(node, "attr", ""))) for node in nodes)
        used |= {(file, node.lineno) for node, name in named if name in one.names}
    inside = [other for other in found if other.before]
    at = {
        (other.file, other.before)
        for other in inside
        if any((other.file, line) in used for line in range(other.first, other.last + 1))
    }
    return at or {(other.file, other.before) for other in inside if other.file == one.file}


class Told(NamedTuple):
    """What the tests said: seconds of each, how it ended, and by fault which of them reach it."""

    seconds: dict[str, float]
    failed: list[str]
    reached_by: dict[str, set[str]]
    note: str
    """How it ended, if that was odd."""


def pytest(words: Sequence[str], *, root: Path, limit_s: float | None = None) -> Told:
    """Run tests in a copy of the tree."""
    record = root.parent / "record"
    record.write_text("")
    own = {"PYTHONPATH": os.pathsep.join([str(root), str(root.parent)]), "PLANTED_RECORD": record}
    # It may be a test that asks, in a process of pytest-xdist.
    inherited = {name: one for name, one in os.environ.items() if not name.startswith("PYTEST_")}
    own |= {"PYTHONDONTWRITEBYTECODE": "1", "HYPOTHESIS_STORAGE_DIRECTORY": root.parent / "found"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", PROBE.stem]
    command += [f"--basetemp={root.parent / 'pytest'}", *words]
    with (root.parent / "output.txt").open("w") as output:
        process = subprocess.Popen(
            command,
            cwd=root,
            env=inherited | own,
            start_new_session=True,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        note = ""
        try:
            code = process.wait(limit_s)
            note = "" if code in (0, 1) else f"pytest ended with {code}"
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            note = "time limit"
    return _told(record, note=note)


def _told(record: Path, *, note: str) -> Told:
    seconds: dict[str, float] = defaultdict(float)
    failed: dict[str, None] = {}
    users, hits = defaultdict(set), defaultdict(set)
    for words in map(json.loads, record.read_text(encoding="utf-8").splitlines()):
        what, test, *more = words
        if what == "hit":
            for fault in more[1:]:
                hits[fault].add((test, more[0]))
        elif what == "uses":
            for fixture in more:
                users[fixture].add(test)
        elif more[0] == "failed":
            failed[test] = None
        elif more[0] == "passed":
            seconds[test] += more[1]
    reached = {fault: {test for test, _ in by} for fault, by in hits.items()}
    for fault, by in hits.items():
        reached[fault] = reached[fault].union(*(users[fixture] for _, fixture in by if fixture))
    passed = {test: took for test, took in seconds.items() if test not in failed}
    return Told(passed, list(failed), reached, note)


def measure(options: argparse.Namespace, *, scratch: Path) -> list[dict[str, Any]]:
    """Plant the faults in copies of the tree; return what became of them."""

    def left_out(folder: str, names: list[str]) -> set[str]:
        # Results of runs lie beside the packages; evaluation/runs is one of them.
        return _NOT_COPIED(folder, names) | ({"runs"} if Path(folder) == options.tree else set())

    free: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for name in ("first", "second"):
        shutil.copytree(options.tree, scratch / name / "tree", ignore=left_out)
        shutil.copy(PROBE, scratch / name)
        free.put(scratch / name / "tree")
    root = free.get()
    paths = sorted((root / options.package).rglob("*.py"))
    found = [one for path in paths for one in statements(path, root=root)]
    faults = list(drawn(found, root=root, count=options.faults, seed=options.seed))
    told = reached(options, statements=[one for one, _, _ in faults], found=found, root=root)
    free.put(root)

    def shown(number: int) -> dict[str, Any]:
        _, planted, faulty = faults[number]
        tests = sorted(
            told.reached_by.get(str(number), set()) & told.seconds.keys(),
            key=told.seconds.__getitem__,
        )
        root, started = free.get(), time.monotonic()
        place = root / planted["file"]
        sound = place.read_bytes()
        place.write_bytes(faulty)
        killed_by, note = judged(tests, told=told, root=root, most_s=options.limit)
        place.write_bytes(sound)
        free.put(root)
        took = round(time.monotonic() - started, 1)
        return planted | {
            "killed_by": killed_by,
            "seconds": took,
            "tests": len(tests),
            "note": note,
        }

    done: list[dict[str, Any]] = []
    with ThreadPoolExecutor(max_workers=2) as pool:
        for fault in pool.map(shown, range(len(faults))):
            done.append(fault)
            survived = fault["killed_by"] or "SURVIVED"
            say(f"{len(done)}: {fault['file']}:{fault['line']} {fault['kind']}: {survived}")
            write(options, told, done)
    return done


def reached(
    options: argparse.Namespace,
    *,
    statements: Sequence[Statement],
    found: Sequence[Statement],
    root: Path,
) -> Told:
    """Run all tests, two at a time where pytest-xdist is at hand, with a probe for every fault."""
    asked: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for number, one in enumerate(statements):
        for file, line in places(one, found=found, root=root):
            asked[file][line].add(number)
    sound = {file: (root / file).read_bytes() for file in asked}
    for file, lines in asked.items():
        (root / file).write_bytes(probed(sound[file], faults=lines))
    two = ["-n", "2", "--dist", "loadfile"] if importlib.util.find_spec("xdist") else []
    told = pytest([*two, *options.tests], root=root)
    for file, source in sound.items():
        (root / file).write_bytes(source)
    say(f"{len(told.seconds)} tests pass, {sum(told.seconds.values()):.0f} s {told.note}")
    for test in told.failed:
        say(f"left out, it fails without any fault: {test}")
    return told


def judged(tests: Sequence[str], *, told: Told, root: Path, most_s: float) -> tuple[str, str]:
    """Run tests; return which failed, if one did, and how it ended if that was odd."""
    if not tests:
        return "", "no test reaches it"
    # Far beyond what they took it is noticed, too: something hangs.
    usual_s = _HANGS_S + 20.0 * sum(told.seconds[test] for test in tests)
    names = list(dict.fromkeys(test.partition("[")[0] for test in tests))
    names += [f"--deselect={test}" for test in told.failed]
    now = pytest(["-x", *names], root=root, limit_s=min(most_s, usual_s))
    note = "pytest hangs" if now.note == "time limit" and usual_s < most_s else now.note
    return now.failed[0] if now.failed else note if note.startswith("pytest") else "", note


def say(text: str) -> None:
    """Tell how far it is."""
    print(text, file=sys.stderr, flush=True)


def write(options: argparse.Namespace, told: Told, faults: list[dict[str, Any]]) -> None:
    """Write what is known so far as JSON, if a file was asked for."""
    if options.json is not None:
        took = round(sum(told.seconds.values()), 1)
        suite = {"tests": len(told.seconds), "seconds": took, "failed": told.failed}
        killed = sum(bool(one["killed_by"]) for one in faults)
        found = {"tree": str(options.tree), "package": options.package, "seed": options.seed}
        found |= {"suite": suite, "planted": len(faults), "killed": killed, "faults": faults}
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


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
            print(f"\n{where}, survived {one['tests']} tests that reach it")
            print(f"  - {' '.join(one['before'].split())}\n  + {one['after']}")


def parser() -> argparse.ArgumentParser:
    """Return the options of the command."""
    command = argparse.ArgumentParser(
        description="Plant one-line faults, one at a time, and count those the tests notice.",
        epilog="exit codes: 0 done, 2 wrong usage",
        allow_abbrev=False,
    )
    add = command.add_argument
    add("--tree", type=Path, default=ROOT, metavar="DIR", help="the repository; it is copied")
    add("--package", default="evaluation", help="folder to plant faults in")
    add("--tests", nargs="+", default=["tests/evaluation"], metavar="PATH", help="their tests")
    add("--faults", type=int, default=60, metavar="N")
    add("--seed", type=int, default=1)
    add("--limit", type=float, default=300.0, metavar="S", help="seconds of tests for a fault")
    add("--json", type=Path, metavar="FILE", help="write every fault")
    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    options = parser().parse_args(arguments)
    options.tree = options.tree.resolve()
    if not (options.tree / options.package).is_dir():
        say(f"error: {options.tree} has no folder {options.package}")
        return 2
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        faults = measure(options, scratch=Path(folder).resolve())
    show(faults)
    return 0


if __name__ == "__main__":
    sys.exit(main())
