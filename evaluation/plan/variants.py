"""The variants of `evaluation.sensitivity`: assumptions that the verdict may depend on.

A variant's run changes a single assumption, and has only the attacks that matter.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import NO_TRACKS, READING_OPTIONS, Settings
from isac_track import datasets, plugins
from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN, known
from isac_track.errors import DataError, SettingsError, did_you_mean

BASE: Final = "base"
_FITTED: Final = ("processing_gain_db", "large_scale_db", "crb_gap_db")
RIDGE: Final[Mapping[str, Mapping[str, float]]] = {
    point: {fixed: value} | dict(zip(_FITTED, constants, strict=True))
    for point, fixed, value, constants in (
        ("cap=1.5", "sigma_cap_m", 1.5, (32.75, 12.33, 14.03)),
        ("cap=3", "sigma_cap_m", 3.0, (32.22, 11.59, 12.86)),
        ("beam=4", "beam_fluctuation_db", 4.0, (31.19, 14.71, 12.37)),
        ("exponent=2", "path_loss_exponent", 2.0, (11.16, 12.15, 13.3)),
        ("exponent=3.5", "path_loss_exponent", 3.5, (56.49, 11.29, 13.28)),
    )
}
"""Settings of stage `sensing` that fit the paper's numbers as well, by name.

Each changes a fixed constant, and the fitted constants as `scripts/calibrate.py
--ridge` prints them (Students03, 5,000 scenes; docs/explanation/reproduction.md)."""
_SHORT: Final = {"law": "sensing.law", "epsilon": "privacy.epsilon_m"}
_USUAL: Final = (
    "law=isotropic",
    "law=fixed_direction",
    "epsilon=0.1",
    "epsilon=0.2",
    "epsilon=0.5",
    "epsilon=1",
    # The default keeps only people who stay long, who are slower.
    "resample.min_duration_s=6",
    *(f"ridge {point}" for point in RIDGE),
    "recording=students03",
    "recording=zara01",
    "recording=plaza",
    "predictor=kalman_cv",
    "predictor=least_squares",
)
_FORMS: Final = (
    "STAGE.KEY=VALUE, law=LAW, epsilon=METRES, predictor=SPEC, recording=NAME"
)


@dataclass(frozen=True, slots=True)
class Variant:
    """A run with a single assumption changed."""

    name: str
    stages: Mapping[str, Any] = field(default_factory=dict)  # ``{"stage.key": value}``
    predictor: str = ""  # SPEC; empty: that of the run.
    recording: str = ""  # Name or path; empty: that of the run.

    @property
    def description(self) -> str:
        """The change in words."""
        if self.predictor:
            return f"the robot predicts with {self.predictor}"
        if self.recording:
            return f"people of {self.recording}"
        changes = ", ".join(f"{name} = {value}" for name, value in self.stages.items())
        return changes or "nothing changed, with the attacks that the verdict is about"

    def changes_nothing(self, manifest: Mapping[str, Any]) -> bool:
        """Whether a run had these settings (`manifest` as in `manifest.json`)."""
        flat = StageSettings().changed(manifest["settings"]["stages"]).flat()
        predictors = manifest["settings"]["predictors"]
        return (
            self.name != BASE
            and self.stages == {name: flat[name] for name in self.stages}
            and self.predictor in ("", *predictors[:1])
            and self.recording
            in (
                "",
                manifest["dataset"]["name"],
                manifest["dataset"]["path"],
            )
        )


class VariantRun(NamedTuple):
    """The settings of a variant's run, and what its recording is too small for."""

    settings: Settings
    left_out: tuple[str, ...]
    """The reasons for which tasks are left out."""


def usual_variants(manifest: Mapping[str, Any] | None = None) -> list[Variant]:
    """Return the usual variants, the base first, without those that change nothing."""
    usual = [Variant(BASE), *map(parse_variant, _USUAL)]
    if manifest is None:
        return usual
    usual = [variant for variant in usual if not variant.changes_nothing(manifest)]
    # A single other predictor is enough: the tracker for a run whose first is the
    # paper's own.
    predictors = [variant.predictor for variant in usual if variant.predictor]
    wanted = predictors[:1] if manifest["settings"]["predictors"] else []
    return [variant for variant in usual if variant.predictor in ("", *wanted)]


def choose_variants(
    names: Sequence[str] | None,
    *,
    stage_values: Sequence[str],
    manifest: Mapping[str, Any] | None,
) -> list[Variant]:
    """Return the variants to run, each once, the base first.

    By default they are those of `usual_variants`; `stage_values` names further
    variants by STAGE.KEY=VALUE. Raises IsacTrackError for an unknown variant, or a
    variant whose settings the run had.
    """
    added = [parse_variant(text) for text in stage_values]
    for text, variant in zip(stage_values, added, strict=True):
        if not variant.stages:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
    named = (
        usual_variants(manifest)
        if names is None
        else [Variant(BASE), *map(parse_variant, names)]
    )
    by_name = {variant.name: variant for variant in (*named, *added)}
    for variant in by_name.values():
        if manifest is not None and variant.changes_nothing(manifest):
            raise SettingsError(
                f"variant {variant.name} changes nothing: the run had this setting"
            )
    return list(by_name.values())


