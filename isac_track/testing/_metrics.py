"""What a metric check is made of: the offered functions, the guard around them, comparison."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeAlias

import numpy as np

from isac_track.errors import told
from isac_track.testing.engine import Check, attempt, statement_of
from isac_track.types import Bools, Floats, Ints

PointRatio: TypeAlias = Callable[[Floats, Floats, float], float]
Duration: TypeAlias = Callable[[Floats, Floats, Floats, float], float]
Batch: TypeAlias = Callable[[Floats, Floats, Floats, Ints, float], tuple[Floats, Floats, Floats]]
Grid: TypeAlias = Callable[[Floats, int, int], Floats]
Path: TypeAlias = Callable[[Floats, Floats, float, Floats], Floats]
Separation: TypeAlias = Callable[[Floats, Floats], float]
Decision: TypeAlias = Callable[[float, float], bool]
Rate: TypeAlias = Callable[[Bools, Bools], float]
DistanceError: TypeAlias = Callable[[Floats, Floats], float]
ErrorControl: TypeAlias = Callable[[Floats, float, float, float], Floats]

RELATIVE_TOLERANCE = 1e-9
ABSOLUTE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Metrics:
    """Functions to check, each for one trajectory or one scene; None: not offered.

    Arguments are passed by position. T samples, A agents, H steps, S scenes; NaN means that a
    quantity is undefined.
    """

    plr: PointRatio | None = None
    """(shared_xy (T, 2) m, true_xy (T, 2) m, epsilon_m) -> share of leaked samples, 0..1."""
    ael_s: Duration | None = None
    """(shared_xy (T, 2) m, true_xy (T, 2) m, t (T,) s, epsilon_m) -> s."""
    mel_s: Duration | None = None
    """(shared_xy (T, 2) m, true_xy (T, 2) m, t (T,) s, epsilon_m) -> s."""
    exposure: Batch | None = None
    """(shared_xy (M, 2) m, true_xy (M, 2) m, t (M,) s, offsets (N + 1,), epsilon_m) -> PLR, AEL
    and MEL, (N,) each: all trajectories in one call, end to end in flat arrays."""
    prediction_grid: Grid | None = None
    """(t (T,) s, window, horizon_steps) -> (H,) s."""
    robot_path: Path | None = None
    """(start (2,) m, destination (2,) m, speed_mps, elapsed_s (H,)) -> (H, 2) m."""
    minimum_separation: Separation | None = None
    """(robot (A, H, 2) m, agents (A, H, 2) m) -> m."""
    is_conflict: Decision | None = None
    """(separation_m, safety_radius_m) -> bool."""
    missed_conflict_rate: Rate | None = None
    """(conflict (S,) bool, predicted (S,) bool) -> 0..1."""
    false_alarm_rate: Rate | None = None
    """(conflict (S,) bool, predicted (S,) bool) -> 0..1."""
    distance_mae_m: DistanceError | None = None
    """(true_separation_m (S,), predicted_separation_m (S,)) -> m."""
    fid_d_sigma: ErrorControl | None = None
    """(fid (T,) 1/(m^2 s), eta 1/(m^2 s), alpha_m, beta) -> (T,) m."""


CHECKS: dict[str, Check] = {}
"""Filled as the modules of checks are imported."""


def check(body: Callable[..., None]) -> Callable[..., None]:
    """Register a check; it receives the functions that its parameters are called after."""
    needs = tuple(inspect.signature(body).parameters)
    register(body, name=body.__name__, statement=statement_of(body), needs=needs)
    return body


def register(
    body: Callable[..., None], *, name: str, statement: str, needs: tuple[str, ...]
) -> None:
    """Add a check to the kit; `body` receives the functions that it needs, guarded."""
    unknown = set(needs) - {item.name for item in fields(Metrics)}
    if unknown:
        raise TypeError(f"{name} asks for unknown functions: {sorted(unknown)}")

    def on_offered(metrics: Metrics) -> None:
        body(*(_guarded(need, getattr(metrics, need)) for need in needs))

    CHECKS[name] = Check(name=name, statement=statement, body=on_offered, needs=needs)


def expect(actual: object, expected: object, *, what: str, case: object) -> None:
    """Compare numbers or arrays of numbers up to rounding; NaN equals NaN."""
    left, right = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    same_shape = left.shape == right.shape
    if not same_shape or not np.allclose(
        left, right, rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE, equal_nan=True
    ):
        raise AssertionError(f"{what} is {show(left)}, expected {show(right)}; {case}")


def expect_call(function: Callable[..., Any], *arguments: object, gives: object) -> None:
    """Compare what a function returns with numbers; the call is the case."""
    name = function.__name__
    expect(function(*arguments), gives, what=name, case=_call(name, arguments))


def expect_that(holds: object, *, what: str, case: object) -> None:
    """Fail with `what` unless it holds."""
    if not holds:
        raise AssertionError(f"{what}; {case}")


def show(value: object) -> str:
    """Return a number or an array on one line."""
    if isinstance(value, np.ndarray):
        if value.ndim == 0:
            return repr(value.item())
        return " ".join(np.array2string(value, precision=12, separator=", ").split())
    return repr(value)


Kind: TypeAlias = Literal["number", "decision", "array", "arrays"]
_KIND: dict[str, Kind] = {
    "exposure": "arrays",
    "prediction_grid": "array",
    "robot_path": "array",
    "fid_d_sigma": "array",
    "is_conflict": "decision",
}


def _guarded(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function: whatever goes wrong inside it is a failed check, not a crash."""

    def call(*arguments: object) -> Any:  # noqa: ANN401 - a number, a decision or arrays
        # Copies: a function that changes its input must not spoil the case for the next one.
        given = [one.copy() if isinstance(one, np.ndarray) else one for one in arguments]
        result = attempt(
            lambda: function(*given),
            failing=lambda error: f"{name} raised {told(error)}; {_call(name, arguments)}",
        )
        for before, after in zip(arguments, given, strict=True):
            if isinstance(after, np.ndarray) and after.tobytes() != np.asarray(before).tobytes():
                raise AssertionError(f"{name} changed its input; {_call(name, arguments)}")
        try:
            return _read(result, _KIND.get(name, "number"))
        except (TypeError, ValueError) as error:
            raise AssertionError(
                f"{name} returned {result!r}, which cannot be read as its result: {error}; "
                f"{_call(name, arguments)}"
            ) from error

    call.__name__ = name
    return call


def _read(result: Any, kind: Kind) -> Any:  # noqa: ANN401 - whatever another project returns
    if kind == "array":
        return np.asarray(result, dtype=float)
    if kind == "arrays":
        first, second, third = result
        return tuple(np.asarray(part, dtype=float) for part in (first, second, third))
    if kind == "decision":
        return bool(result)
    return float(result)


def _call(name: str, arguments: tuple[object, ...]) -> str:
    return f"called as {name}({', '.join(show(one) for one in arguments)})"
