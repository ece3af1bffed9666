"""A dry run: try all that could end a run before its first cell, and leave no trace."""

import tempfile
from dataclasses import replace
from pathlib import Path

from evaluation.plan.plan import Plan
from evaluation.pool.plugin_calls import PluginTrial, time_plugins
from evaluation.store.files import MANIFEST
from evaluation.store.folder import check_folder, refuse_other_run, usable
from evaluation.store.manifest import load_manifest_json, parse_manifest
from isac_track.errors import SettingsError


def rehearse(plan: Plan) -> PluginTrial:
    """Try all that a run does before it computes; return what plug-ins showed.

    The folder must be writable, and hold no other run. Every plug-in of a user's own is
    called on a few made-up people, and timed. Raises SettingsError, DataError or PluginError
    as the run would.
    """
    check_folder(plan.out)
    with usable(plan.out):
        _check_writable(plan.out)
        if (plan.out / MANIFEST).exists() and not plan.settings.fresh:
            manifest = parse_manifest(load_manifest_json(plan.out), out=plan.out)
            refuse_other_run(manifest["identity"], plan.identity, out=plan.out)
    with tempfile.TemporaryDirectory() as folder:
        return time_plugins(replace(plan, out=Path(folder)))


def _check_writable(out: Path) -> None:
    """Raise SettingsError if a run folder, or its nearest parent, is not writable."""
    folder = next(path for path in (out, *out.absolute().parents) if path.is_dir())
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".isac-track-"):
            pass
    except OSError as error:
        raise SettingsError(
            f"cannot write {folder}: {error.strerror}; choose another --out"
        ) from None
