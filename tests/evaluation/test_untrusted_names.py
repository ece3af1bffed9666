"""Names in files are words: never a tag, a command, a path, or a module to import."""

import contextlib
import io
import json
import os
import re
import shutil
import sys
import xml.etree.ElementTree as ET
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from helpers.pages import Tags
from helpers.processes import ROOT
from helpers.small_runs import smoke

import evaluation
from evaluation import compare, design, matrix, report, sensitivity
from evaluation.store.manifest import read_manifest, write_manifest
from isac_track import datasets
from isac_track.errors import IsacTrackError

SLASH = "\N{DIVISION SLASH}"
"""Looks like the one that a file name cannot have."""
SCRIPT = "<script>alert(1)</script>"
ODD = (
    SCRIPT
    + " a \"b\" 'c' & <i>d &lt; $(touch was-executed) `id`; touch was-executed -rf"
    " Zürich \N{GRINNING FACE} \N{RIGHT-TO-LEFT OVERRIDE}x [red]x[/red] [/] \\[b]"
    " $_%&#{}~^\\input{x}"
)


TURNS = {"": (1, 1), "-": (-1, 1), "+": (1, -1)}


def write_csv(path, tracks, *, mark=""):
    """Thirty-six people whose ids and groups end in `mark`: each track, also turned."""
    walks = []
    for (turn, signs), track in product(TURNS.items(), tracks):
        result = f"{track.source[0]}{turn}{mark}"
        walk = pd.DataFrame(track.xy * signs, columns=["x", "y"])
        walks.append(walk.assign(t=track.t, id=result, group=f"g{result}"))
    pd.concat(walks).to_csv(path, index=False)
    return path


def run(
    path,
    out,
    *,
    attacks=("moving_average", "shape"),
    tasks=("rerelease",),
    pictures=True,
):
    axes = {"mechanisms": ("raw", "fid:1"), "attacks": attacks, "tasks": tasks}
    return evaluation.run(smoke(path, out, scenes=4, **axes), pictures=pictures)


@pytest.fixture(scope="module")
def plain(tmp_path_factory, tracks):
    folder = tmp_path_factory.mktemp("plain")
    return run(write_csv(folder / "walks.csv", tracks), folder / "run")


@pytest.fixture(scope="module")
def odd(tmp_path_factory, tracks):
    """A name, the run of it, and what the command says that draws its page."""
    folder, name = tmp_path_factory.mktemp("odd"), ODD.replace("/", SLASH)
    path = write_csv(folder / f"{name}.csv", tracks, mark=ODD)
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as shown:
        results = run(path, folder / "run", pictures=False)
        assert report.main([str(results.out)]) == 0
    return name, results, shown.getvalue()


class TestOddNames:
    def test_no_tag_and_no_attribute_comes_from_a_name(self, odd, plain):
        name, results, _ = odd
        page, usual = (
            Tags((item.out / "report.html").read_text(encoding="utf-8"))
            for item in (results, plain)
        )
        structure, expected = (
            {(tag, *sorted(attributes)) for tag, attributes in item.opened}
            for item in (page, usual)
        )
        assert structure == expected
        assert name in "".join(page.text)
        values = [
            value for _, attributes in page.opened for value in attributes.values()
        ]
        assert not any(str(value).strip().startswith("javascript:") for value in values)

    def test_every_figure_is_well_formed_and_of_the_usual_parts(self, odd, plain):
        figures = [*(odd[1].out / "figures").glob("*.svg")]
        assert figures
        for path in figures:
            parts, usual = (
                {element.tag for element in ET.parse(figure).iter()}
                for figure in (path, plain.out / "figures" / path.name)
            )
            assert parts == usual

    def test_tables_and_manifest_give_the_name_back(self, odd):
        name, results, _ = odd
        for file in ("summary.csv", "linkability.csv"):
            table = pd.read_csv(results.out / file, keep_default_na=False)
            assert set(table["dataset"]) == {name}
        manifest, verdict = (
            json.loads((results.out / file).read_text(encoding="utf-8"))
            for file in ("manifest.json", "verdict.json")
        )
        assert manifest["dataset"]["name"] == verdict["dataset"] == name
        # Of people, whose ids have it in this recording, nobody is named.
        assert not any(
            name.replace(SLASH, "/") in group for group in manifest["groups"]
        )

    def test_nothing_of_latex_is_left_unescaped(self, odd):
        for path in (odd[1].out / "tables").glob("*.tex"):
            text = path.read_text(encoding="utf-8")
            assert "\\input{x}" not in text
            for line in text.splitlines():
                assert not re.search(
                    r"(?<!\\)[#^~]", re.sub(r"(?<!\\)%.*", "", line)
                ), line

    def test_the_terminal_shows_it_literally_and_no_name_reaches_a_shell(self, odd):
        name, results, shown = odd
        assert "\x1b" not in shown
        assert name.split(" ")[0] in shown
        assert "[red]x[/red]".replace("/", SLASH) in shown
        assert not list(results.out.parent.rglob("was-executed"))


