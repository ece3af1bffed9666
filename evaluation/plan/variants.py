"""What the verdict may depend on, one change each: the variants of `evaluation.sensitivity`.

A variant's run has one assumption changed, and only the attacks that matter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from evaluation.plan.presets import PRESETS
from evaluation.plan.settings import Settings
from isac_track import datasets, plugins
from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN, known
from isac_track.errors import DataError, SettingsError, did_you_mean

BASE: Final = "base"
_FITTED: Final = ("processing_gain_db", "large_scale_db", "crb_gap_db")
RIDGE: Final[Mapping[str, Mapping[str, float]]] = {
    point: {fixed: value, **dict(zip(_FITTED, constants, strict=True))}
    for point, fixed, value, constants in (
        ("cap=1.5", "sigma_cap_m", 1.5, (32.75, 12.33, 14.03)),
        ("cap=3", "sigma_cap_m", 3.0, (32.22, 11.59, 12.86)),
        ("beam=4", "beam_fluctuation_db", 4.0, (31.19, 14.71, 12.37)),
        ("exponent=2", "path_loss_exponent", 2.0, (11.16, 12.15, 13.3)),
        ("exponent=3.5", "path_loss_exponent", 3.5, (56.49, 11.29, 13.28)),
    )
}
"""Stage `sensing`: what is fixed elsewhere, and the constants that then fit the paper's numbers, as
`scripts/calibrate.py --ridge` prints them (Students03, 5,000 scenes;
docs/reproduction.md)."""
_SHORT: Final = {"law": "sensing.law", "epsilon": "privacy.epsilon_m"}
_USUAL: Final = (
    "law=isotropic",
    "law=fixed_direction",
    "epsilon=0.1",
    "epsilon=0.2",
    "epsilon=0.5",
    "epsilon=1",
    "resample.min_duration_s=6",  # The default leaves those who stay, who are slower.
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
    """One assumption of a run, changed."""

    name: str
    stages: Mapping[str, Any] = field(default_factory=dict)  # ``{"stage.key": value}``
    predictor: str = ""  # SPEC; empty: that of the run.
    recording: str = ""  # Name or path; empty: that of the run.

    @property
    def about(self) -> str:
        """What is changed, for people."""
        if self.predictor:
            return f"the robot predicts with {self.predictor}"
        if self.recording:
            return f"people of {self.recording}"
        changes = ", ".join(f"{name} = {value}" for name, value in self.stages.items())
        return changes or "nothing changed, with the attacks that the verdict is about"

    def changes_nothing(self, manifest: Mapping[str, Any]) -> bool:
        """Return whether it is what a run did (`manifest` as in `manifest.json`)."""
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


def variants(manifest: Mapping[str, Any] | None = None) -> list[Variant]:
    """Return the variants that are run where none is named, the base first, less what a run did."""
    found = [Variant(BASE), *map(parse, _USUAL)]
    if manifest is None:
        return found
    found = [one for one in found if not one.changes_nothing(manifest)]
    # One other predictor will do: a run whose first is the paper's own is tried with
    # the tracker.
    predictors = [one.predictor for one in found if one.predictor]
    kept = predictors[:1] if manifest["settings"]["predictors"] else []
    return [one for one in found if one.predictor in ("", *kept)]


def chosen(
    names: Sequence[str] | None,
    *,
    also: Sequence[str],
    manifest: Mapping[str, Any] | None,
) -> list[Variant]:
    """Return the variants to run, each once, the base first.

    By default they are those of `variants`; `also` names further ones by
    STAGE.KEY=VALUE. Raises IsacTrackError for an unknown one, or one that is what the
    run did.
    """
    added = [parse(text) for text in also]
    for text, one in zip(also, added, strict=True):
        if not one.stages:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
    named = variants(manifest) if names is None else [Variant(BASE), *map(parse, names)]
    found = {one.name: one for one in (*named, *added)}
    for one in found.values():
        if manifest is not None and one.changes_nothing(manifest):
            raise SettingsError(
                f"variant {one.name} changes nothing: the run had this setting"
            )
    return list(found.values())


def parse(name: str) -> Variant:
    """Return the variant of a name.

    Raises IsacTrackError if there is none, its setting is unknown or its value is out
    of range.
    """
    name = name.strip()
    key, equals, value = (part.strip() for part in name.partition("="))
    point = name.removeprefix("ridge ")
    if name == BASE:
        return Variant(BASE)
    if name.startswith("ridge ") and point in RIDGE:
        return Variant(
            name, {f"sensing.{one}": number for one, number in RIDGE[point].items()}
        )
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


def settings_of(
    variant: Variant,
    *,
    manifest: Mapping[str, Any],
    attacks: Mapping[str, frozenset[str]],
    out: Path,
    scenes: int | None = None,
    jobs: int | None = None,
    trust: Sequence[str] = (),
) -> tuple[Settings, tuple[str, ...]]:
    """Return the settings of a variant's run in a folder `out`, and why tasks are left out of it.

    `attacks` are the SPECs of those to run, each with its tasks; a reconstruction has
    the task "". `trust` names classes of one's own that may be imported although a file
    names them. Raises IsacTrackError if its recording is not at hand, or a setting is
    unknown.
    """
    from attacks.tasks.build import (  # noqa: PLC0415 - a list of variants needs none
        sessions_of,
    )
    from attacks.tasks.task_list import TASKS  # noqa: PLC0415 - for --help

    ran = manifest["settings"]
    stages = StageSettings().changed(ran["stages"]).changed(variant.stages)
    recording, identity, own = (
        manifest["dataset"],
        manifest["identity"],
        dict[str, Any](),
    )
    source = variant.recording or recording["name"]
    if not variant.recording and recording["name"] not in KNOWN:
        own = {name: identity.get(name) for name in ("format", "fps", "unit")}
        own["sessions"] = tuple(recording.get("sessions", ()))
        own["persistent_ids"] = bool(identity.get("persistent_ids"))
        source = None if own["sessions"] else recording["path"]
    # Nobody waits for a network here: a data set that is missing fails with how to get
    # it.
    data = datasets.load(source, download=False, **own)
    if not variant.recording and data.sha256 != recording["sha256"]:
        raise DataError(
            f"{data.path} is no longer the recording that was run; run it again"
        )
    too_small, asked = dict[str, str](), set().union(*attacks.values()) - {""}
    for task in sorted(asked):
        try:
            sessions_of(
                TASKS[task], tracks=data.tracks, stages=stages, seed=ran["seed"]
            )
        except DataError as error:
            too_small[task] = str(error)
    predictors = () if variant.predictor else tuple(ran["predictors"][:1])
    named: list[tuple[plugins.Kind, str]] = [
        ("predictors", spec) for spec in predictors
    ]
    named += [("attacks", spec) for whole in attacks for spec in whole.split("@")]
    named += [("mechanisms", spec) for spec in ran["mechanisms"]]
    for kind, spec in named:
        # Only the user's own command line decides what is imported, never a file.
        if plugins.is_own_class(kind, spec) and spec not in trust:
            raise SettingsError(
                f"the run's files name {spec!r}, a class that is not built in; if you"
                f" trust its code, add --trust {spec}"
            )
    run = (asked - too_small.keys()) | {""}
    usual = PRESETS[ran["preset"]]
    is_usual = [ran["scenes"], ran["scenes_utility"]] == [
        usual.scenes,
        usual.utility_scenes,
    ]
    settings = Settings(
        preset=ran["preset"],
        dataset=source,
        **own,
        scenes=scenes if scenes is not None or is_usual else ran["scenes"],
        seed=ran["seed"],
        mechanisms=tuple(ran["mechanisms"]),
        predictors=(variant.predictor,) if variant.predictor else predictors,
        attacks=tuple(spec for spec, tasks in sorted(attacks.items()) if tasks & run),
        tasks=tuple(task for task in ran["tasks"] if task in run),
        stages=stages,
        keep_ids=identity.get("ids") == "kept",
        jobs=jobs,
        out=out,
    )
    return settings, tuple(too_small.values())
