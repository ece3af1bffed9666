"""`python -m evaluation.matrix`: a thin shell over `evaluation.run`."""

from __future__ import annotations

import argparse
import gc
import sys
import tomllib
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from evaluation.experiment.presets import PRESETS
from evaluation.experiment.settings import Settings
from evaluation.reporting.announcements import broken, listing, notices, plan_lines
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_EXIT = """\
exit codes: 0 done, 2 wrong usage or data, 3 some cells failed (the others are done),
130 interrupted (finished cells are kept; the same command continues)

examples:
  python -m evaluation.matrix
  python -m evaluation.matrix --preset smoke
  python -m evaluation.matrix --dataset walks.csv --mechanism fid:1..1000/10 --mechanism raw
  python -m evaluation.matrix --set privacy.epsilon_m=0.5 --out runs/wide
"""
_CONFIG_KEYS = {
    "preset": str,
    "dataset": str,
    "format": str,
    "fps": float,
    "scenes": int,
    "seed": int,
    "mechanism": list,
    "predictor": list,
    "attack": list,
    "task": list,
    "jobs": int,
    "cell_timeout": float,
    "executor": str,
    "scheduler": str,
    "out": str,
}


def parser() -> argparse.ArgumentParser:
    """Return the command line of the matrix."""
    presets = "; ".join(f"{name}: {preset.summary}" for name, preset in PRESETS.items())
    command = Parser(
        prog="python -m evaluation.matrix",
        description="Evaluate sharing mechanisms: what a robot can still foresee, what leaks.",
        epilog=_EXIT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    add = command.add_argument
    add("--preset", metavar="NAME", help=f"{presets} (default: paper)")
    add(
        "--dataset",
        metavar="NAME|PATH",
        help="a known data set (downloaded if need be) or your own file "
        "(default: students03 if it is here, else the simulated plaza)",
    )
    add("--format", metavar="NAME", help="format of your own file; see docs/data.md")
    add("--fps", type=float, metavar="N", help="frames per second of your own file")
    add("--scenes", type=int, metavar="N", help="Monte Carlo scenes (default: the preset's)")
    add("--seed", type=int, metavar="N", help="base seed of every random stream (default: 0)")
    add(
        "--mechanism",
        action="append",
        metavar="SPEC",
        help="sharing mechanism: name[:VALUE][,key=value...], a sweep as LOW..HIGH/COUNT; "
        "repeatable; replaces the preset's",
    )
    add(
        "--predictor",
        action="append",
        metavar="SPEC",
        help="the robot's predictor; repeatable; `none` for none",
    )
    add(
        "--attack",
        action="append",
        metavar="SPEC",
        help="attack: a reconstruction, a linker, or LINKER@RECONSTRUCTION; repeatable; `none` "
        "for none; replaces the preset's",
    )
    add(
        "--task",
        action="append",
        metavar="NAME",
        help="what is to be linked; repeatable; `none` for none; replaces the preset's",
    )
    add(
        "--set",
        action="append",
        metavar="STAGE.KEY=VALUE",
        default=[],
        help="change a stage setting, such as privacy.epsilon_m=0.5; --list names all",
    )
    add("--config", type=Path, metavar="FILE.toml", help="the same keys from a file")
    add(
        "--jobs",
        type=int,
        metavar="N",
        help="worker processes (default: the cores, at most 8; 1 for little work)",
    )
    add(
        "--cell-timeout",
        type=float,
        metavar="S",
        help="kill and leave out a cell that takes longer than this many seconds (default: never)",
    )
    add(
        "--executor",
        metavar="local|dask",
        help="where cells are computed: worker processes of this machine (default), or a Dask "
        "cluster; see docs/cluster.md",
    )
    add("--scheduler", metavar="ADDRESS", help="of the Dask cluster, as tcp://host:8786")
    add(
        "--keep-scores",
        action="store_true",
        help="keep the raw scores of everybody who links as well: some hundred MB",
    )
    add("--out", type=Path, metavar="DIR", help="run folder (default: runs/DATASET-PRESET-SEED)")
    add("--fresh", action="store_true", help="replace the run in the folder, do not continue it")
    add("--list", action="store_true", help="list what can be named, and stop")
    add("--dry-run", action="store_true", help="say what would be computed, and stop")
    return command


def settings_from(options: argparse.Namespace) -> Settings:
    """Return the settings of a command line, over those of its --config file.

    Raises
    ------
    SettingsError
        For anything unknown, malformed or contradictory.
    """
    values, stage_values = _read_config(options.config) if options.config else ({}, {})
    for key in _CONFIG_KEYS:
        given = getattr(options, key)
        if given is not None:
            values[key] = given
    for text in options.set:
        name, equals, value = text.partition("=")
        if not equals:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
        stage_values[name.strip()] = value.strip()
    if values.get("fps") is not None and values.get("dataset") is None:
        raise SettingsError("--fps describes your own file: name it with --dataset PATH")
    if values.get("format") is not None and values.get("dataset") is None:
        raise SettingsError("--format describes your own file: name it with --dataset PATH")
    return Settings(
        preset=values.get("preset", "paper"),
        dataset=values.get("dataset"),
        format=values.get("format"),
        fps=values.get("fps"),
        scenes=values.get("scenes"),
        seed=values.get("seed", 0),
        mechanisms=_axis(values.get("mechanism"), option="--mechanism"),
        predictors=_axis(values.get("predictor"), option="--predictor"),
        attacks=_axis(values.get("attack"), option="--attack"),
        tasks=_axis(values.get("task"), option="--task"),
        stages=StageSettings().changed(stage_values),
        jobs=values.get("jobs"),
        cell_timeout_s=values.get("cell_timeout"),
        executor=values.get("executor", "local"),
        scheduler=values.get("scheduler"),
        out=Path(values["out"]) if "out" in values else None,
        keep_scores=options.keep_scores,
        fresh=options.fresh,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    return exit_code(
        lambda: _command(arguments),
        interrupted="interrupted; finished cells are kept, the same command continues "
        "(without --fresh)",
    )


def _command(arguments: Sequence[str] | None) -> int:
    options = parser().parse_args(arguments)
    if options.list:
        _say(listing())
        _say(broken(), stream=sys.stderr)
        return DONE
    return _run(settings_from(options), dry_run=options.dry_run)


def _run(settings: Settings, *, dry_run: bool) -> int:
    # Heavy imports only now: --help, --list and a typing error answer at once.
    from evaluation.experiment.plan import plan  # noqa: PLC0415
    from evaluation.reporting.tables import show  # noqa: PLC0415
    from evaluation.results import run  # noqa: PLC0415
    from evaluation.runs.execute import FailedCellsWarning  # noqa: PLC0415

    gc.freeze()  # what was imported stays: looking through it again and again takes a second
    ready = plan(settings)
    _say(plan_lines(ready), stream=sys.stderr)
    if dry_run:
        return DONE
    with _Bar() as bar, warnings.catch_warnings():
        warnings.simplefilter("ignore", FailedCellsWarning)  # told below
        results = run(ready=ready, progress=bar.update)
    _say((f"notice: {one}" for one in notices(results.manifest)), stream=sys.stderr)
    show(results)
    _say([f"\nresults in {results.out}; read {results.out / 'report.html'} first"])
    return FAILED_CELLS if len(results.failed) else DONE


class _Bar:
    """A live progress bar on a terminal; silent where nobody watches."""

    def __init__(self) -> None:
        from rich.console import Console  # noqa: PLC0415
        from rich.progress import (  # noqa: PLC0415
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        console = Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("cells"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._task = self._progress.add_task("starting", total=None)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def update(self, done: int, total: int, what: str) -> None:
        self._progress.update(self._task, completed=done, total=total, description=f"{what:<40.40}")


def _read_config(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"--config {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"--config {path}: {error}") from None
    values: dict[str, Any] = {}
    stage_values: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            stage_values |= {f"{key}.{name}": inner for name, inner in value.items()}
        elif key not in _CONFIG_KEYS:
            raise SettingsError(
                f"--config {path}: unknown key {key!r}; known: {', '.join(_CONFIG_KEYS)} "
                "and tables of stage settings"
            )
        else:
            values[key] = _typed(value, key=key, path=path)
    return values, stage_values


def _typed(value: Any, *, key: str, path: Path) -> Any:  # noqa: ANN401 - as TOML has it
    kind = _CONFIG_KEYS[key]
    if kind is list and isinstance(value, str):
        return [value]
    if kind is list and isinstance(value, list) and all(isinstance(one, str) for one in value):
        return value
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if kind in (int, str) and type(value) is kind:
        return value
    noun = {list: "a list of SPECs", float: "a number", int: "a whole number", str: "text"}[kind]
    raise SettingsError(f"--config {path}: {key} must be {noun}, got {value!r}")


def _axis(specs: list[str] | None, *, option: str) -> tuple[str, ...] | None:
    if specs is None:
        return None
    if "none" in specs:
        if len(specs) > 1:
            raise SettingsError(f"{option} none empties the axis and cannot be mixed with others")
        return ()
    return tuple(specs)


def _say(lines: Iterable[str], *, stream: Any = None) -> None:  # noqa: ANN401 - a text stream
    for line in lines:
        print(line, file=stream or sys.stdout)


if __name__ == "__main__":
    sys.exit(main())
