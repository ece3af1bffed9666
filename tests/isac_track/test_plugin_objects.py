"""Plug-ins that are objects: how they are called, what their cells depend on, and that they run."""

import re
from dataclasses import dataclass, field, replace
from typing import ClassVar

import cloudpickle
import numpy as np
import pytest
from helpers.small_runs import one_process, smoke, write_walks

import evaluation
from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.plugins import parse_all, plugins_of
from isac_track.sharing import perturb
from predictors.least_squares import LeastSquares


@dataclass(frozen=True)
class Coarse:
    cell_m: float = 0.5
    adds_error: ClassVar[bool] = False

    def share(self, sensed, rng):
        release = perturb(sensed, 0.0, rng)
        return replace(release, xy=self.cell_m * np.round(release.xy / self.cell_m))


@dataclass(frozen=True)
class Restless(Coarse):
    """Not the same twice as it travels."""

    seen: list = field(default_factory=list, repr=False, compare=False)

    def __reduce__(self):
        self.seen.append(0)
        return Restless, (self.cell_m, list(self.seen))


def test_an_object_is_called_as_its_spec_would_be():
    (found,) = plugins_of("mechanisms", Coarse(0.25))
    assert (found.name, found.level) == (f"{__name__}:Coarse", 0.25)
    assert found.spec == f"{__name__}:Coarse:0.25"
    assert found.instance == Coarse(0.25)
    # One of ours that a SPEC gives as well is that one: its cells are the same.
    spec = "least_squares"
    assert plugins_of("predictors", LeastSquares()) == plugins.parse("predictors", spec)
    assert plugins_of("predictors", spec) == plugins.parse("predictors", spec)


def test_its_digest_is_that_of_its_pickle_and_no_others_where_that_is_unstable():
    digests = [
        plugins_of("mechanisms", one)[0].digest
        for one in (Coarse(1), Coarse(1), Coarse(2))
    ]
    assert digests[0] == digests[1] != digests[2]
    restless = [plugins_of("mechanisms", Restless(1))[0].digest for _ in range(2)]
    assert restless[0] != restless[1]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([Coarse], "write Coarse()"),
        ([3], "mechanisms are SPECs or objects of frozen dataclasses, got 3"),
        ([Restless(1), Restless(1)], "are both called"),
    ],
)
def test_what_is_no_plugin_or_called_as_another_is_refused(given, told):
    with pytest.raises(SettingsError, match=re.escape(told)):
        parse_all("mechanisms", given)


def test_an_object_runs_in_workers_and_is_computed_again_if_it_changed(tmp_path):
    walks, out = write_walks(tmp_path / "walks.csv"), tmp_path / "run"
    # As in a notebook: no module has the class, which travels whole.
    namespace = {"__name__": "__main__", "Coarse": Coarse, "dataclass": dataclass}
    exec(
        "@dataclass(frozen=True)\n"
        "class Mine(Coarse):\n"
        "    def share(self, sensed, rng):\n"
        "        return super().share(sensed, rng)\n",
        namespace,
    )
    cloudpickle.register_pickle_by_value(__import__(__name__, fromlist=["Coarse"]))

    def ran(cell_m):
        mine = namespace["Mine"](cell_m)
        settings = smoke(walks, out, mechanisms=("raw", mine))
        run = evaluation.run(settings, progress=False, pictures=False)
        cells = {
            path.name: path.stat().st_mtime_ns for path in (out / "cells").iterdir()
        }
        return run.frame("plr").set_index("family")["value"], cells

    plr, cells = ran(2.0)
    assert plr["__main__:Mine"] < plr["raw"]
    with one_process():  # Another worker would compute the same, after seconds.
        again = ran(1.0)[1]
    assert again.items() > cells.items()


FAILS = """@dataclass(frozen=True)
class Mine:
    def share(self, sensed, rng):
        1 / 0
"""


@pytest.mark.parametrize(
    ("is_there", "told", "traced"),
    [
        (False, "where it is defined", "<Mine, defined in the session>"),
        (True, "mine.py", "mine.py"),
    ],
)
def test_where_an_object_fails_is_told_by_its_file_or_its_class(
    tmp_path, is_there, told, traced
):
    file = tmp_path / "mine.py"
    file.write_text(FAILS)
    namespace = {"__name__": "__main__", "dataclass": dataclass}
    exec(compile(FAILS, str(file) if is_there else "<stdin>", "exec"), namespace)
    walks, mine = write_walks(tmp_path / "walks.csv"), namespace["Mine"]()
    where = rf"failed: ZeroDivisionError: division by zero \({told}, line 4\); found by"
    with pytest.raises(PluginError, match=where):
        evaluation.run(
            smoke(walks, tmp_path / "run", mechanisms=(mine,)), progress=False
        )
    trace = (tmp_path / "run" / "plugin-error.txt").read_text()
    assert f'{traced}", line 4, in share' in trace
    assert "dynamic-code" not in trace
