"""Gauss-Newton with robust weights: the loop by which bundle adjustment and image alignment are fitted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from pzcap.types import Array, PzcapError

State = TypeVar("State")


class SolveReport(NamedTuple):
    """Report of an iterative solver."""

    converged: bool  # the last step was as small as the stop rule asks for
    steps: int  # steps taken
    cost: float  # sum of weighted squared residuals at the last linearisation, in the residual's unit squared


class NormalEquations(NamedTuple):
    """A robust cost linearised at a state."""

    normal: Array  # (U, U) ``sum w J^T J``, ``J`` the derivatives of the residuals by the step
    gradient: Array  # (U,) ``sum w J^T r``
    sigma: float  # robust standard deviation of the residuals ``r``, in their unit
    cost: float  # ``sum w r^2``


class Schedule(NamedTuple):
    """Steps of a fit, and the scale of the robust weights from step to step: it follows the residuals down."""

    steps: int  # at most
    scale: float  # of the first step, in the residual's unit
    least_steps: int = 1  # a fit that settles sooner goes on, since its scale has not come down yet
    least_scale: float = 0.0  # in the residual's unit
    sigmas: float = 3.0  # scale aimed at, in standard deviations of the residuals
    fall: float = 3.0  # largest factor by which the scale falls in a step
    steady: float = np.inf  # relative change of the scale below which the fit may end


class Prior(NamedTuple, Generic[State]):
    """A normal belief about the unknowns, weighed against the residuals by their own variance."""

    information: Array  # (U, U) inverse covariance
    departure: Callable[[State], Array]  # (U,) unknowns of a state minus the mean
    worth: float = 1.0  # so many residuals tell as much as one independent one would


class Solution(NamedTuple, Generic[State]):
    """Result of `minimise`."""

    state: State
    normal: Array  # (U, U) of the last step, the prior included; a held unknown has a row and column of the identity
    sigma: float  # robust standard deviation of the residuals at the last linearisation
    scale: float  # of the robust weights, for what comes after the last step
    report: SolveReport


def minimise(
    start: State,
    linearise: Callable[[State, float], NormalEquations],
    retract: Callable[[State, Array], State],
    settled: Callable[[Array], bool],
    schedule: Schedule,
    *,
    prior: Prior[State] | None = None,
    held: int | None = None,
) -> Solution[State]:
    """Minimise a robust cost by iteratively reweighted Gauss-Newton steps.

    A step solves ``(N + s^2 P) d = -(g + s^2 P e)``: normal matrix N and gradient g from ``linearise(state, scale)``,
    the prior's information P and departure e, s^2 the residuals' variance; then ``state = retract(state, d)``. It ends
    once ``settled(d)`` and the scale is steady. Unknown ``held`` keeps its value. Raises PzcapError where the equations
    are singular.
    """
    state, scale = start, schedule.scale
    for number in range(1, schedule.steps + 1):
        normal, gradient, sigma, cost = linearise(state, scale)
        if prior is not None:
            variance = prior.worth * sigma**2
            normal = normal + prior.information * variance
            gradient = gradient + variance * prior.information @ prior.departure(state)
        if held is not None:
            normal[held], normal[:, held], normal[held, held], gradient[held] = 0.0, 0.0, 1.0, 0.0
        try:
            step = np.asarray(-np.linalg.solve(normal, gradient), np.float64)
        except np.linalg.LinAlgError as error:
            raise PzcapError("what was measured leaves an unknown entirely open") from error
        state = retract(state, step)
        following = max(schedule.sigmas * sigma, schedule.least_scale)
        steady = abs(following - scale) < schedule.steady * scale
        converged = number >= schedule.least_steps and steady and settled(step)
        if converged:
            break
        scale = max(following, scale / schedule.fall)
    return Solution(state, normal, sigma, scale, SolveReport(converged, number, cost))