def test_a_file_name_that_is_no_text_is_read_and_shown(tmp_path, tracks, capsys):
    path = write_csv(tmp_path / "walks.csv", tracks)
    odd = path.rename(Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.csv")))
    results = run(odd, tmp_path / "run", attacks=(), tasks=())
    assert results.manifest["dataset"]["name"] == "caf?"
    assert "caf?" in (results.out / "report.html").read_text(encoding="utf-8")
    capsys.readouterr()
    missing = os.fsdecode(os.fsencode(tmp_path) + b"/\xff.csv")
    arguments = ["--dataset", missing, "--out", str(tmp_path / "other")]
    assert matrix.main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert "no such file" in line


EVIL = """
from dataclasses import dataclass
from pathlib import Path
Path({mark!r}).touch()

@dataclass(frozen=True)
class Evil:
    eta: float = 1.0
    requires = frozenset()
    uses = frozenset()
    def share(self, sensed, rng): ...
    def predict(self, release, t_future): ...
    def fit(self, context): ...
"""
PLANTED = [
    "evil_module:Evil",
    "evil_module:Evil:1",
    "os:system",
    "evil_package.inner:Evil",
]


@pytest.fixture
def evil(tmp_path, monkeypatch):
    """Modules that could be imported, and the file that would tell."""
    folder = tmp_path / "importable"
    (folder / "evil_package").mkdir(parents=True)
    mark = tmp_path / "was-imported"
    for name in ("evil_module.py", "evil_package/__init__.py", "evil_package/inner.py"):
        (folder / name).write_text(EVIL.format(mark=str(mark)), encoding="utf-8")
    monkeypatch.syspath_prepend(str(folder))
    yield mark
    for name in [name for name in sys.modules if name.startswith("evil_")]:
        del sys.modules[name]


def replanted(value, spec):
    """Every SPEC of a manifest replaced by another."""
    if isinstance(value, dict):
        return {key: replanted(inner, spec) for key, inner in value.items()}
    if isinstance(value, list):
        return [replanted(inner, spec) for inner in value]
    is_spec = isinstance(value, str) and re.match(
        r"(fid|fixed|raw|least_|moving_|shape)", value
    )
    return spec if is_spec else value


@pytest.fixture
def planted(plain, tmp_path):
    """How to copy the plain run with another SPEC wherever one stands."""

    def to_plant(spec, *, only_settings=False):
        out = shutil.copytree(plain.out, tmp_path / "planted")
        manifest = read_manifest(out)
        manifest |= {"settings": replanted(manifest["settings"], spec)}
        write_manifest(out, manifest if only_settings else replanted(manifest, spec))
        for path in () if only_settings else (out / "verdict.json", out / "flags.json"):
            manifest = json.loads(path.read_text(encoding="utf-8"))
            path.write_text(json.dumps(replanted(manifest, spec)), encoding="utf-8")
        return out

    return to_plant


class TestNothingIsImportedFromAFile:
    def test_the_evil_module_does_what_it_says(self, evil):
        with pytest.raises(IsacTrackError):
            evaluation.run(evaluation.Settings(mechanisms=("evil_module:Nothing",)))
        assert evil.exists()

    @pytest.mark.parametrize(
        ("spec", "only_settings"),
        [("evil_module:Evil:1", False), ("evil_package.inner:Evil", True)],
    )
    def test_commands_import_nothing(
        self, planted, evil, spec, only_settings, plain, capsys
    ):
        out = str(planted(spec, only_settings=only_settings))
        codes = [
            report.main([out]),
            compare.main([out, str(plain.out)]),
            design.main(["--max-missed", "0.9", out]),
            sensitivity.main([out, "--variant", "epsilon=0.5", "--jobs", "1"]),
        ]
        assert not evil.exists()
        assert codes.pop() == 2
        assert set(codes) <= {0, 1, 2, 3}
        assert "Traceback" not in capsys.readouterr().err

    @pytest.mark.parametrize("spec", PLANTED)
    def test_a_recording_imports_nothing(self, evil, spec, tmp_path, tracks):
        path = write_csv(tmp_path / f"{spec}.csv", tracks, mark=spec)
        result = datasets.load(path)
        assert result.name == spec
        assert result.tracks.source[0].endswith(spec)
        assert not evil.exists()


SOURCES = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for package in ("isac_track", "predictors", "attacks", "evaluation")
    for path in (ROOT / package).rglob("*.py")
}


def source_matches(pattern):
    return {name for name, text in SOURCES.items() if re.search(pattern, text)}


def test_nothing_that_runs_what_it_reads_is_hidden_from_the_linter():
    """Ruff's S rules know eval, exec, shells, pickle and the like."""
    assert (
        source_matches(r"noqa:[^#\n]*\bS(102|30[1-7]|310|50\d|60[245679])\b") == set()
    )


def test_a_module_whose_name_is_not_in_the_source_is_imported_in_few_places():
    """Classes and metrics that the user named, and fixed tables of our own modules."""
    assert source_matches(r"(import_module|resolve_name)\((?![\s\"')])") == {
        "evaluation/__init__.py",
        "evaluation/__main__.py",
        "evaluation/reporting/figures/figure.py",
        "evaluation/pool/dask.py",
        "evaluation/pool/serve.py",
        "isac_track/compiling.py",
        "isac_track/kalman/__init__.py",
        "isac_track/plugins.py",
        "isac_track/testing/__main__.py",
    }
