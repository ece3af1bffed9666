"""Run the matrix: `python -m evaluation.matrix`, a thin shell over `evaluation.run`."""

import argparse
import gc
import sys
import tomllib
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias

from evaluation.plan.presets import DEFAULT, PRESETS
from evaluation.plan.settings import (
    OPTIONS,
    USUAL_STAGES,
    Settings,
    parse_stage_values,
)
from evaluation.reporting import announcements, listing
from evaluation.reporting.notices import notices
from isac_track.command_line import DONE, FAILED_CELLS, Parser, exit_code
from isac_track.errors import SettingsError, quoted
from isac_track.protocols import ADVERSARIES, USUAL

if TYPE_CHECKING:
    from evaluation.plan.plan import Plan
    from evaluation.reporting.rows import Results

_Progress: TypeAlias = Callable[[int, int | None, str], None]
"""Called with the finished cells of a run, all of its cells, and the current step."""
_EPILOG = """\
exit codes: 0 done, 2 wrong usage or data, 3 some cells failed (the others are done),
130 interrupted (finished cells stay; the same command continues)

examples:
  python -m evaluation.matrix
  python -m evaluation.matrix --preset smoke
  python -m evaluation.matrix --dataset walks.csv --mechanism fid:1..1000/10 --mechanism raw
  python -m evaluation.matrix --preset smoke --attack +my_attack
  python -m evaluation.matrix --set privacy.epsilon_m=0.5 --out runs/wide
"""
_PRESETS = "; ".join(f"{name}: {preset.summary}" for name, preset in PRESETS.items())
_DATA = (
    "a known data set (downloaded if need be), your own file, or a folder of sessions"
    " (default: students03 if it is here, else the simulated plaza)"
)
_REPLACES = "repeatable; replaces the preset's, with a + before each adds to them: +{}"
_ATTACK = (
    "a reconstruction, a linker, or LINKER@RECONSTRUCTION; `none` for none;"
    f" {_REPLACES.format('my_attack')}"
)
_PREDICTOR = f"the robot's predictor; `none` for none; {_REPLACES.format('my_tracker')}"
_TASK = f"what is to be linked; `none` for none; {_REPLACES.format('handover-2s')}"
_ADVERSARY = (
    f"beside {', '.join(USUAL)}:"
    f" {', '.join(name for name in ADVERSARIES if name not in USUAL)}; repeatable; see"
    " docs/explanation/threat-model.md"
)
_MECHANISM = (
    "sharing mechanism: name[:VALUE][,key=value...], a sweep as LOW..HIGH/COUNT"
)
_POLICY = (
    "what an answer to a robot on patrol discloses: name[:VALUE][,key=value...];"
    f" `none` for no patrols; {_REPLACES.format('near:3.5')}"
)
_TIMEOUT = (
    "kill and leave out a cell that takes longer than this many seconds (default:"
    " never)"
)
_EXECUTOR = (
    "compute on this machine (local, default) or on a Dask cluster; see"
    " docs/how-to/cluster.md"
)
_PRECISION = (
    "half-width of the intervals of missed conflicts (0.01: ±1 point); 250 scenes"
    " computed first tell how many scenes that takes; not with --scenes"
)


class _Option(NamedTuple):
    """An option with a value, which a file may set, too."""

    kind: type  # A list: the option is repeatable, and its values are texts.
    metavar: str
    about: str  # Text of --help.


