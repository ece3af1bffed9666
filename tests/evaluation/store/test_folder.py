"""The run folder: messages where it cannot be used, its manifest, its checksums."""

import contextlib
import copy
import errno
import hashlib
import json
import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers.commands import assert_refused
from helpers.runs import change_code
from helpers.small_runs import smoke, write_walks
from helpers.summaries import change_first_cell, edit_manifest

import evaluation
from evaluation import matrix, report
from evaluation.api import rebuild
from evaluation.plan.fingerprint import digest
from evaluation.plan.plan import make_plan
from evaluation.reporting.announcements import plan_lines
from evaluation.store import folder as store
from evaluation.store.checksums import write_checked
from evaluation.store.lock import locked
from evaluation.store.manifest import LAYOUT, read_manifest, write_manifest
from isac_track.errors import DataError, IsacTrackError, SettingsError

NOBODY = 65534


@contextlib.contextmanager
def forbidden(out, name=".", mode=0):
    """The named file has other rights; root, who may do everything, is nobody."""
    is_root = os.geteuid() == 0
    for path in (out, *out.rglob("*")) if is_root else ():
        os.chown(path, NOBODY, NOBODY)
    (out / name).chmod(mode)
    os.seteuid(NOBODY if is_root else os.geteuid())
    try:
        yield
    finally:
        os.seteuid(0 if is_root else os.geteuid())
        (out / name).chmod(0o755)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The settings of a run that takes less than a second."""
    walks = write_walks(tmp_path_factory.mktemp("walks") / "walks.csv", n_people=12)
    return smoke(walks, scenes=8)


@pytest.fixture(scope="module")
def options(tiny):
    """The same for the command."""
    words = (
        f"--dataset={tiny.dataset} --preset=smoke --scenes=8 --mechanism=raw --jobs=1"
    )
    words += (
        " --mechanism=fixed:0.7 --predictor=least_squares --attack=none --task=none"
    )
    words += " --set=conflict.horizons_s=none"
    return words.split()


@pytest.fixture(scope="module")
def finished(tmp_path_factory, tiny):
    out = tmp_path_factory.mktemp("folder") / "finished"
    evaluation.run(replace(tiny, out=out), pictures=False)
    return out


@pytest.fixture
def out(finished, tmp_path):
    """A copy of the finished run."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def everybodys():
    """A folder that nobody else's rights stand before, unlike those of the tests."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


class TestWhereTheFolderCannotBeUsed:
    @pytest.mark.parametrize("dry", [True, False])
    @pytest.mark.parametrize(
        ("name", "said"),
        [
            ("n" * 300, "File name too long; "),
            ("file", "is a file; "),
            ("file/run", "is a file; "),
            ("/proc/run", "No such file or directory; "),
            ("run\udcff", ""),
        ],
    )
    def test_it_is_said_before_anything_is_announced(
        self, dry, name, said, tmp_path, ran, options
    ):
        (tmp_path / "file").touch()
        ended = ran(matrix, *options, "--out", tmp_path / name, *["--dry-run"] * dry)
        if name == "/proc/run" and not dry:  # what cannot be made is told when it is
            assert ended.code == 2
            return
        assert_refused(ended, said, "choose another --out")
        assert len(ended.err.splitlines()) == 1

    @pytest.mark.parametrize("dry", [True, False])
    def test_a_name_that_no_folder_can_have_is_one_line(
        self, dry, tmp_path, ran, options
    ):
        config = tmp_path / "run.toml"
        config.write_text(r'out = "a\u0000b"')
        ended = ran(matrix, *options, "--config", config, *["--dry-run"] * dry)
        assert_refused(
            ended, r"'a\x00b' cannot be the name of a folder; choose another"
        )

    def test_somebody_elses_folder_is_named(self, tmp_path, tiny):
        out = tmp_path / "run"
        plan = make_plan(replace(tiny, out=out))
        with forbidden(tmp_path):
            for look in (
                lambda: [*plan_lines(plan)],
                lambda: evaluation.run(plan=plan),
            ):
                with pytest.raises(
                    SettingsError, match="Permission denied; choose another"
                ):
                    look()
            with pytest.raises(DataError, match=f"{out}.*Permission denied"):
                read_manifest(out)

    @pytest.mark.parametrize("name", ["cells", "SHA256SUMS", "."])
    def test_what_may_not_be_read_in_a_run_is_named(
        self, name, finished, everybodys, tiny
    ):
        out = Path(shutil.copytree(finished, everybodys / "run"))
        plan = make_plan(replace(tiny, out=out))
        with forbidden(out, name):
            for look in (
                lambda: [*plan_lines(plan)],
                lambda: evaluation.run(plan=plan),
            ):
                with pytest.raises(IsacTrackError, match=f"{out}.*Permission denied"):
                    look()

    @pytest.mark.parametrize(
        ("name", "command", "said"),
        [
            ("cells", "matrix", "cannot use {path}: File exists"),
            ("cells/*", "matrix", "cannot write {path}: Is a directory"),
            (".lock", "report", "cannot write {path}: Is a directory"),
            ("SHA256SUMS", "report", "{path} cannot be read: Is a directory"),
            ("SHA256SUMS", "matrix", "{path} cannot be read: Is a directory"),
        ],
    )
    def test_what_is_in_place_of_another_is_named(
        self, out, name, command, said, ran, options
    ):
        path = min(out.glob(name), default=out / name)
        if name == "cells":
            shutil.rmtree(path)
            path.touch()
        else:
            path.unlink(missing_ok=True)
            path.mkdir()
        ended = (
            ran(report, out)
            if command == "report"
            else ran(matrix, *options, "--out", out)
        )
        assert_refused(ended, said.format(path=path))
        assert path.is_dir() is (name != "cells")

    def test_where_nothing_can_be_locked_a_run_is_refused(
        self, out, ran, monkeypatch, options
    ):
        def refuse(*_):
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

        monkeypatch.setattr("fcntl.flock", refuse)
        ended = ran(matrix, *options, "--out", out)
        assert_refused(
            ended, f"error: cannot lock {out / '.lock'}: No locks available; "
        )

    def test_a_folder_that_may_not_be_written_has_no_lock(self, finished, everybodys):
        out = Path(shutil.copytree(finished, everybodys / "run"))
        with (
            forbidden(out, mode=0o500),
            pytest.raises(
                SettingsError, match=r"run/\.lock: Permission denied; make the"
            ),
            locked(out),
        ):
            raise AssertionError("it is locked")


def places(value, at=()):
    """Every path in a JSON value except its root; of a list, its first members."""
    inner = value.items() if isinstance(value, dict) else ()
    inner = enumerate(value[:2]) if isinstance(value, list) else inner
    for key, item in inner:
        yield (*at, key)
        yield from places(item, (*at, key))


class TestManifest:
    def test_that_is_changed_anywhere_is_refused(self, finished, tmp_path):
        whole = json.loads((finished / "manifest.json").read_text())
        result = list(places(whole))
        assert len(result) > 100
        for *path, last in result:
            for change in ("abc", None):
                manifest = copy.deepcopy(whole)
                holder = manifest
                for key in path:
                    holder = holder[key]
                if change is None:
                    del holder[last]
                else:
                    holder[last] = change
                (tmp_path / "manifest.json").write_text(json.dumps(manifest))
                with pytest.raises(
                    DataError, match=r"is damaged; run|is not the manifest"
                ):
                    read_manifest(tmp_path)

    @pytest.mark.parametrize(
        "name", ["../manifest.json", "raw_00000_0.parquet", "/etc/passwd"]
    )
    def test_that_names_a_file_elsewhere_is_refused_whoever_sealed_it(self, name, out):
        edit_manifest(out, lambda run: change_first_cell(run, files=(name,)))
        with pytest.raises(DataError, match="is damaged"):
            store.open_run(out, identity={}, fresh=False)

    def test_that_is_damaged_is_replaced_by_fresh_and_nothing_else(
        self, out, ran, tiny, options
    ):
        (out / "manifest.json").write_text('{"identity": {}, "cells": []}')
        (out / "notes.txt").write_text("mine")
        message = (
            f"{out} was written by another version, or its manifest.json is damaged"
        )
        assert_refused(ran(report, out), message)
        assert_refused(
            ran(matrix, *options, "--out", out), "run the matrix again with --fresh"
        )
        evaluation.run(replace(tiny, out=out, fresh=True), pictures=False)
        assert len(list((out / "cells").iterdir())) == 1
        assert (out / "notes.txt").read_text() == "mine"

    @pytest.mark.parametrize(
        "held", [b"", b"[]", b'{"cells": 1}', b"\xff\xfe", b"[" * 100_000]
    )
    def test_that_nothing_can_be_made_of_is_one_line(self, held, out, ran, options):
        (path := out / "manifest.json").write_bytes(held)
        assert_refused(ran(report, out), f"{path} ")
        assert_refused(ran(matrix, *options, "--out", out), str(path))

    def test_of_a_run_that_never_began_is_continued_but_has_no_report(
        self, tmp_path, ran, tiny
    ):
        out = tmp_path / "run"
        plan = make_plan(replace(tiny, out=out))
        manifest = store.open_run(out, identity=plan.identity, fresh=False).manifest
        write_manifest(out, manifest | {"code": plan.code_hash, "state": "running"})
        assert_refused(ran(report, out), f"{out} holds a run that never started")
        assert len(evaluation.run(plan=plan, pictures=False).failed) == 0

    def test_of_a_run_without_a_finished_cell_has_no_report(self, out, ran):
        edit_manifest(out, lambda cell: cell.update(cells=[]))
        assert_refused(
            ran(report, out), f"{out} holds no finished cell; run the matrix again"
        )

    def test_that_takes_one_kind_of_cell_for_another_is_told_by_its_columns(
        self, out, ran
    ):
        edit_manifest(out, lambda run: change_first_cell(run, kind="predictor"))
        assert_refused(
            ran(report, out), "has no column conflict: it is no cell of the kind"
        )


class TestSizes:
    def test_are_those_of_the_files_of_a_finished_run(self, finished):
        sizes = json.loads((finished / "manifest.json").read_text())["sizes"]
        cells = (finished / "cells").iterdir()
        assert sizes == {path.name: path.stat().st_size for path in cells}

    def test_of_a_published_copy_are_those_of_its_files(self, finished, tmp_path):
        store.copy_without_private(finished, tmp_path / "copy")
        whole = read_manifest(finished)["sizes"]
        assert read_manifest(tmp_path / "copy")["sizes"] == whole != {}

    def test_name_a_missing_cell_before_anything_is_drawn_anew(self, out, ran):
        cell = min((out / "cells").iterdir())
        cell.unlink()
        before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
        assert_refused(ran(report, out), f"{cell} is missing; run the matrix again")
        assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == before

    def test_may_be_absent_as_in_runs_of_earlier_versions(self, out):
        written = json.loads((out / "manifest.json").read_text())
        del written["sizes"], written["seal"]
        written["seal"] = digest([LAYOUT, written])
        (out / "manifest.json").write_text(json.dumps(written))
        assert "sizes" not in read_manifest(out)
        results = rebuild(out)
        assert len(results.summary) > 0


def to_layout_4(out):
    """Rewrite a run folder as earlier versions did: a file for each unit of work."""
    written = json.loads((out / "manifest.json").read_text())
    (path,) = (out / "cells").iterdir()
    index = json.loads(pq.read_metadata(path).metadata[b"isac_track.cells"])
    for place, level in enumerate(written["cells"]):
        unit = index["units"][place]
        assert unit.pop("spec") == level["spec"]
        table = pq.ParquetFile(path).read_row_group(place)
        sink = pa.BufferOutputStream()
        with pq.ParquetWriter(sink, table.schema, store_schema=False) as writer:
            writer.write_table(table)
            writer.add_key_value_metadata(
                {b"isac_track.cells": json.dumps(unit).encode()}
            )
        name = f"{level['mechanism']}-sharing_00000_{place:016x}.parquet"
        write_checked(out, name, sink.getvalue().to_pybytes())
        level["files"] = [name]
    path.unlink()
    del written["seal"], written["sizes"]
    written["seal"] = digest([4, written])
    (out / "manifest.json").write_text(json.dumps(written))


def test_a_folder_with_a_file_for_each_unit_of_work_is_read_and_continued(out, tiny):
    expected = rebuild(out).summary
    to_layout_4(out)
    assert rebuild(out).summary.equals(expected)
    before = {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
    assert len(before) == 2
    wider = replace(tiny, mechanisms=(*tiny.mechanisms, "fid:1"), out=out)
    results = evaluation.run(wider, pictures=False)
    assert results.manifest["dropped_cells"] == 0
    after = {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
    assert before.items() <= after.items()
    assert len(after) == 3
    assert len(results.summary.merge(expected)) == len(expected)


class TestChecksums:
    def check(self, out):
        """As `sha256sum --check --strict` would."""
        lines = (out / "SHA256SUMS").read_text().splitlines()
        for line in lines:
            checksum, _, name = line.partition("  ")
            assert hashlib.sha256((out / name).read_bytes()).hexdigest() == checksum
        return {line.partition("/")[2] for line in lines}

    def test_have_no_lines_of_cells_that_were_dropped(self, out, monkeypatch, tiny):
        before = self.check(out)
        change_code(monkeypatch, "isac_track.sensing")
        results = evaluation.run(replace(tiny, out=out), pictures=False)
        assert results.manifest["dropped_cells"] == 4
        after = self.check(out)
        assert after == {path.name for path in (out / "cells").iterdir()}
        assert after.isdisjoint(before)

    def test_stay_as_they_were_where_they_cannot_be_written_anew(
        self, out, monkeypatch, tiny
    ):
        cell, *_ = sorted((out / "cells").iterdir())
        cell.unlink()
        before = (out / "SHA256SUMS").read_bytes()

        def full(_from, _to):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
        with pytest.raises(DataError, match=r"SHA256SUMS: No space left on device"):
            evaluation.run(replace(tiny, out=out), pictures=False)
        assert (out / "SHA256SUMS").read_bytes() == before


class TestAnnounced:
    def test_cells_without_a_checksum_do_not_count_as_finished(
        self, out, ran, tiny, options
    ):
        predictors = (*tiny.predictors, "constant_position")
        wider = replace(tiny, predictors=predictors, out=out)
        evaluation.run(wider, pictures=False)

        def said():
            axes = ("--predictor=constant_position", "--dry-run")
            ended = ran(matrix, *options, *axes, "--out", out)
            return " ".join(ended.err.split())  # in lines of 80

        assert "6 cells, 6 of them finished by SHA256SUMS, in" in said()
        first, second = (out / "SHA256SUMS").read_text().splitlines()
        (out / "SHA256SUMS").write_text(f"{first}\n{second[:70]}")
        assert "6 cells, 4 of them finished by SHA256SUMS, in" in said()
        (out / first.partition("  ")[2]).unlink()
        assert "6 cells, in" in said()
