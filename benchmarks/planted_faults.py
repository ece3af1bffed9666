"""Plant one-line faults, one at a time, and count those that the tests notice.

`python benchmarks/planted_faults.py --tree DIR` works on a copy of the tree. The tests run once
with coverage.py, which tells which of them reach which line; a fault is then shown only to those
that reach it, the fastest first, until one fails. A line that no test reaches in its own process
(those of workers) is shown to a few end-to-end tests. The draw depends on the seed and on the
tree alone: every statement of the package weighs as much as it has lines.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import math
import multiprocessing
import os
import re
import shutil
import signal
import site
import sys
import tempfile
import time
import traceback
import types
import warnings
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeAlias

import numpy as np
import pytest

try:
    import coverage
except ImportError:  # the benchmark says so
    coverage = None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from coverage import Coverage

ROOT = Path(__file__).resolve().parent.parent
END_TO_END = (
    "test_matrix*",
    "test_command*",
    "test_run*",
    "test_execute*",
    "test_workers*",
    "test_cluster*",
    "test_dask*",
)
"""Names of test files that are shown the lines that no test reaches in its own process."""
HANGS_S: Final = 60.0
"""A test that takes this much, and 20 times what it took, hangs: the fault is noticed."""
_HEAVY = ("scipy.stats", "pandas", "numba", "sklearn.base", "matplotlib.figure")
_NOT_COPIED = shutil.ignore_patterns(".git", "*.pyc", ".*_cache", ".hypothesis", "mutants")
_PROSE = frozenset({"help", "description", "epilog", "metavar"})
_WORD = re.compile(r"[A-Za-z0-9_.-]+")
_SWAPPED: dict[type[ast.AST], type[ast.AST]] = {}
for _one, _other in (
    (ast.Lt, ast.GtE),
    (ast.Gt, ast.LtE),
    (ast.Eq, ast.NotEq),
    (ast.In, ast.NotIn),
    (ast.Is, ast.IsNot),
    (ast.Add, ast.Sub),
    (ast.Mult, ast.Div),
    (ast.FloorDiv, ast.Mod),
    (ast.BitAnd, ast.BitOr),
    (ast.And, ast.Or),
):
    _SWAPPED |= {_one: _other, _other: _one}
_NAMES_SWAPPED = {
    one: other
    for pair in ("min max", "any all", "nanmin nanmax", "argmin argmax", "minimum maximum")
    for one, other in (pair.split(), reversed(pair.split()))
}

Rewrite: TypeAlias = "tuple[str, ast.AST, str]"
"""Kind of fault, what is replaced, and the text instead."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement without those that stand in it."""

    file: str
    """Below the root of the tree."""
    first: int
    """Line"""
    last: int
    reached_by: range
    """Lines whose tests are those of the statement; empty: those that use what it names."""
    names: tuple[str, ...]
    """What a statement outside of any function gives a value."""
    rewrites: tuple[Rewrite, ...]


@dataclass(slots=True)
class Fault:
    """One planted fault and what became of it."""

    file: str
    line: int
    kind: str
    before: str
    after: str
    killed_by: str = ""
    """Test that failed; empty: none did."""
    seconds: float = 0.0
    tests: int = 0
    """Number of tests that it was shown to."""
    shown_to: str = "tests that reach it"
    note: str = ""


@dataclass(slots=True)
class Reach:
    """Which tests reach which lines, and how long they take."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Of every test that passes, without its shared fixtures."""
    shared: dict[str, list[str]] = field(default_factory=dict)
    """Fixtures of more than one test that a test uses."""
    shared_seconds: dict[str, float] = field(default_factory=dict)
    lines: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    """By file and line, the tests and shared fixtures that run it."""
    failed: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    """Of tests that were run."""


