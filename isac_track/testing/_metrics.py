"""What is checked, and what a metric check is made of: the guard around functions, comparison."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from isac_track import conflict, privacy, sharing
from isac_track.errors import told
from isac_track.rng import stream
from isac_track.testing.engine import Check, statement_of
from isac_track.types import Bools, Floats, Ints

Function: TypeAlias = Callable[..., Any]  # One of those offered, guarded.
TOLERANCE = 1e-9  # Relative as well as absolute.
DRAWS = 100  # Random cases of a check that asks for `rng`.


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Metrics:
    """Functions to check, each for one trajectory or one scene; None: not offered.

    Arguments are passed by position. T samples, A agents, H steps, S scenes; NaN:
    undefined.
    """

    plr: Callable[[Floats, Floats, float], float] | None = None
    """(shared_xy (T, 2) m, true_xy (T, 2) m, epsilon_m) -> share of leaked samples, 0..1."""
    ael_s: Callable[[Floats, Floats, Floats, float], float] | None = None
    mel_s: Callable[[Floats, Floats, Floats, float], float] | None = None
    """Either: (shared_xy (T, 2) m, true_xy (T, 2) m, t (T,) s, epsilon_m) -> s."""
    exposure: (
        Callable[[Floats, Floats, Floats, Ints, float], tuple[Floats, ...]] | None
    ) = None
    """(shared_xy (M, 2) m, true_xy (M, 2) m, t (M,) s, offsets (N + 1,), epsilon_m) -> PLR, AEL
    and MEL, (N,) each: all trajectories in one call, end to end in flat arrays."""
    prediction_grid: Callable[[Floats, int, int], Floats] | None = None
    """(t (T,) s, window, horizon_steps) -> (H,) s."""
    robot_path: Callable[[Floats, Floats, float, Floats], Floats] | None = None
    """(start (2,) m, destination (2,) m, speed_mps, elapsed_s (H,)) -> (H, 2) m."""
    minimum_separation: Callable[[Floats, Floats], float] | None = None
    """(robot (A, H, 2) m, agents (A, H, 2) m) -> m."""
    is_conflict: Callable[[float, float], bool] | None = None
    """(separation_m, safety_radius_m) -> bool."""
    missed_conflict_rate: Callable[[Bools, Bools], float] | None = None
    false_alarm_rate: Callable[[Bools, Bools], float] | None = None
    """Either: (conflict (S,) bool, predicted (S,) bool) -> 0..1."""
    distance_mae_m: Callable[[Floats, Floats], float] | None = None
    """(true_separation_m (S,), predicted_separation_m (S,)) -> m."""
    fid_d_sigma: Callable[[Floats, float, float, float], Floats] | None = None
    """(fid (T,) 1/(m^2 s), eta 1/(m^2 s), alpha_m, beta) -> (T,) m."""


def _exposure(
    shared_xy: Floats, true_xy: Floats, t: Floats, offsets: Ints, epsilon_m: float
) -> tuple[Floats, Floats, Floats]:
    leaked = privacy.leakage_indicator(
        shared_xy=shared_xy, true_xy=true_xy, epsilon_m=epsilon_m
    )
    found = privacy.exposure(leaked=leaked, t=t, offsets=offsets)
    return found.plr, found.ael_s, found.mel_s


def _of_one(
    shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float
) -> list[float]:
    whole = np.array([0, len(t)])
    return [float(one[0]) for one in _exposure(shared_xy, true_xy, t, whole, epsilon_m)]


def _by_position(function: Function) -> Function:
    names = inspect.signature(function).parameters
    return lambda *values: function(**dict(zip(names, values, strict=True)))


OWN = Metrics(
    # Any clock: PLR counts samples.
    plr=lambda shared, true, eps: _of_one(
        shared, true, np.arange(1.0 * len(true)), eps
    )[0],
    ael_s=lambda *walk: _of_one(*walk)[1],
    mel_s=lambda *walk: _of_one(*walk)[2],
    exposure=_exposure,
    prediction_grid=lambda t, window, horizon_steps: conflict.prediction_grid(
        t=t, offsets=np.array([0, len(t)]), window=window, horizon_steps=horizon_steps
    )[0],
    robot_path=lambda start, end, speed, elapsed: conflict.robot_path(
        start=start[None],
        destination=end[None],
        speed_mps=speed,
        elapsed_s=elapsed[None, None],
    )[0, 0],
    minimum_separation=lambda a, b: conflict.minimum_separation(
        robot=a[None], agents=b[None]
    )[0],
    is_conflict=_by_position(conflict.is_conflict),
    missed_conflict_rate=_by_position(conflict.missed_conflict_rate),
    false_alarm_rate=_by_position(conflict.false_alarm_rate),
    distance_mae_m=_by_position(conflict.distance_mae_m),
    fid_d_sigma=_by_position(sharing.fid_d_sigma),
)
"""The project's own functions, one trajectory or one scene at a time; passes every check."""

