"""How moment equations are made and solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from casid.arrays import Array
from casid.estimation.moments.equations.moment_covariance import Covariance
from casid.estimation.moments.equations.moment_equations import Weighting
from casid.estimation.moments.equations.moment_nlp import Constraint
from casid.estimation.nlp.solver import Solver

Form = Literal["linear", "eliminated", "lifted"]


@dataclass(frozen=True, slots=True)
class MomentSettings:
    """How moment equations are made and solved.

    Attributes
    ----------
    method : discretisation of the model (`casid.linear.sampled.discretisation.METHODS`).
    outputs : of the model that are used; None: all.
    form : ``"linear"`` (Approach 5.1: linear constraints, then the inverse map), ``"eliminated"``
        or ``"lifted"`` (Approach 5.2: bounds and constraints on the physical parameters).
    weighting : Q of (2.42), see `MomentEquations.root_weight`.
    noise_model : (autoregressive, moving average) orders of the ARMA model of the equation error,
        as (0, 4) for (7.58); None: prefilter 1, (7.60).
    iterations : refinements of instruments and prefilter after the first estimate.
    tolerance : relative change of parameters and noise model at which they have settled.
    stopping : how that change is measured: ``"relative"``, the largest of any parameter and, within
        ten times the tolerance, of any coefficient of a noise model; or ``"norm"``, (8.93),
        ||theta_p - last|| + sum over records of ||eta - last||, whatever the units.
    alpha : the function of (2.41) on errors in units of their spread; None: alpha(x) = x.
    covariance : see `casid.estimation.moments.equations.moment_covariance.moment_covariance`.
    constraints : each takes a mapping of parameters to symbols and returns what is to be zero.
    solver : of the programs; ``"null space"`` for the linear form's optimum in closed form, which
        takes a fifth of Ipopt's time and pays off where runs are counted in thousands.
    burn : samples left out at the start of every record.
    """

    method: str = "bilinear"
    outputs: Sequence[str] | None = None
    form: Form = "eliminated"
    weighting: Weighting = "2sls"
    noise_model: tuple[int, int] | None = None
    iterations: int = 5
    tolerance: float = 1e-4
    stopping: Literal["relative", "norm"] = "relative"
    alpha: Callable[[Array], Array] | None = None
    covariance: Covariance | None = None
    constraints: Sequence[Constraint] = ()
    solver: Solver | Literal["null space"] | None = None
    burn: int = 0