def statements(path: Path, *, root: Path) -> list[Statement]:
    """Return the statements of a file in which a fault can be planted."""
    tree = ast.parse(path.read_bytes())
    found: list[Statement] = []

    def visit(body: Sequence[ast.stmt], *, function: ast.AST | None, owner: str) -> None:
        for node in body:
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                continue
            if isinstance(node, ast.If) and "__main__" in ast.unparse(node.test):
                continue
            inner = [part for part in _bodies(node) if part]
            is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            first = node.lineno
            last = min(part[0].lineno for part in inner) - 1 if inner else node.end_lineno
            last = max(first, last or first)
            lines = range(first, last + 1)
            if is_function:  # its defaults have their values before it runs
                lines = range(inner[0][0].lineno, (node.end_lineno or last) + 1)
            rewrites = tuple(_rewrites(node))
            if rewrites:
                inside = function is not None or is_function
                names = () if inside else (owner,) if owner else tuple(_assigned(node))
                found.append(
                    Statement(
                        file=str(path.relative_to(root)),
                        first=first,
                        last=last,
                        reached_by=lines if inside else range(0),
                        names=names,
                        rewrites=rewrites,
                    )
                )
            for part in inner:
                visit(
                    part,
                    function=node if is_function else function,
                    owner=node.name if isinstance(node, ast.ClassDef) else owner,
                )

    visit(tree.body, function=None, owner="")
    return found


def _bodies(node: ast.stmt) -> list[list[ast.stmt]]:
    bodies = [getattr(node, name, []) for name in ("body", "orelse", "finalbody")]
    bodies += [handler.body for handler in getattr(node, "handlers", [])]
    return bodies + [case.body for case in getattr(node, "cases", [])]


def _assigned(node: ast.stmt) -> list[str]:
    return [
        one.id
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    ]


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
        yield "operator swapped", node, ast.unparse(_with(node, op=_SWAPPED[type(node.op)]()))
    for one in _expressions(node):
        yield from _of_expression(one)


def _expressions(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the expressions of a statement that are run with it; none of text to be read."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "bases", "keywords") and isinstance(
            node, ast.stmt | ast.arg
        ):
            continue
        for child in value if isinstance(value, list) else [value]:
            # Places within an f-string are not those of the file in Python 3.11.
            if isinstance(child, ast.JoinedStr | ast.stmt | ast.excepthandler | ast.match_case):
                continue
            if isinstance(child, ast.keyword) and child.arg in _PROSE:
                continue
            if isinstance(child, ast.AST):
                yield child
                yield from _expressions(child)


def _of_expression(node: ast.AST) -> Iterator[Rewrite]:
    if isinstance(node, ast.Constant):
        yield from _of_constant(node)
    elif isinstance(node, ast.Call):
        yield from _of_call(node)
    elif isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            if type(op) in _SWAPPED:
                ops = [*node.ops[:place], _SWAPPED[type(op)](), *node.ops[place + 1 :]]
                yield "comparison flipped", node, _text(_with(node, ops=ops))
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in _SWAPPED:
        yield "operator swapped", node, _text(_with(node, op=_SWAPPED[type(node.op)]()))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield "sign or not dropped", node, _text(node.operand)
    tests = [node.test] if isinstance(node, ast.IfExp) else getattr(node, "ifs", [])
    for test in tests:
        yield "condition negated", test, f"(not ({ast.unparse(test)}))"


def _of_constant(node: ast.Constant) -> Iterator[Rewrite]:
    value = node.value
    if isinstance(value, bool):
        yield "constant changed", node, str(not value)
    elif isinstance(value, int):
        yield "constant changed", node, repr(value + 1)
    elif isinstance(value, float):
        yield "constant changed", node, repr(2.0 * value or 1.0)
    elif isinstance(value, str) and _WORD.fullmatch(value):
        yield "constant changed", node, repr(value + "x")


def _of_call(node: ast.Call) -> Iterator[Rewrite]:
    for one in node.keywords:
        if one.arg is not None and one.arg not in _PROSE:
            fewer = [other for other in node.keywords if other is not one]
            yield "argument dropped", node, ast.unparse(_with(node, keywords=fewer))
    name = getattr(node.func, "id", getattr(node.func, "attr", ""))
    if name in _NAMES_SWAPPED:
        key = "id" if isinstance(node.func, ast.Name) else "attr"
        other = _with(node.func, **{key: _NAMES_SWAPPED[name]})
        yield "function swapped", node, ast.unparse(_with(node, func=other))


