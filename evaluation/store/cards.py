"""Cards of the board: what a card holds, its file, and the check of a stranger's file.

`evaluation/card.schema.json` describes the file; docs/reference/cards.md explains it.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from evaluation.store.files import read_regular_file, write_whole
from isac_track.errors import DataError

SCHEMA: Final = "card.schema.json"
_TYPES: Final[dict[str, tuple[type, ...]]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}


@dataclass(frozen=True, slots=True)
class CardScore:
    """A metric with its reader; numbers are None where they are undefined."""

    metric: str
    by: str
    value: float | None
    ci_low: float | None
    ci_high: float | None
    error: float | None  # Standard error.
    n: int  # Clusters of people.


@dataclass(frozen=True, slots=True)
class CardPlugin:
    """A plug-in of a card."""

    spec: str
    digest: str  # sha256 of its source.
    protects: bool = True
    adversary: str = ""  # Of an attack.


@dataclass(frozen=True, slots=True)
class CardDigits:
    """Low-order digits of a release, which may hide a message on what was sensed."""

    explained: float  # Share of the variance, on people held out.
    place: int  # Decimals before the pair of digits.
    target: str
    is_message: bool  # Whether they explain more than chance does.


@dataclass(frozen=True, slots=True)
class Card:
    """The scores of a mechanism with a policy, and all that they rest on."""

    protocol_version: int
    protocol_digest: str
    recording: str
    recording_digest: str
    law: str
    mechanism: CardPlugin
    mechanism_name: str  # As in results, without the level.
    level: float | None
    policy: CardPlugin
    form: str  # Of the policy's answers: samples, state or flag.
    seed: int | None  # None: secret; `seed_commitment` binds it.
    seed_commitment: str
    scores: tuple[CardScore, ...]
    primary: Mapping[str, CardScore]  # By axis: missed, known, followed.
    attacks: tuple[CardPlugin, ...]
    digits: CardDigits | None
    code_digest: str
    environment: Mapping[str, str]

    @property
    def hides_message(self) -> bool:
        """Whether the low-order digits are known to hide a message."""
        return self.digits is not None and self.digits.is_message

    @property
    def label(self) -> str:
        """Mechanism, policy, recording, law and seed in a line."""
        seed = f"seed {self.seed}"
        if self.seed is None:
            seed = f"secret seed {self.seed_commitment[:8]}"
        return (
            f"{self.mechanism.spec}, {self.policy.spec}, {self.recording}, {self.law},"
            f" {seed}"
        )

    @property
    def file_name(self) -> str:
        """Name of the card's file: readable, and different for different entries."""
        return card_file_name(
            self.recording,
            self.law,
            self.mechanism.spec,
            self.policy.spec,
            seed_label(self.seed, self.seed_commitment),
        )


def seed_label(seed: int | None, commitment: str) -> str:
    """Return the name of a seed: the number, or the start of a commitment."""
    return f"secret-{commitment[:12]}" if seed is None else str(seed)


def card_file_name(*parts: str) -> str:
    """Return a file name of an entry's parts; a digest keeps similar parts apart."""
    text = "-".join(re.sub(r"[^A-Za-z0-9.]+", "-", part).strip("-") for part in parts)
    mark = hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:8]
    return f"{text[:120]}-{mark}.json"


def write_card(card: Card, folder: Path) -> Path:
    """Write a card into a folder, whole or not at all, and return its path."""
    path = folder / card.file_name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"cannot make {folder}: {error.strerror}") from None
    write_whole(path, card_text(card).encode())
    return path