CHECKS: dict[str, Check] = {}  # Filled as the modules of checks are imported.


def check(
    body: Callable[..., None],
    *,
    name: str = "",
    statement: str = "",
    needs: tuple[str, ...] = (),
) -> Callable[..., None]:
    """Register a check; it receives, guarded, the functions that its parameters are called after.

    One that asks for an `rng` besides runs on `DRAWS` random streams of its own.
    """
    parameters = tuple(inspect.signature(body).parameters)
    name, statement = name or body.__name__, statement or statement_of(body)
    needs = needs or tuple(need for need in parameters if need != "rng")

    def on_offered(metrics: Metrics) -> None:
        functions = [_guarded(need, getattr(metrics, need)) for need in needs]
        if "rng" not in parameters:
            body(*functions)
            return
        for index in range(DRAWS):
            body(*functions, rng=stream(0, "testing", name, index))

    CHECKS[name] = Check(name=name, statement=statement, body=on_offered, needs=needs)
    return body


def expect(actual: object, expected: object, *, what: str, case: object) -> None:
    """Compare numbers or arrays of numbers up to rounding; NaN equals NaN."""
    left, right = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    if left.shape != right.shape or not np.allclose(
        left, right, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True
    ):
        raise AssertionError(f"{what} is {show(left)}, expected {show(right)}; {case}")


def expect_call(function: Function, *arguments: object, gives: object) -> None:
    """Compare what a function returns with numbers; the call is the case."""
    name = function.__name__
    expect(function(*arguments), gives, what=name, case=_call(name, arguments))


def expect_that(holds: object, *, what: str, case: object) -> None:
    """Fail with `what` unless it holds."""
    if not holds:
        raise AssertionError(f"{what}; {case}")


def show(value: object) -> str:
    """Return a number or an array on one line."""
    if isinstance(value, np.ndarray) and value.ndim > 0:
        return " ".join(np.array2string(value, precision=12, separator=", ").split())
    return repr(value.item() if isinstance(value, np.ndarray) else value)


_ARRAYS = ("exposure", "prediction_grid", "robot_path", "fid_d_sigma")
_READ = dict.fromkeys(_ARRAYS, partial(np.asarray, dtype=float)) | {"is_conflict": bool}
"""How the result of a function is read; of all others it is one number."""


def _guarded(name: str, function: Function) -> Function:
    """Wrap a function: whatever goes wrong inside it is a failed check, not a crash."""

    def guarded(*arguments: object) -> object:
        # Copies: a function that changes its input must not spoil the case for the next
        # one.
        given = [
            one.copy() if isinstance(one, np.ndarray) else one for one in arguments
        ]
        case = _call(name, arguments)
        try:
            result = function(*given)
        except (Exception, SystemExit) as error:
            raise AssertionError(f"{name} raised {told(error)}; {case}") from error
        for before, after in zip(arguments, given, strict=True):
            if (
                isinstance(after, np.ndarray)
                and after.tobytes() != np.asarray(before).tobytes()
            ):
                raise AssertionError(f"{name} changed its input; {case}")
        try:
            return _READ.get(name, float)(result)
        except (TypeError, ValueError) as error:
            wrong = (
                f"{name} returned {result!r}, which cannot be read as its result:"
                f" {error}"
            )
            raise AssertionError(f"{wrong}; {case}") from error

    guarded.__name__ = name
    return guarded


def _call(name: str, arguments: tuple[object, ...]) -> str:
    return f"called as {name}({', '.join(show(one) for one in arguments)})"