# By key of --config.
_OPTIONS: Final = {
    "preset": _Option(str, "NAME", f"{_PRESETS} (default: {DEFAULT})"),
    "dataset": _Option(str, "NAME|PATH", _DATA),
    "format": _Option(str, "NAME", "format of your own file; see docs/how-to/data.md"),
    "fps": _Option(float, "N", "frames per second of your own file"),
    "unit": _Option(
        str,
        "m|cm|mm",
        "unit of lengths in your own file (default: its header's, else m)",
    ),
    "columns": _Option(
        str,
        "t=NAME,...",
        "your columns for t, id, x, y, group: t=time[ms],x=pos_x[cm]",
    ),
    "on_duplicate": _Option(
        str,
        "error|first|mean",
        "what to do with an id at two places at one time (default: error)",
    ),
    "crs": _Option(
        str,
        "degrees",
        "x is longitude and y latitude: project them to local metres",
    ),
    "drop_frozen": _Option(
        float,
        "S",
        "drop stretches of S seconds or more at exactly one place",
    ),
    "session": _Option(
        list,
        "FILE",
        "a file of several sessions of one recording; repeatable",
    ),
    "confirming": _Option(
        str,
        "SESSION",
        "a session left aside, to confirm whether people who come back are linked",
    ),
    "scenes": _Option(int, "N", "Monte Carlo scenes (default: the preset's)"),
    "precision": _Option(float, "H", _PRECISION),
    "seed": _Option(int, "N", "base seed of every random stream (default: 0)"),
    "mechanism": _Option(list, "SPEC", f"{_MECHANISM}; {_REPLACES.format('my_noise')}"),
    "predictor": _Option(list, "SPEC", _PREDICTOR),
    "attack": _Option(list, "SPEC", _ATTACK),
    "task": _Option(list, "NAME", _TASK),
    "policy": _Option(list, "SPEC", _POLICY),
    "adversary": _Option(list, "NAME", _ADVERSARY),
    "jobs": _Option(
        int,
        "N",
        "worker processes (default: the cores, at most 8; 1 for little work)",
    ),
    "cell_timeout": _Option(float, "S", _TIMEOUT),
    "executor": _Option(str, "local|dask", _EXECUTOR),
    "scheduler": _Option(
        str, "ADDRESS", "address of the Dask cluster, as tcp://host:8786"
    ),
    "out": _Option(str, "DIR", "run folder (default: runs/DATASET-PRESET-SEED)"),
}
# Flags that a file may set, too.
_RUN_FLAGS: Final = ("persistent_ids", "keep_scores", "keep_ids", "fresh")
_MOST_CONFIG: Final = 2**20  # Bytes of a config file; a longer file is none.


def parser() -> argparse.ArgumentParser:
    """Return the command line of the matrix."""
    command = Parser(
        prog="python -m evaluation.matrix",
        description=(
            "Evaluate sharing mechanisms: what a robot can still foresee, what leaks."
        ),
        epilog=_EPILOG,
    )
    add = command.add_argument
    for key, option in _OPTIONS.items():
        parsing: dict[str, Any] = {"type": option.kind}
        if option.kind is list:
            parsing = {"action": "append"}
        name = f"--{key.replace('_', '-')}"
        add(name, metavar=option.metavar, help=option.about, **parsing)
    about = "change a stage setting, such as privacy.epsilon_m=0.5; --list names all"
    add("--set", action="append", metavar="STAGE.KEY=VALUE", default=[], help=about)
    add("--config", type=Path, metavar="FILE.toml", help="the same keys from a file")
    for flag, about in {
        "--persistent-ids": "ids are the same people in all sessions",
        "--keep-scores": (
            "also keep the raw scores of all linkage attacks: some hundred MB"
        ),
        "--keep-ids": (
            "keep the ids of the recording in the files of the run, not pseudonyms"
        ),
        "--no-pictures": "store no true walks, and draw neither figures nor the page",
        "--fresh": "replace the run in the folder instead of continuing it",
        "--verbose": "print all tables and notices, not the first screen alone",
        "--list": "list what can be named, and stop",
        "--dry-run": (
            "say what would be computed and how long it takes, or what is wrong; stop"
        ),
    }.items():
        add(flag, action="store_true", help=about)
    return command


