"""Plug-ins that are objects: their names, their digests, and that they run."""

import re
from dataclasses import dataclass, field, replace
from typing import ClassVar

import cloudpickle
import numpy as np
import pytest
from helpers.small_runs import single_process, smoke, write_walks

import evaluation
from isac_track import plugins
from isac_track.errors import PluginError, SettingsError
from isac_track.plugins import parse_all, resolve_plugins
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
    """Pickles to different bytes each time."""

    seen: list = field(default_factory=list, repr=False, compare=False)

    def __reduce__(self):
        self.seen.append(0)
        return Restless, (self.cell_m, list(self.seen))


def test_an_object_has_the_name_of_its_spec():
    (plugin,) = resolve_plugins("mechanisms", Coarse(0.25))
    assert (plugin.name, plugin.level) == (f"{__name__}:Coarse", 0.25)
    assert plugin.spec == f"{__name__}:Coarse:0.25"
    assert plugin.instance == Coarse(0.25)
    # A built-in plug-in has the same cells as an object and as a SPEC.
    spec = "least_squares"
    assert resolve_plugins("predictors", LeastSquares()) == plugins.parse(
        "predictors", spec
    )
    assert resolve_plugins("predictors", spec) == plugins.parse("predictors", spec)


def test_its_digest_is_that_of_its_pickle_or_random_where_that_is_unstable():
    digests = [
        resolve_plugins("mechanisms", mechanism)[0].digest
        for mechanism in (Coarse(1), Coarse(1), Coarse(2))
    ]
    assert digests[0] == digests[1] != digests[2]
    restless = [resolve_plugins("mechanisms", Restless(1))[0].digest for _ in range(2)]
    assert restless[0] != restless[1]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([Coarse], "write Coarse()"),
        ([3], "mechanisms are SPECs or objects of frozen dataclasses, got 3"),
        ([Restless(1), Restless(1)], "are both called"),
    ],
)
def test_other_objects_and_repeated_names_are_refused(given, message):
    with pytest.raises(SettingsError, match=re.escape(message)):
        parse_all("mechanisms", given)


def test_an_object_runs_in_workers_and_is_computed_again_if_it_changed(tmp_path):
    walks, out = write_walks(tmp_path / "walks.csv"), tmp_path / "run"
    # As in a notebook: no module has the class, so that its code is sent.
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
        changed = namespace["Mine"](cell_m)
        settings = smoke(walks, out, mechanisms=("raw", changed))
        run = evaluation.run(settings, progress=False, pictures=False)
        cells = {
            path.name: path.stat().st_mtime_ns for path in (out / "cells").iterdir()
        }
        return run.frame("plr").set_index("family")["value"], cells

    plr, cells = ran(2.0)
    assert plr["__main__:Mine"] < plr["raw"]
    with single_process():  # Another worker would compute the same, after seconds.
        again = ran(1.0)[1]
    assert again.items() > cells.items()


FAILS = """@dataclass(frozen=True)
class Mine:
    def share(self, sensed, rng):
        1 / 0
"""


@pytest.mark.parametrize(
    ("has_file", "place", "traced"),
    [
        (False, "where it is defined", "<Mine, defined in the session>"),
        (True, "mine.py", "mine.py"),
    ],
)
def test_a_failing_object_is_located_by_its_file_or_its_class(
    tmp_path, has_file, place, traced
):
    file = tmp_path / "mine.py"
    file.write_text(FAILS)
    namespace = {"__name__": "__main__", "dataclass": dataclass}
    exec(compile(FAILS, str(file) if has_file else "<stdin>", "exec"), namespace)
    walks, mechanism = write_walks(tmp_path / "walks.csv"), namespace["Mine"]()
    where = (
        rf"failed: ZeroDivisionError: division by zero \({place}, line 4\); found by"
    )
    with pytest.raises(PluginError, match=where):
        evaluation.run(
            smoke(walks, tmp_path / "run", mechanisms=(mechanism,)), progress=False
        )
    trace = (tmp_path / "run" / "plugin-error.txt").read_text()
    assert f'{traced}", line 4, in share' in trace
    assert "dynamic-code" not in trace
