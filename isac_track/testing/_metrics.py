"""The functions that are checked, and the parts of a check: guards and comparisons."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from isac_track import conflict, privacy, sharing
from isac_track.errors import error_text
from isac_track.rng import stream
from isac_track.testing.engine import Check, read_statement
from isac_track.types import Bools, Floats, Ints

Function: TypeAlias = Callable[..., Any]  # A function of `Metrics`, guarded.
TOLERANCE = 1e-9  # Relative as well as absolute.
DRAWS = 100  # Random cases of a check that asks for `rng`.


@dataclass(frozen=True, eq=False, kw_only=True, slots=True)
class Metrics:
    """Functions to check, each for one trajectory or one scene; None if not offered.

    Arguments are passed by position. T samples of a trajectory, A agents, H steps, S
    scenes; NaN: undefined.

    Attributes
    ----------
    plr
        ``(shared_xy (T, 2) m, true_xy (T, 2) m, epsilon_m)`` -> share of leaked
        samples.
    ael_s
        ``(shared_xy (T, 2) m, true_xy (T, 2) m, t (T,) s, epsilon_m)`` -> s.
    mel_s
        As `ael_s`.
    exposure
        ``(shared_xy (M, 2) m, true_xy (M, 2) m, t (M,) s, offsets (N + 1,),
        epsilon_m)`` -> PLR, AEL (s) and MEL (s), (N,) each: all N trajectories in one
        call, end to end in flat arrays.
    prediction_grid
        ``(t (T,) s, window, horizon_steps)`` -> (H,) s.
    robot_path
        ``(start (2,) m, destination (2,) m, speed_mps, elapsed_s (H,))`` -> (H, 2) m.
    minimum_separation
        ``(robot (A, H, 2) m, agents (A, H, 2) m)`` -> m.
    is_conflict
        ``(separation_m, safety_radius_m)`` -> bool.
    missed_conflict_rate
        ``(conflict (S,) bool, predicted (S,) bool)`` -> 0..1.
    false_alarm_rate
        As `missed_conflict_rate`.
    distance_mae_m
        ``(true_separation_m (S,), predicted_separation_m (S,))`` -> m.
    fid_d_sigma
        ``(fid (T,) 1/(m^2 s), eta 1/(m^2 s), alpha_m, beta)`` -> (T,) m.
    """

    plr: Callable[[Floats, Floats, float], float] | None = None
    ael_s: Callable[[Floats, Floats, Floats, float], float] | None = None
    mel_s: Callable[[Floats, Floats, Floats, float], float] | None = None
    exposure: (
        Callable[[Floats, Floats, Floats, Ints, float], tuple[Floats, ...]] | None
    ) = None
    prediction_grid: Callable[[Floats, int, int], Floats] | None = None
    robot_path: Callable[[Floats, Floats, float, Floats], Floats] | None = None
    minimum_separation: Callable[[Floats, Floats], float] | None = None
    is_conflict: Callable[[float, float], bool] | None = None
    missed_conflict_rate: Callable[[Bools, Bools], float] | None = None
    false_alarm_rate: Callable[[Bools, Bools], float] | None = None
    distance_mae_m: Callable[[Floats, Floats], float] | None = None
    fid_d_sigma: Callable[[Floats, float, float, float], Floats] | None = None


class _Exposures(NamedTuple):
    """PLR, AEL and MEL of N trajectories."""

    plr: Floats  # (N,) 0..1
    ael_s: Floats  # (N,) s
    mel_s: Floats  # (N,) s


def _exposure(
    shared_xy: Floats, true_xy: Floats, t: Floats, offsets: Ints, epsilon_m: float
) -> _Exposures:
    leaked = privacy.leakage_indicator(
        shared_xy=shared_xy, true_xy=true_xy, epsilon_m=epsilon_m
    )
    exposure = privacy.exposure(leaked=leaked, t=t, offsets=offsets)
    return _Exposures(exposure.plr, exposure.ael_s, exposure.mel_s)


def _exposure_alone(
    shared_xy: Floats, true_xy: Floats, t: Floats, epsilon_m: float
) -> _Exposures:
    """Return the exposure of a single trajectory."""
    return _exposure(shared_xy, true_xy, t, np.array([0, len(t)]), epsilon_m)


def _by_position(function: Function) -> Function:
    """Let a keyword-only function be called by position."""
    names = inspect.signature(function).parameters
    return lambda *values: function(**dict(zip(names, values, strict=True)))


OWN = Metrics(
    # Any clock: PLR counts samples.
    plr=lambda shared, true, eps: float(
        _exposure_alone(shared, true, np.arange(1.0 * len(true)), eps).plr[0]
    ),
    ael_s=lambda *walk: float(_exposure_alone(*walk).ael_s[0]),
    mel_s=lambda *walk: float(_exposure_alone(*walk).mel_s[0]),
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
"""The project's own functions, for one trajectory or scene; they pass every check."""

