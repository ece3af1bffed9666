"""Public names of earlier releases: for one release they work, and warn."""

import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a module whose `names` are new.

    A renamed object is got by its old name with a FutureWarning, which users see
    without asking for it.
    """

    def get(name: str) -> Any:  # noqa: ANN401 - any object of the module
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        message = (
            f"{module}.{name} is now called {names[name]}; the old name works until 0.3"
        )
        warnings.warn(message, FutureWarning, stacklevel=2)
        return getattr(sys.modules[module], names[name])

    return get