def parse_variant(name: str) -> Variant:
    """Return the variant of a name.

    Raises IsacTrackError if the name, or its setting, is unknown, or its value is out
    of range.
    """
    name = name.strip()
    key, equals, value = (part.strip() for part in name.partition("="))
    point = name.removeprefix("ridge ")
    if name == BASE:
        return Variant(BASE)
    if name.startswith("ridge ") and point in RIDGE:
        stages = {f"sensing.{key}": number for key, number in RIDGE[point].items()}
        return Variant(name, stages)
    if value and (key in _SHORT or ("." in key and " " not in key)):
        setting = _SHORT.get(key, key)
        changed = StageSettings().changed({setting: value}).flat()
        return Variant(f"{key}={value}", {setting: changed[setting]})
    if value and key == "predictor":
        predictors = plugins.parse("predictors", value)
        if len(predictors) > 1:
            raise SettingsError(f"{name}: a variant takes one predictor, not a sweep")
        return Variant(f"{key}={value}", predictor=predictors[0].spec)
    if value and key == "recording":
        if value not in KNOWN and not Path(value).exists():
            known(value)  # says what was meant
        return Variant(f"{key}={value}", recording=value)
    if equals and not value:
        raise SettingsError(f"variant {name!r} has no value")
    hint = (
        did_you_mean(name, (BASE, *_USUAL), quote="'")
        or f"; --list names them; also {_FORMS}"
    )
    raise SettingsError(f"unknown variant {name!r}{hint}")


def variant_settings(
    variant: Variant,
    *,
    manifest: Mapping[str, Any],
    attacks: Mapping[str, frozenset[str]],
    out: Path,
    scenes: int | None = None,
    jobs: int | None = None,
    trust: Sequence[str] = (),
) -> VariantRun:
    """Return the settings of a variant's run in a folder `out`, and what it leaves out.

    `attacks` are the SPECs of those to run, each with its tasks; a reconstruction has
    the task "".
    `trust` names a user's classes that may be imported although a file names them.
    Raises IsacTrackError if its recording is not at hand, or a setting is unknown.
    """
    run_settings, identity = manifest["settings"], manifest["identity"]
    stages = StageSettings().changed(run_settings["stages"]).changed(variant.stages)
    source, reading = _recording(variant, manifest)
    # No download: a missing data set fails, and the message says how to get it.
    dataset = datasets.load(source, download=False, **reading)
    if not variant.recording and dataset.sha256 != manifest["dataset"]["sha256"]:
        raise DataError(
            f"{dataset.path} is no longer the recording that was run; run it again"
        )
    asked = set[str]().union(*attacks.values()) - {""}
    too_small = _too_small(asked, dataset, stages, seed=run_settings["seed"])
    predictors = () if variant.predictor else tuple(run_settings["predictors"][:1])
    _check_trusted([*attacks], predictors, run_settings["mechanisms"], trust=trust)
    tasks = (asked - too_small.keys()) | {""}
    usual = PRESETS[run_settings["preset"]]
    is_usual = [run_settings["scenes"], run_settings["scenes_utility"]] == [
        usual.scenes,
        usual.utility_scenes,
    ]
    settings = Settings(
        preset=run_settings["preset"],
        dataset=source,
        **reading,
        scenes=scenes if scenes is not None or is_usual else run_settings["scenes"],
        seed=run_settings["seed"],
        mechanisms=tuple(run_settings["mechanisms"]),
        predictors=(variant.predictor,) if variant.predictor else predictors,
        attacks=tuple(spec for spec, own in sorted(attacks.items()) if own & tasks),
        tasks=tuple(task for task in run_settings["tasks"] if task in tasks),
        policies=(),
        stages=stages.changed(NO_TRACKS),
        keep_ids=identity.get("ids") == "kept",
        jobs=jobs,
        out=out,
    )
    return VariantRun(settings, tuple(too_small.values()))


def _recording(
    variant: Variant, manifest: Mapping[str, Any]
) -> tuple[str | None, dict[str, Any]]:
    """Return the data set of a variant, and the options of reading its files.

    Another recording than the run's is read as it is by default.
    """
    recording, identity = manifest["dataset"], manifest["identity"]
    if variant.recording:
        return variant.recording, {}
    reading = {name: identity[name] for name in READING_OPTIONS if name in identity}
    if recording["name"] in KNOWN:
        return recording["name"], reading
    reading |= {name: identity.get(name) for name in ("format", "fps", "unit")}
    reading["sessions"] = tuple(recording.get("sessions", ()))
    reading["persistent_ids"] = bool(identity.get("persistent_ids"))
    return None if reading["sessions"] else recording["path"], reading


def _too_small(
    tasks: Iterable[str], dataset: datasets.Dataset, stages: StageSettings, *, seed: int
) -> dict[str, str]:
    """Return the tasks for which a data set has too few people, with the reasons."""
    from attacks.tasks.build import (  # noqa: PLC0415 - a list of variants needs none
        make_task_windows,
    )
    from attacks.tasks.task_list import TASKS  # noqa: PLC0415 - for --help

    reasons = {}
    for task in sorted(tasks):
        try:
            make_task_windows(
                TASKS[task], tracks=dataset.tracks, stages=stages, seed=seed
            )
        except DataError as error:
            reasons[task] = str(error)
    return reasons


def _check_trusted(
    attacks: Iterable[str],
    predictors: Iterable[str],
    mechanisms: Iterable[str],
    *,
    trust: Sequence[str],
) -> None:
    """Raise SettingsError for a user's class that is not in `trust`.

    The user's own command line decides which classes are imported, never a file.
    """
    specs: list[tuple[plugins.Kind, str]] = [
        ("predictors", spec) for spec in predictors
    ]
    specs += [("attacks", spec) for whole in attacks for spec in whole.split("@")]
    specs += [("mechanisms", spec) for spec in mechanisms]
    for kind, spec in specs:
        if plugins.is_own_class(kind, spec) and spec not in trust:
            raise SettingsError(
                f"the run's files name {spec!r}, a class that is not built in; if you"
                f" trust its code, add --trust {spec}"
            )