def _with(node: ast.AST, **changes: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in changes.items():
        setattr(changed, name, value)
    return changed


def _text(node: ast.AST) -> str:
    return f"({ast.unparse(node)})"


def rewritten(source: bytes, node: ast.expr | ast.stmt, text: str) -> bytes:
    """Return a source with the text of one node replaced."""
    lines = source.splitlines(keepends=True)
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    return source[:start] + text.encode() + source[end:]


def drawn(
    found: Sequence[Statement], *, root: Path, count: int, seed: int
) -> list[tuple[Statement, Fault, bytes]]:
    """Return some statements, no two alike, each with a fault and the file that holds it.

    The kind of a fault is drawn from those that its statement can have, then the fault itself.
    """
    rng = np.random.default_rng(seed)
    weights = np.array([one.last - one.first + 1.0 for one in found])
    order = rng.choice(len(found), size=len(found), replace=False, p=weights / weights.sum())
    planted = []
    for place in order:
        if len(planted) == count:
            break
        one = found[place]
        kinds = sorted({kind for kind, _, _ in one.rewrites})
        kind = kinds[rng.integers(len(kinds))]
        choices = [rewrite for rewrite in one.rewrites if rewrite[0] == kind]
        _, node, text = choices[rng.integers(len(choices))]
        source = (root / one.file).read_bytes()
        faulty = rewritten(source, node, text)
        try:
            same = ast.dump(ast.parse(faulty)) == ast.dump(ast.parse(source))
        except SyntaxError:
            continue
        if same:
            continue
        before = ast.get_source_segment(source.decode(), node) or ""
        fault = Fault(one.file, node.lineno, kind, before, text)
        planted.append((one, fault, faulty))
    return planted


class _Recorder:
    """A plug-in of pytest: coverage by test and by fixture of several tests, and seconds."""

    def __init__(self, measured: Coverage, say: Callable[..., None]) -> None:
        self.measured, self.say = measured, say
        self.found = Reach()
        self.now = ""
        self.shared_s = 0.0
        """Spent on fixtures of several tests, of the set-up that is under way."""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        for item in items:
            names = item._fixtureinfo.name2fixturedefs.values()  # noqa: SLF001 - nothing else tells
            self.found.shared[item.nodeid] = sorted(
                {_fixture(one) for all_ in names for one in all_ if one.scope != "function"}
            )

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._switch(nodeid)
        self.say(start=nodeid)

    def _switch(self, context: str) -> None:
        self.now = context
        self.measured.switch_context(context)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        before, mine, started = self.now, _fixture(fixturedef), time.monotonic()
        self._switch(mine)
        try:
            return (yield)
        finally:
            took = time.monotonic() - started
            self.found.shared_seconds[mine] = self.found.shared_seconds.get(mine, 0.0) + took
            self.shared_s += took
            self._switch(before)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and report.nodeid not in self.found.failed:
            self.found.failed.append(report.nodeid)
        took = report.duration
        if report.when == "setup":
            took, self.shared_s = max(0.0, took - self.shared_s), 0.0
        if not report.skipped:
            seconds = self.found.seconds
            seconds[report.nodeid] = seconds.get(report.nodeid, 0.0) + took


def record(plan: dict[str, Any], say: Callable[..., None]) -> int:
    """Run all tests with coverage; in a process of its own."""
    measured = coverage.Coverage(
        data_file=None,
        config_file=False,
        include=[str(Path(plan["root"]) / plan["package"] / "*")],
    )
    recorder = _Recorder(measured, say)
    measured.start()
    code = int(pytest.main([*plan["pytest"], *plan["tests"]], plugins=[recorder]))
    with warnings.catch_warnings():  # tests may have made errors of them
        warnings.simplefilter("ignore")
        measured.stop()
        data, found = measured.get_data(), recorder.found
    for file in data.measured_files():
        name = str(Path(file).relative_to(plan["root"]))
        by_line = data.contexts_by_lineno(file)
        found.lines[name] = {str(line): sorted(filter(None, by_line[line])) for line in by_line}
    for one in found.failed:
        found.seconds.pop(one, None)
    Path(plan["reach"]).write_text(json.dumps(asdict(found)), encoding="utf-8")
    return code


def _fixture(one: pytest.FixtureDef) -> str:
    return f"fixture {one.baseid}::{one.argname}"


def judge(plan: dict[str, Any], say: Callable[..., None]) -> int:
    """Run some tests in their order until one fails; in a process of its own."""
    order = {name: place for place, name in enumerate(plan["order"])}

    class Plugin:
        def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
            items[:] = sorted(
                (item for item in items if item.nodeid in order), key=lambda one: order[one.nodeid]
            )

        def pytest_runtest_logstart(self, nodeid: str) -> None:
            say(start=nodeid)

        def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
            if report.failed:
                say(killed_by=report.nodeid)

        def pytest_collectreport(self, report: pytest.CollectReport) -> None:
            if report.failed:
                say(killed_by=f"collection of {report.nodeid}")

    files = list(dict.fromkeys(name.partition("::")[0] for name in plan["order"]))
    return int(pytest.main([*plan["pytest"], "-x", *files], plugins=[Plugin()]))


def in_child(
    work: Callable[[dict[str, Any], Callable[..., None]], int],
    plan: dict[str, Any],
    *,
    scratch: Path,
    limit_s: float,
    usual_s: dict[str, float],
) -> dict[str, Any]:
    """Do something in a process of its own; return what it said last, and whether it ended.

    It is a copy of this one, which has loaded the libraries but nothing of the tree.
    """
    said = scratch / "said.jsonl"
    said.unlink(missing_ok=True)
    started = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _child(work, plan, scratch=scratch, said=said)
    ended, note, now, since = None, "", "", started
    try:
        while ended is None:
            time.sleep(0.05)
            done, status = os.waitpid(pid, os.WNOHANG)
            ended = os.waitstatus_to_exitcode(status) if done else None
            last = _last(said, "start")
            if last != now:
                now, since = last, time.monotonic()
            took = time.monotonic() - since
            if ended is None and now and took > max(HANGS_S, 20.0 * usual_s.get(now, math.inf)):
                note = "hangs"
            elif ended is None and time.monotonic() - started > limit_s:
                note = "time limit"
            if note:
                break
    finally:
        if ended is None:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
    by = _last(said, "killed_by") or (now if note == "hangs" else "")
    return {
        "code": ended,
        "note": note,
        "killed_by": by,
        "seconds": round(time.monotonic() - started, 1),
    }


def _child(
    work: Callable[[dict[str, Any], Callable[..., None]], int],
    plan: dict[str, Any],
    *,
    scratch: Path,
    said: Path,
) -> NoReturn:
    """Do the work with the copy of the tree alone in sight, and end the process."""
    code = 3
    try:
        os.setsid()
        with (scratch / "output.txt").open("w") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        os.chdir(plan["root"])
        os.environ["PYTHONPATH"] = plan["root"]
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = str(scratch / "hypothesis")
        sys.executable = plan["python"]
        multiprocessing.set_executable(plan["python"])
        sys.dont_write_bytecode = True
        sys.path[:] = [plan["root"], *sys.path[1:]]
        # Processes that the tests start would otherwise import this file.
        sys.modules["__main__"] = types.ModuleType("__main__")
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with said.open("a", encoding="utf-8") as file:

            def say(**what: object) -> None:
                file.write(json.dumps(what) + "\n")
                file.flush()

            code = work(plan, say)
    except BaseException:  # noqa: BLE001 - nobody else would tell
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _last(said: Path, key: str) -> str:
    if not said.is_file():
        return ""
    lines = said.read_text(encoding="utf-8").splitlines()
    return next((one[key] for text in reversed(lines) if key in (one := _json(text))), "")


def _json(text: str) -> dict[str, str]:
    try:
        return dict(json.loads(text))
    except ValueError:  # half a line
        return {}


def tests_of(one: Statement, *, reach: Reach, root: Path, package: str) -> set[str]:
    """Return the tests that reach a statement, or what it gives a value."""
    contexts = _contexts(reach, one.file, one.reached_by)
    if not one.reached_by:
        for path in sorted((root / package).rglob("*.py")):
            name = str(path.relative_to(root))
            contexts |= _contexts(reach, name, _lines_naming(path, frozenset(one.names)))
        contexts = contexts or _contexts(reach, one.file, None)
    return {
        test
        for test in reach.seconds
        if test in contexts or not contexts.isdisjoint(reach.shared.get(test, ()))
    }


def _contexts(reach: Reach, file: str, lines: Sequence[int] | None) -> set[str]:
    known = reach.lines.get(file, {})
    places = known if lines is None else map(str, lines)
    return {context for place in places for context in known.get(place, ())}


def _lines_naming(path: Path, names: frozenset[str]) -> list[int]:
    return [
        node.lineno
        for node in ast.walk(ast.parse(path.read_bytes()))
        if (isinstance(node, ast.Name) and node.id in names)
        or (isinstance(node, ast.Attribute) and node.attr in names)
    ]


def fastest_first(tests: set[str], *, reach: Reach) -> list[str]:
    """Return tests in the order to run them: the fastest, then those with fixtures to share."""

    def cost(test: str) -> float:
        return sum(reach.shared_seconds.get(one, 0.0) for one in reach.shared.get(test, ()))

    costs = {test: cost(test) for test in tests}
    by_file: dict[str, float] = defaultdict(float)
    for test in tests:
        file = test.partition("::")[0]
        by_file[file] = max(by_file[file], costs[test])

    def key(test: str) -> tuple[float, str, float]:
        file, own = test.partition("::")[0], reach.seconds[test]
        return (by_file[file], file, own) if costs[test] else (0.0, "", own)

    return sorted(tests, key=key)


def end_to_end(reach: Reach, patterns: Sequence[str]) -> set[str]:
    """Return the tests of the files that have such names."""
    return {
        test
        for test in reach.seconds
        if any(Path(test.partition("::")[0]).match(pattern) for pattern in patterns)
    }


def reached(options: argparse.Namespace, plan: dict[str, Any], *, scratch: Path) -> Reach:
    """Return which tests reach which lines: as known already, or of a run with coverage.

    Every file of tests has a process of its own: one that ends its process costs no other.
    """
    root, reach = Path(plan["root"]), Reach()
    if options.reach is not None and options.reach.is_file():
        reach = Reach(**json.loads(options.reach.read_text(encoding="utf-8")))
    files = [
        str(file.relative_to(root))
        for name in options.tests
        for file in (sorted((root / name).rglob("test_*.py")) or [root / name])
    ]
    for file in [file for file in files if file not in reach.files]:
        Path(plan["reach"]).unlink(missing_ok=True)
        one = plan | {"tests": [file]}
        done = in_child(record, one, scratch=scratch, limit_s=math.inf, usual_s={})
        say(f"{file}, with coverage: ended with {done['code']} after {done['seconds']:.0f} s")
        if not Path(plan["reach"]).is_file():
            say((scratch / "output.txt").read_text(encoding="utf-8")[-3000:])
            continue
        found = Reach(**json.loads(Path(plan["reach"]).read_text(encoding="utf-8")))
        reach.seconds |= found.seconds
        reach.shared |= found.shared
        reach.failed += found.failed
        for name, took in found.shared_seconds.items():
            reach.shared_seconds[name] = max(took, reach.shared_seconds.get(name, 0.0))
        for name, lines in found.lines.items():
            known = reach.lines.setdefault(name, {})
            for line, contexts in lines.items():
                known[line] = sorted({*known.get(line, ()), *contexts})
        reach.files.append(file)
        if options.reach is not None:
            options.reach.write_text(json.dumps(asdict(reach)), encoding="utf-8")
    return reach


def measure(options: argparse.Namespace, *, scratch: Path) -> tuple[Reach, list[Fault]]:
    """Plant the faults in a copy of the tree; return what became of them."""
    root = scratch / "tree"
    shutil.copytree(
        options.tree,
        root,
        # Results of runs lie beside the packages; evaluation/runs is one of them.
        ignore=lambda folder, names: (
            _NOT_COPIED(folder, names) | ({"runs"} if Path(folder) == Path(options.tree) else set())
        ),
    )
    plan: dict[str, Any] = {
        "root": str(root),
        "python": own_python(scratch, root=root),
        "package": options.package,
        "tests": options.tests,
        "reach": str(scratch / "reach.json"),
        "pytest": ["-q", "-p", "no:cacheprovider", f"--basetemp={scratch / 'pytest'}"],
    }
    reach = reached(options, plan, scratch=scratch)
    for test in reach.failed:
        say(f"left out, it fails without any fault: {test}")
    found = [
        one
        for path in sorted((root / options.package).rglob("*.py"))
        for one in statements(path, root=root)
    ]
    faults, finished = [], earlier(options)
    chosen = drawn(found, root=root, count=options.faults, seed=options.seed)
    for number, (one, fault, faulty) in enumerate(chosen, start=1):
        known = finished.get((fault.file, fault.line, fault.before, fault.after))
        if known is not None:
            faults.append(known)
            continue
        tests = tests_of(one, reach=reach, root=root, package=options.package)
        if not tests:
            tests, fault.shown_to = end_to_end(reach, options.end_to_end), "end-to-end tests"
        fault.tests = len(tests)
        order = fastest_first(tests, reach=reach)
        done = {"code": 5, "note": "no test reaches it", "killed_by": "", "seconds": 0.0}
        if order:
            done = shown_to(
                order,
                faulty,
                path=root / fault.file,
                plan=plan,
                limit_s=options.limit,
                usual_s=_with_shared(reach),
                scratch=scratch,
            )
        fault.killed_by, fault.seconds, fault.note = (
            done[key] for key in ("killed_by", "seconds", "note")
        )
        if not fault.killed_by and done["code"] not in (0, 5, None):
            fault.killed_by = f"pytest ended with {done['code']}"
        faults.append(fault)
        say(
            f"{number} of {len(chosen)}: {fault.file}:{fault.line} {fault.kind}: "
            f"{fault.killed_by or 'SURVIVED'} {fault.note} ({fault.seconds:.0f} s)"
        )
        write(options, reach, faults)
    return reach, faults


def shown_to(
    order: Sequence[str],
    faulty: bytes,
    *,
    path: Path,
    plan: dict[str, Any],
    **limits: Any,  # noqa: ANN401 - as of `in_child`
) -> dict[str, Any]:
    """Run tests while a file holds a fault; return what `in_child` does."""
    sound = path.read_bytes()
    path.write_bytes(faulty)
    try:
        return in_child(judge, plan | {"order": order}, **limits)
    finally:
        path.write_bytes(sound)


def _with_shared(reach: Reach) -> dict[str, float]:
    return {
        test: took + sum(reach.shared_seconds.get(one, 0.0) for one in reach.shared.get(test, ()))
        for test, took in reach.seconds.items()
    }


def own_python(scratch: Path, *, root: Path) -> str:
    """Return an interpreter that knows the libraries of this one, and no other copy of the tree."""
    folder = scratch / "python"
    packages = folder / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}"
    packages /= "site-packages"
    packages.mkdir(parents=True)
    (folder / "bin").mkdir()
    (folder / "bin" / "python").symlink_to(Path(sys.base_prefix) / "bin" / "python3")
    (folder / "pyvenv.cfg").write_text(f"home = {sys.base_prefix}/bin\n", encoding="utf-8")
    # A path named here brings its packages, but not what is installed there as editable.
    paths = [str(root), *site.getsitepackages()]
    (packages / "tree.pth").write_text("\n".join(paths) + "\n", encoding="utf-8")
    return str(folder / "bin" / "python")


