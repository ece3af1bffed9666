"""Options and limits that end in one line, before anything is computed."""

import errno
import resource

import pytest
from helpers.commands import FEW, MATRIX, assert_refused, run
from helpers.small_runs import write_walks

from evaluation.matrix import parser, settings_from
from evaluation.plan.axes import expand_axes
from evaluation.plan.settings import Settings
from evaluation.plan.workers import choose_jobs, most_workers
from isac_track.command_line import exit_code
from isac_track.errors import SettingsError

CONFIGS = {
    "scenes = [40, 50]": "scenes takes one value, not a list",
    "scenes = []": "scenes takes one value, not a list",
    "dataset = ['plaza']": "dataset takes one value, not a list",
    "scenes = true": "invalid int value",
    "dataset = [{ name = 1 }]": "takes one value",
    "attack = [['shape']]": "attack takes numbers or text",
    "fresh = 1": "fresh is true or false",
    "keep_scores = [true]": "keep_scores is true or false",
    "verbose = true": "unknown key 'verbose'",
    f"x = {'[' * 5000}": "",
    f"x = {'[' * 5000}{']' * 5000}": "",
    "# " + "x" * 2**20: "longer than 1 MB",
}


def config_settings(tmp_path, text, *words):
    path = tmp_path / "run.toml"
    path.write_text(text)
    return settings_from(parser().parse_args(["--config", str(path), *words]))


@pytest.mark.parametrize("text", CONFIGS)
def test_a_config_that_cannot_be_meant_is_one_line(text, tmp_path):
    with pytest.raises(SettingsError) as caught:
        config_settings(tmp_path, text)
    assert CONFIGS[text] in str(caught.value)
    assert "run.toml: " in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_a_config_without_end_is_read_up_to_a_limit():
    with pytest.raises(SettingsError, match="longer than 1 MB"):
        settings_from(parser().parse_args(["--config", "/dev/zero"]))


@pytest.mark.parametrize("axis", ["mechanism", "predictor", "attack", "task"])
def test_an_empty_list_in_a_config_is_none(axis, tmp_path):
    assert getattr(config_settings(tmp_path, f"{axis} = []"), f"{axis}s") == ()
    assert getattr(config_settings(tmp_path, "seed = 1"), f"{axis}s") is None


def test_the_command_line_is_over_an_empty_list(tmp_path):
    assert config_settings(tmp_path, "attack = []", "--attack", "shape").attacks == (
        "shape",
    )
    assert config_settings(tmp_path, "seed = 5", "--seed", "0").seed == 0


def test_flags_in_a_config(tmp_path):
    flags = ("persistent_ids", "fresh", "keep_scores")
    for value in (True, False):
        text = "\n".join(f"{name} = {str(value).lower()}" for name in flags)
        assert [getattr(config_settings(tmp_path, text), name) for name in flags] == [
            value
        ] * 3
    assert config_settings(tmp_path, "fresh = false", "--fresh").fresh


COMMANDS = {
    "an address without a port": (
        ("--executor", "dask", "--scheduler", "tcp://localhost"),
        "ends with its port",
    ),
    "a port that is none": (
        ("--executor", "dask", "--scheduler", "host:many"),
        "its port",
    ),
    "a port beyond all": (
        ("--executor", "dask", "--scheduler", "host:65536"),
        "its port",
    ),
    "the port of nothing": (
        ("--executor", "dask", "--scheduler", "tcp://host:0"),
        "its port",
    ),
    "a thousand workers": (("--jobs", "1000"), "at most 256"),
    "linear adding under another law": (
        ("--mechanism", "fixed:0,law=fixed_direction"),
        "write adding=independent",
    ),
}


@pytest.mark.parametrize("case", COMMANDS)
def test_an_option_is_refused_before_anything_is_computed(case):
    words, says = COMMANDS[case]
    with pytest.raises(SettingsError, match=says):
        expand_axes(settings_from(parser().parse_args(["--dataset", "plaza", *words])))


@pytest.mark.parametrize(
    "address", ["tcp://host:8786", "host:8786", "tls://[::1]:1/", "inproc://1"]
)
def test_addresses_of_schedulers(address):
    assert Settings(executor="dask", scheduler=address).scheduler == address


@pytest.mark.parametrize("threads", ["0", "-3", "x"])
def test_no_threads_for_numba_is_one_line(threads, tmp_path):
    ended = run(tmp_path, *MATRIX, "--dry-run", changed={"NUMBA_NUM_THREADS": threads})
    assert_refused(ended, "NUMBA_NUM_THREADS")


@pytest.mark.parametrize("limit", ["1e-100", "1e-300", "5e-324"])
def test_a_limit_that_no_noise_meets_is_one_line(limit, tmp_path):
    words = ("-m", "evaluation.design", "--plan", "--max-plr", limit)
    assert_refused(run(tmp_path, *words), "closed forms do not reach that far")


