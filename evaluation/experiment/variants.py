"""What the verdict may depend on, one change each: the variants of `evaluation.sensitivity`."""

from __future__ import annotations

from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from isac_track.config import StageSettings
from isac_track.datasets.registry import KNOWN, known
from isac_track.errors import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

BASE: Final = "base"
RIDGE: Final[Mapping[str, Mapping[str, float]]] = {
    "cap=1.5": {
        "sigma_cap_m": 1.5,
        "processing_gain_db": 32.78,
        "large_scale_db": 12.24,
        "crb_gap_db": 14.03,
    },
    "cap=3": {
        "sigma_cap_m": 3.0,
        "processing_gain_db": 32.24,
        "large_scale_db": 11.54,
        "crb_gap_db": 12.84,
    },
    "beam=4": {
        "beam_fluctuation_db": 4.0,
        "processing_gain_db": 31.11,
        "large_scale_db": 14.86,
        "crb_gap_db": 12.28,
    },
    "exponent=2": {
        "path_loss_exponent": 2.0,
        "processing_gain_db": 11.12,
        "large_scale_db": 12.21,
        "crb_gap_db": 13.26,
    },
    "exponent=3.5": {
        "path_loss_exponent": 3.5,
        "processing_gain_db": 56.55,
        "large_scale_db": 11.19,
        "crb_gap_db": 13.29,
    },
}
"""Stage `sensing`: what is fixed elsewhere, and the constants that then fit the paper's numbers.

As `python -m evaluation.calibrate --ridge` prints them (Students03, 5,000 scenes, seed 0); the same
table is in docs/reproduction.md.
"""
_SHORT: Final = {"law": "sensing.law", "epsilon": "privacy.epsilon_m"}
_PREDICTOR, _RECORDING = "predictor", "recording"
_LAWS: Final = ("isotropic", "fixed_direction")
_EPSILONS_M: Final = ("0.1", "0.2", "0.5", "1")
_PREDICTORS: Final = ("kalman_cv", "least_squares")
_RECORDINGS: Final = ("students03", "zara01", "plaza")
_FORMS: Final = "STAGE.KEY=VALUE, law=LAW, epsilon=METRES, predictor=SPEC, recording=NAME"


@dataclass(frozen=True, slots=True)
class Variant:
    """One assumption of a run, changed."""

    name: str
    stages: Mapping[str, Any] = field(default_factory=dict)
    """``{"stage.key": value}``"""
    predictor: str = ""
    """SPEC; empty: that of the run."""
    recording: str = ""
    """Name or path; empty: that of the run."""

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
        flat = stages_of(manifest).flat()
        predictors = manifest["settings"]["predictors"]
        return (
            self.name != BASE
            and self.stages == {name: flat[name] for name in self.stages}
            and self.predictor in ("", *predictors[:1])
            and self.recording in ("", manifest["dataset"]["name"], manifest["dataset"]["path"])
        )


def stages_of(manifest: Mapping[str, Any]) -> StageSettings:
    """Return the stage settings of a run.

    Raises
    ------
    SettingsError
        If it is of a version that had other settings.
    """
    return StageSettings().changed(manifest["settings"]["stages"])


def variants(manifest: Mapping[str, Any] | None = None) -> list[Variant]:
    """Return the variants that are run where none is named, the base first.

    Parameters
    ----------
    manifest : mapping, optional
        Of the run: what it did itself is left out. Without it, all of them.
    """
    names = [
        *(f"law={law}" for law in _LAWS),
        *(f"epsilon={metres}" for metres in _EPSILONS_M),
        *(f"ridge {point}" for point in RIDGE),
        *(f"{_RECORDING}={name}" for name in _RECORDINGS),
        *(f"{_PREDICTOR}={name}" for name in _PREDICTORS),
    ]
    found = [Variant(BASE), *(parse(name) for name in names)]
    if manifest is None:
        return found
    predicts = bool(manifest["settings"]["predictors"])
    found = [
        one
        for one in found
        if not one.changes_nothing(manifest) and (predicts or not one.predictor)
    ]
    # One other predictor will do: a run whose first is the paper's own is tried with the tracker.
    other = next((one.predictor for one in found if one.predictor), "")
    return [one for one in found if one.predictor in ("", other)]


def chosen(
    names: Sequence[str] | None, *, also: Sequence[str], manifest: Mapping[str, Any] | None
) -> list[Variant]:
    """Return the variants to run, each once, the base first.

    Parameters
    ----------
    names : sequence of str, optional
        By default those of `variants`.
    also : sequence of str
        STAGE.KEY=VALUE of further ones.
    manifest : mapping, optional
        Of the run.

    Raises
    ------
    IsacTrackError
        For an unknown one, or one that is what the run did.
    """
    added = [parse(text) for text in also]
    for text, one in zip(also, added, strict=True):
        if not one.stages:
            raise SettingsError(f"--set takes STAGE.KEY=VALUE, got {text!r}")
    named = variants(manifest)
    if names is not None:
        named = [Variant(BASE), *map(parse, names)]
    found = {one.name: one for one in (*named, *added)}
    for one in found.values():
        if manifest is not None and one.changes_nothing(manifest):
            raise SettingsError(f"{one.name} changes nothing: it is what the run did")
    return list(found.values())


def parse(name: str) -> Variant:
    """Return the variant of a name.

    Raises
    ------
    IsacTrackError
        If there is none, its setting is unknown or its value is out of range.
    """
    name = name.strip()
    key, equals, value = (part.strip() for part in name.partition("="))
    point = name.removeprefix("ridge ")
    if name == BASE:
        return Variant(BASE)
    if name.startswith("ridge ") and point in RIDGE:
        return Variant(name, {f"sensing.{one}": number for one, number in RIDGE[point].items()})
    if value and (key in _SHORT or ("." in key and " " not in key)):
        setting = _SHORT.get(key, key)
        changed = StageSettings().changed({setting: value}).flat()
        return Variant(f"{key}={value}", {setting: changed[setting]})
    if value and key == _PREDICTOR:
        from isac_track import plugins  # noqa: PLC0415 - seldom needed

        found = plugins.parse("predictors", value)
        if len(found) > 1:
            raise SettingsError(f"{name}: a variant takes one predictor, not a sweep")
        return Variant(f"{key}={value}", predictor=found[0].spec)
    if value and key == _RECORDING:
        if value not in KNOWN and not Path(value).exists():
            known(value)  # says what was meant
        return Variant(f"{key}={value}", recording=value)
    names = [one.name for one in variants()]
    near = get_close_matches(name, names, n=1)
    if equals and not value:
        raise SettingsError(f"variant {name!r} has no value")
    hint = f"did you mean {near[0]!r}?" if near else f"--list names them; also {_FORMS}"
    raise SettingsError(f"unknown variant {name!r}; {hint}")