CHECKS: dict[str, Check] = {}  # Filled as the modules of checks are imported.


def check(
    body: Callable[..., None],
    *,
    name: str = "",
    statement: str = "",
    needs: tuple[str, ...] = (),
) -> Callable[..., None]:
    """Register a check.

    The parameters of `body` name the functions of `Metrics` that it receives, each
    guarded (`_guarded`). A body with other parameters names its functions in `needs`.
    With a further parameter `rng` it runs on `DRAWS` random streams of its own.
    """
    parameters = tuple(inspect.signature(body).parameters)
    name, statement = name or body.__name__, statement or read_statement(body)
    needs = needs or tuple(need for need in parameters if need != "rng")

    def run_check(metrics: Metrics) -> None:
        functions = [_guarded(need, getattr(metrics, need)) for need in needs]
        if "rng" not in parameters:
            body(*functions)
            return
        for index in range(DRAWS):
            body(*functions, rng=stream(0, "testing", name, index))

    CHECKS[name] = Check(name=name, statement=statement, body=run_check, needs=needs)
    return body


def expect(actual: object, expected: object, *, label: str, case: object) -> None:
    """Compare numbers or arrays of numbers up to rounding; NaN equals NaN."""
    left, right = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    if left.shape != right.shape or not np.allclose(
        left, right, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True
    ):
        raise AssertionError(f"{label} is {show(left)}, expected {show(right)}; {case}")


def expect_call(function: Function, *arguments: object, gives: object) -> None:
    """Compare what a function returns with numbers; the call is the case."""
    name = function.__name__
    expect(function(*arguments), gives, label=name, case=_call(name, arguments))


def expect_that(holds: object, *, failure: str, case: object) -> None:
    """Raise AssertionError with the text `failure` unless the condition holds."""
    if not holds:
        raise AssertionError(f"{failure}; {case}")


def show(value: object) -> str:
    """Return a number or an array on one line."""
    if isinstance(value, np.ndarray) and value.ndim > 0:
        return " ".join(np.array2string(value, precision=12, separator=", ").split())
    return repr(value.item() if isinstance(value, np.ndarray) else value)


_ARRAY_FUNCTIONS = ("exposure", "prediction_grid", "robot_path", "fid_d_sigma")
_RESULT_READERS = dict.fromkeys(_ARRAY_FUNCTIONS, partial(np.asarray, dtype=float)) | {
    "is_conflict": bool
}
"""Converters of functions' results; all others return one number."""


def _guarded(name: str, function: Function) -> Function:
    """Wrap a function: any error inside it becomes a failed check, not a crash."""

    def guarded(*arguments: object) -> object:
        # A function that changes its input must not spoil the case for the next.
        copies = [
            argument.copy() if isinstance(argument, np.ndarray) else argument
            for argument in arguments
        ]
        case = _call(name, arguments)
        try:
            result = function(*copies)
        except (Exception, SystemExit) as error:  # a user's code may call sys.exit
            raise AssertionError(
                f"{name} raised {error_text(error)}; {case}"
            ) from error
        for before, after in zip(arguments, copies, strict=True):
            if (
                isinstance(after, np.ndarray)
                and after.tobytes() != np.asarray(before).tobytes()
            ):
                raise AssertionError(f"{name} changed its input; {case}")
        try:
            return _RESULT_READERS.get(name, float)(result)
        except (TypeError, ValueError) as error:
            complaint = (
                f"{name} returned {result!r}, which cannot be read as its result:"
                f" {error}"
            )
            raise AssertionError(f"{complaint}; {case}") from error

    guarded.__name__ = name
    return guarded


def _call(name: str, arguments: tuple[object, ...]) -> str:
    return f"called as {name}({', '.join(show(argument) for argument in arguments)})"