def card_text(card: Card) -> str:
    """Return the content of a card's file: equal cards have equal bytes."""
    content = asdict(card)
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_card(path: Path) -> Card:
    """Return the card of a file.

    DataError, in a line, for a file that is missing, no JSON or no card.
    """
    try:
        content = json.loads(read_regular_file(path), parse_constant=_refuse_constant)
    except FileNotFoundError:
        raise DataError(f"{path} is missing; isac-track card OUT makes cards") from None
    except (OSError, ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{path} cannot be read as a card: {reason}") from None
    fault = next(schema_faults(content, card_schema()), None)
    if fault is not None:
        raise DataError(f"{path} is no card: {fault}; see docs/reference/cards.md")
    return _as_card(content)


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of a card")


def _as_card(content: dict[str, Any]) -> Card:
    """Return the card of a file's content that fits the schema."""
    digits = content["digits"]
    nested = {
        "scores": tuple(CardScore(**score) for score in content["scores"]),
        "primary": {
            axis: CardScore(**score) for axis, score in content["primary"].items()
        },
        "mechanism": CardPlugin(**content["mechanism"]),
        "policy": CardPlugin(**content["policy"]),
        "attacks": tuple(CardPlugin(**attack) for attack in content["attacks"]),
        "digits": None if digits is None else CardDigits(**digits),
    }
    return Card(**{**content, **nested})


# The file does not change while a process runs.
@cache
def card_schema() -> dict[str, Any]:
    """Return the JSON schema of a card."""
    text = files("evaluation").joinpath(SCHEMA).read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


def schema_faults(
    value: object, schema: Mapping[str, Any], *, where: str = "card"
) -> Iterator[str]:
    """Yield what in a value breaks a schema, a line each, and where.

    Of JSON schema (2020-12) this reads `$ref`, `type`, `enum`, `pattern`, `minimum`,
    `maximum`, `required`, `properties`, `additionalProperties` and `items`. A `$ref` is
    looked up in `card_schema()`, also if `schema` is another.
    """
    if reference := schema.get("$ref"):
        schema = card_schema()["$defs"][reference.rpartition("/")[2]]
    types = schema.get("type", [])
    names = [types] if isinstance(types, str) else types
    if names and not any(_has_type(value, name) for name in names):
        yield f"{where} must be of type {' or '.join(names)}, got {_shown(value)}"
        return
    if "enum" in schema and value not in schema["enum"]:
        yield f"{where} must be {_listed(schema['enum'])}, got {_shown(value)}"
    if isinstance(value, str) and not re.search(schema.get("pattern", ""), value):
        yield f"{where} must match {schema['pattern']}, got {_shown(value)}"
    elif isinstance(value, int | float) and not _is_in_range(value, schema):
        yield f"{where} is out of range: {_shown(value)}"
    elif isinstance(value, dict):
        yield from _object_faults(value, schema, where=where)
    elif isinstance(value, list) and "items" in schema:
        for number, item in enumerate(value):
            yield from schema_faults(item, schema["items"], where=f"{where}[{number}]")


def _object_faults(
    value: Mapping[str, Any], schema: Mapping[str, Any], *, where: str
) -> Iterator[str]:
    for name in schema.get("required", ()):
        if name not in value:
            yield f"{where} has no {name}"
    properties, others = (
        schema.get("properties", {}),
        schema.get("additionalProperties", True),
    )
    for name, item in value.items():
        place = f"{where}.{name}"
        if name in properties:
            yield from schema_faults(item, properties[name], where=place)
        elif others is False:
            yield f"{where} has an unknown entry {_shown(name)}"
        elif isinstance(others, dict):
            yield from schema_faults(item, others, where=place)


def _is_in_range(value: float, schema: Mapping[str, Any]) -> bool:
    low, high = schema.get("minimum", value), schema.get("maximum", value)
    # `1e999` is read as infinite.
    return bool(math.isfinite(value) and low <= value <= high)


def _has_type(value: object, name: str) -> bool:
    if isinstance(value, bool):
        return name == "boolean"
    return isinstance(value, _TYPES[name])


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:60]}..."  # noqa: PLR2004 - a line


def _listed(values: Sequence[object]) -> str:
    return " or ".join(map(_shown, values))