def say(text: str) -> None:
    """Tell how far it is."""
    print(text, file=sys.stderr, flush=True)


def write(options: argparse.Namespace, reach: Reach, faults: Sequence[Fault]) -> None:
    """Write what is known so far as JSON, if a file was asked for."""
    if options.json is None:
        return
    found = {
        "tree": str(options.tree),
        "package": options.package,
        "seed": options.seed,
        "suite": {
            "tests": len(reach.seconds),
            "seconds": round(sum(reach.seconds.values()) + sum(reach.shared_seconds.values()), 1),
            "failed": reach.failed,
        },
        "planted": len(faults),
        "killed": sum(bool(one.killed_by) for one in faults),
        "faults": [asdict(one) for one in faults],
    }
    options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def earlier(options: argparse.Namespace) -> dict[tuple[str, int, str, str], Fault]:
    """Return the faults of an earlier start of the same command that was cut short."""
    if options.json is None or not options.json.is_file():
        return {}
    found = json.loads(options.json.read_text(encoding="utf-8"))
    if (found["tree"], found["seed"]) != (str(options.tree), options.seed):
        return {}
    faults = [Fault(**one) for one in found["faults"]]
    return {(one.file, one.line, one.before, one.after): one for one in faults}


def show(faults: Sequence[Fault]) -> None:
    """Print how many faults of each kind were noticed, and every one that was not."""
    planted = Counter(one.kind for one in faults)
    killed = Counter(one.kind for one in faults if one.killed_by)
    print(f"{'kind of fault':<24} planted  killed")
    for kind in sorted(planted):
        print(f"{kind:<24} {planted[kind]:>7} {killed[kind]:>7}")
    print(f"{'all':<24} {len(faults):>7} {killed.total():>7}")
    for one in faults:
        if not one.killed_by:
            print(f"\n{one.file}:{one.line}: {one.kind}, survived {one.tests} {one.shown_to}")
            print(f"  - {' '.join(one.before.split())}\n  + {one.after}")


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
    for name in _HEAVY:
        import_module(name)
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        reach, faults = measure(options, scratch=Path(folder).resolve())
    write(options, reach, faults)
    show(faults)
    return 0


if __name__ == "__main__":
    sys.exit(main())
