"""Values that a user names on an axis: they replace the preset's, or add with a +."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from isac_track.errors import SettingsError, quoted

PLUS: Final = "+"


@dataclass(frozen=True, slots=True)
class Choice:
    """Values that a user names on an axis: SPECs, plug-in objects, names of tasks."""

    named: tuple[Any, ...] = ()
    replaces: bool = False  # Whether they replace the preset's values.

    def values(self, preset_values: tuple[str, ...]) -> tuple[Any, ...]:
        """Return the values of the axis, with the preset's own where these stay."""
        return self.named if self.replaces else (*preset_values, *self.named)


def parse_choice(given: Iterable[Any] | None, *, axis: str) -> Choice:
    """Return the choice that a list on an axis expresses; None keeps the preset's.

    A text `+NAME` adds NAME. An object has no text to begin with a +: after `"+"` as
    the first entry all others are added. Raises SettingsError if a list both adds and
    replaces, or if a + has nothing to add.

    >>> parse_choice(["+my_attack"], axis="attacks")
    Choice(named=('my_attack',), replaces=False)
    """
    if given is None:
        return Choice()
    values = tuple(given)
    if values[:1] == (PLUS,):
        named = tuple(_without_plus(value) for value in values[1:])
    else:
        plain = [value for value in values if not _adds(value)]
        if len(plain) == len(values):
            return Choice(values, replaces=True)
        if plain:
            added = next(value for value in values if _adds(value))
            raise SettingsError(
                f"{axis}: {quoted(added)} adds to the preset's and {quoted(plain[0])}"
                " replaces them; write + before each, or before none"
            )
        named = tuple(_without_plus(value) for value in values)
    empty_values = [
        value for value in named if isinstance(value, str) and value in ("", "none")
    ]
    if empty_values or not named:
        raise SettingsError(f"{axis}: a + is followed by what it adds, as +NAME")
    return Choice(named)


def _adds(value: Any) -> bool:  # noqa: ANN401 - SPECs and objects
    return isinstance(value, str) and value.strip().startswith(PLUS)


def _without_plus(value: Any) -> Any:  # noqa: ANN401 - SPECs and objects
    return value.strip().removeprefix(PLUS).strip() if _adds(value) else value