def test_there_are_no_more_workers_than_works():
    few = Settings(
        jobs=24,
        scenes=8,
        mechanisms=["raw", "clean"],
        predictors=[],
        attacks=[],
        tasks=[],
        policies=[],
    )
    crossed = expand_axes(few)
    assert most_workers(crossed, few) == 2
    assert choose_jobs(crossed, few) == 2


LIMITS = {
    "memory": (MemoryError(), "not enough memory"),
    "calls": (RecursionError("maximum recursion depth exceeded"), "calls go deeper"),
    "threads": (RuntimeError("can't start new thread"), "ulimit -u"),
    "processes": (
        BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable"),
        "ulimit -u",
    ),
    "files": (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
    "files of all": (
        OSError(errno.ENFILE, "Too many open files in system"),
        "whole system",
    ),
    "libraries": (
        ImportError("x.so: failed to map segment from shared object"),
        "not enough memory",
    ),
    "memory of the system": (
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        "not enough memory",
    ),
}


@pytest.mark.parametrize("case", LIMITS)
def test_a_limit_of_the_machine_is_one_line(case, capsys):
    error, says = LIMITS[case]

    def command():
        raise error

    assert exit_code(command) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ")
    assert says in err
    assert err.count("\n") == 1


def test_a_library_without_place_that_another_error_hides_is_one_line(capsys):
    hidden = OSError("Could not find/load shared object file")  # as llvmlite says it
    hidden.__context__ = OSError(
        "libllvmlite.so: failed to map segment from shared object"
    )

    def command():
        raise hidden

    assert exit_code(command) == 2
    assert (
        capsys.readouterr().err
        == "error: there is not enough memory to load what a run takes\n"
    )


def test_another_error_of_the_program_stays_one():
    def command():
        raise RuntimeError("something else")

    with pytest.raises(RuntimeError, match="something else"):
        exit_code(command)


PROCESSES = {"few descriptors": (resource.RLIMIT_NOFILE, 12)}


@pytest.mark.parametrize("case", PROCESSES)
def test_a_process_with_limits_ends_in_one_line_or_computes(case, tmp_path):
    write_walks(tmp_path / "walks.csv", n_people=24)
    kind, most = PROCESSES[case]
    words = (*FEW, "--scenes", 8, "--dataset", "walks.csv", "--jobs", 2)
    ended = run(
        tmp_path,
        *MATRIX,
        *words,
        preexec_fn=lambda: resource.setrlimit(kind, (most, most)),
        timeout_s=120,
    )
    assert ended.code in (0, 2), ended


@pytest.mark.parametrize(("most", "threads"), [(4, "1"), (1000, None)])
def test_blas_starts_no_threads_where_few_processes_may_run(most, threads, tmp_path):
    code = "import os, isac_track, numpy; print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    ended = run(
        tmp_path,
        "-c",
        code,
        changed={"OPENBLAS_NUM_THREADS": None},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NPROC, (most, most)),
    )
    assert ended.out == f"{threads}\n"


def test_a_folder_of_ones_own_with_our_name_is_one_line(tmp_path):
    (tmp_path / "attacks").mkdir()
    (tmp_path / "attacks" / "__init__.py").write_text("")
    ended = run(tmp_path, *MATRIX, "--help")
    assert_refused(ended, "isac-track matrix", "attacks")
    ended = run(
        tmp_path,
        "-c",
        "try:\n    import evaluation\nexcept ImportError as e:\n    print(e)",
    )
    assert "isac-track matrix" in ended.out


def test_a_command_of_a_program_without_words_misses_its_own(tmp_path):
    code = "import sys\nfrom evaluation import compare, publish, report\n"
    code += "for sys.argv in (None, []):\n"
    code += "    print(*(command.main() for command in (compare, publish, report)))"
    ended = run(tmp_path, "-c", code)
    assert ended.out == "2 2 2\n2 2 2\n"
    assert ended.err.count("the following arguments are required") == 6


def test_a_program_without_words(tmp_path):
    """Whether it has no list of words, or an empty one."""
    write_walks(tmp_path / "walks.csv", n_people=24)
    code = "import sys; sys.argv = None\n"
    code += "import evaluation\n"
    code += "axes = dict(tasks=[], attacks=[], predictors=[], mechanisms=['raw'])\n"
    code += "for sys.argv in (None, []):\n"
    code += (
        "    run = evaluation.run(preset='smoke', dataset='walks.csv', scenes=8,"
        " jobs=1,\n"
    )
    code += "        out=f'run{sys.argv}', pictures=False, progress=False, **axes)\n"
    code += "    print(len(run.summary) > 0)"
    assert run(tmp_path, "-c", code).out == "True\nTrue\n"


def test_a_low_recursion_limit_is_one_line(tmp_path):
    code = "import sys; from evaluation import matrix\n"
    code += "sys.setrecursionlimit(45)\nsys.exit(matrix.main(['--dry-run']))"
    assert_refused(run(tmp_path, "-c", code), "calls go deeper")