def settings_from(options: argparse.Namespace) -> Settings:
    """Return the settings of a command line, over those of its --config file.

    Raises SettingsError for anything unknown, malformed or contradictory.
    """
    stage_values: dict[str, Any] = {}
    values: dict[str, Any] = {}
    if options.config:
        values = _given_values(_read_config(options.config, stage_values))
    values |= _given_values(options)
    stage_values |= parse_stage_values(options.set)
    for key in ("fps", "format", "unit", "columns", "crs"):
        if key in values and not values.keys() & {"dataset", "session"}:
            raise SettingsError(
                f"--{key} describes your own file: name it with --dataset PATH"
            )
    for axis, key in OPTIONS.items():
        specs = values.pop(key, None)
        if specs and "none" in specs and len(specs) > 1:
            raise SettingsError(
                f"--{key} none empties the axis and cannot be mixed with others"
            )
        if specs is not None:
            specs = [spec for spec in specs if spec != "none"]
        values[axis] = specs
    return Settings(
        adversaries=values.pop("adversary", ()),
        cell_timeout_s=values.pop("cell_timeout", None),
        stages=USUAL_STAGES.changed(stage_values),
        sessions=values.pop("session", ()),
        **values,
    )


def _given_values(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of a run that were given, by their keys."""
    values = {key: getattr(options, key) for key in (*_OPTIONS, *_RUN_FLAGS)}
    return {
        key: value
        for key, value in values.items()
        if value is not None and value is not False
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    interrupted = (
        "interrupted; finished cells stay, the same command continues (without --fresh)"
    )
    return exit_code(lambda: _command(arguments), interrupted=interrupted)


def _command(arguments: Sequence[str] | None) -> int:
    options = parser().parse_args(arguments)
    if options.list:
        print(*listing.listing(), sep="\n")
        sys.stderr.writelines(f"{line}\n" for line in listing.broken_plugins())
        return DONE
    settings = settings_from(options)
    # Heavy imports only now: --help, --list and a typing error answer at once.
    from evaluation.pool.workers import start_workers_early  # noqa: PLC0415 - as said
    from evaluation.reporting.progress import progress_bar  # noqa: PLC0415 - as said

    # Lines above the results on the screen; the progress bar adds those that it leaves.
    heading: list[str] = []
    shows_all = options.verbose or options.dry_run
    with (
        progress_bar(heading) as update,
        start_workers_early(0 if options.dry_run else _n_workers(settings)),
    ):
        plan = _plan(settings, update, is_dry=options.dry_run)
        rehearsal = _rehearse(plan) if options.dry_run else []
        first, *others = announcements.plan_lines(plan)
        heading += announcements.wrap_lines(first)
        heading += announcements.condense_notices(
            others, most=None if shows_all else 3, where="--dry-run"
        )
        print(*heading, *rehearsal, sep="\n", file=sys.stderr)
        if options.dry_run:
            return DONE
        results = _run_planned(plan, update, pictures=not options.no_pictures)
    from evaluation.reporting.tables import show  # noqa: PLC0415 - as said

    lines = _notice_lines(results.manifest, shows_all=shows_all)
    sys.stderr.writelines(f"{line}\n" for line in lines)
    # One line more: loops may have been compiled.
    show(results, before=len(heading) + len(lines) + 1, verbose=options.verbose)
    return FAILED_CELLS if len(results.failed) else DONE


def _plan(settings: Settings, update: _Progress, *, is_dry: bool) -> "Plan":
    """Return the plan of a run; with a precision, compute first how many scenes."""
    update(0, None, "reading the recording")
    from evaluation.plan.plan import make_plan  # noqa: PLC0415 - heavy

    if settings.precision is not None:
        from evaluation.api import sized  # noqa: PLC0415 - heavy

        if is_dry:
            raise SettingsError(
                "--precision computes 250 scenes first: leave out --dry-run"
            )
        settings = sized(settings, progress=update)
    return make_plan(settings)


def _run_planned(plan: "Plan", update: _Progress, *, pictures: bool) -> "Results":
    """Return the results of a run, whose plan the user has seen by now."""
    # Heavier imports still, now that the user has seen the plan.
    from evaluation.api import run  # noqa: PLC0415 - as said
    from evaluation.pool.execute import FailedCellsWarning  # noqa: PLC0415 - as said

    # Imported objects stay: without this the garbage collector takes a second. A
    # caller in the same process may have frozen its own.
    is_first = gc.get_freeze_count() == 0
    if is_first:
        gc.freeze()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FailedCellsWarning)  # a notice has it
            return run(plan=plan, progress=update, pictures=pictures, walks=pictures)
    finally:
        if is_first:
            gc.unfreeze()


def _notice_lines(manifest: Mapping[str, Any], *, shows_all: bool) -> list[str]:
    """Return the notices of a finished run, at most two unless all are shown."""
    return announcements.condense_notices(
        [f"notice: {notice}" for notice in notices(manifest)],
        most=None if shows_all else 2,
        where="tables.txt",
    )


def _rehearse(plan: "Plan") -> list[str]:
    """Return the expected duration of a run, and notices; raise errors of its start."""
    from evaluation.pool.duration import expected_s, in_words  # noqa: PLC0415 - as said
    from evaluation.pool.rehearsal import rehearse  # noqa: PLC0415 - as said

    trial = rehearse(plan)
    time = in_words(expected_s(plan, trial.times), jobs=plan.jobs)
    timed = [spec for _, spec in trial.times]
    lines = [
        *(
            f"notice: {spec} took more than a minute for a few made-up people"
            for spec in trial.given_up
        ),
        f"{time}, with loops compiled and idle cores",
        *(f"with {spec}, as timed on a few made-up people" for spec in timed),
        *(f"without {spec}, which was not timed" for spec in trial.untimed),
    ]
    return [line for text in lines for line in announcements.wrap_lines(text)]


def _n_workers(settings: Settings) -> int:
    """Return the number of workers of a run, which start while it is planned."""
    from evaluation.plan.axes import expand_axes  # noqa: PLC0415 - as said
    from evaluation.plan.user_plugins import has_user_plugins  # noqa: PLC0415 - as said
    from evaluation.plan.workers import choose_jobs, most_workers  # noqa: PLC0415 - as said

    run_axes = expand_axes(settings)
    jobs = min(choose_jobs(run_axes, settings), most_workers(run_axes, settings))
    has_users = has_user_plugins(run_axes)
    is_needed = jobs > 1 or has_users or settings.cell_timeout_s is not None
    if not is_needed or settings.scheduler is not None:
        return 0
    # A further worker tries users' plug-ins, and computes nothing else.
    return jobs + 1 if has_users else jobs


def _read_config(path: Path, stage_values: dict[str, Any]) -> argparse.Namespace:
    """Return the options of a file as if they were typed; add its stage settings."""
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_CONFIG + 1)
        if len(content) > _MOST_CONFIG:
            raise SettingsError("the file is longer than 1 MB, so it is no config file")  # noqa: TRY301 - caught below
        words = []
        for key, value in tomllib.loads(content.decode("utf-8-sig")).items():
            if isinstance(value, dict):
                stage_values |= {
                    f"{key}.{name}": inner for name, inner in value.items()
                }
            else:
                words += _option_words(key, value)
        return parser().parse_args(words)
    except OSError as error:
        raise SettingsError(f"--config {path}: {error.strerror}") from None
    except RecursionError:
        raise SettingsError(f"--config {path}: it is nested too deeply") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, SettingsError) as error:
        raise SettingsError(f"--config {path}: {error}") from None


def _option_words(key: str, value: Any) -> list[str]:  # noqa: ANN401 - of TOML
    """Return a key of a config file as it would be typed; SettingsError for others."""
    option = f"--{key.replace('_', '-')}"
    if key in _RUN_FLAGS:
        if not isinstance(value, bool):
            raise SettingsError(f"{key} is true or false, got {quoted(value)}")
        return [option] if value else []
    if key not in _OPTIONS:
        known = ", ".join((*_OPTIONS, *_RUN_FLAGS))
        raise SettingsError(
            f"unknown key {key!r}; known: {known} and tables of stage settings"
        )
    several = value if isinstance(value, list) else [value]
    if isinstance(value, list) and _OPTIONS[key].kind is not list:
        raise SettingsError(f"{key} takes one value, not a list: got {quoted(value)}")
    if any(isinstance(single, list | dict) for single in several):
        raise SettingsError(f"{key} takes numbers or text, got {quoted(value)}")
    if not several and key in OPTIONS.values():
        several = ["none"]
    return [f"{option}={single}" for single in several]


if __name__ == "__main__":
    sys.exit(main())
