"""A model and the white noise that acts on it and on its sensors, sampled with exact derivatives.

    dx/dt = A x + B u + G w,    y[t] = C x + D u + E w + v[t]                               (1)

with A .. E functions of the physical parameters, w continuous white noise or noise held over each
sample, v the noise of the sensors. Continuous noise is sampled exactly (van Loan); derivatives come
from complex steps (Squire and Trapp, SIAM Review 40 (1998) 110-112), which subtract nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import ModelError
from casid.linear.filtering.kalman import SystemTangent
from casid.linear.filtering.noisy_system import NoisySystem, sample_noise, sample_system
from casid.linear.linear_model import linearise
from casid.model.declarations import Input
from casid.model.model import Model

_STEP = 1e-40  # of the complex step: no subtraction, so as small as may be


@dataclass(frozen=True, slots=True)
class White:
    """White noise: where it enters and how large it is.

    Parameters
    ----------
    where : an output (noise of every sample), an unknown input or a balance (process noise).
    sd : standard deviation, the start of its estimation or, if `is_known`, its value. Noise of an
        output has the output's unit; continuous process noise has the root of a (two-sided) power
        spectral density, unit of the input times sqrt(s); held process noise has the input's unit.
    held : process noise that is constant over each sample instead of continuous. Needed where an
        output responds at once: an accelerometer to a torque, and continuous white noise has no
        finite variance at an instant.
    """

    where: str
    sd: float
    is_known: bool = False
    held: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.sd, bool) or not isinstance(self.sd, int | float | np.number):
            raise ModelError(
                f"noise of {self.where}: sd = {self.sd!r} is not a number; give the standard "
                "deviation, a float"
            )
        if not np.isfinite(self.sd) or self.sd < 0 or (self.sd == 0 and not self.is_known):
            raise ModelError(
                f"noise of {self.where}: sd = {self.sd:g}; give a positive start, or zero as known"
            )


def noise_sources(noise: Sequence[White] | White) -> tuple[White, ...]:
    """The sources of a list of `White`, or of one alone.

    Raises
    ------
    ModelError
        If it is anything else, a mapping from place to size say.
    """
    if isinstance(noise, White):
        return (noise,)
    if isinstance(noise, Mapping):
        listed = ", ".join(f"White({name!r}, {sd!r})" for name, sd in noise.items())
        raise ModelError(
            f"noise is a mapping; give a list, noise=[{listed}], with the process noise among it"
        )
    several: Any = noise  # whatever it was given
    if not isinstance(several, list | tuple) or not all(isinstance(w, White) for w in several):
        raise ModelError(
            f"noise = {noise!r}; give a list of White(where, sd), one for each output and one for "
            "each source of process noise"
        )
    return tuple(several)


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """One experiment's model, sampled, at one point: system (1) of deviations, in absolute signals.

        z[t+1] = A z + B u + drift + K e,   y = C z + D u + offset + e,   z[0] = x - shift u + lead

    Attributes
    ----------
    tangent : derivatives of the system's matrices; one row for each free parameter, then one for
        the variance of each source. The `d_...` have the same rows.
    shift (nx, nu), see `sample_system`; offset (ny,), drift (nx,), lead (nx,) : from the rest that
        the model was linearised about; zero for rest at zero.
    """

    system: NoisySystem
    tangent: SystemTangent
    shift: Array
    offset: Array
    drift: Array
    lead: Array
    d_shift: Array
    d_offset: Array
    d_drift: Array
    d_lead: Array


class NoisePlaces:
    """Where the noise of a model enters: its outputs, and the places of process noise.

    Parameters
    ----------
    model : inputs that are unknown must be noise.
    noise : one `White` for each output, and for each source of process noise.

    Raises
    ------
    ModelError
        For noise that is missing, stated twice, or enters nowhere.

    Attributes
    ----------
    process, measured : the sources on the process, and those of the outputs in their order.
    driven : the model without its noise inputs: what a record has to hold.
    """

    def __init__(self, model: Model, noise: Sequence[White] | White) -> None:
        self.model, self.noise = model, noise_sources(noise)
        self.outputs = tuple(model.outputs)
        self._sort_noise()
        self.driven = model.copy()
        for source in self.process:
            self.driven.inputs.pop(source.where, None)

    @property
    def sources(self) -> tuple[White, ...]:
        """All noise in the order of the variances: process noise, then that of the outputs."""
        return (*self.process, *self.measured)

    def noise_name(self, w: White) -> str:
        """What its size is called among the variables: a variance, or a power spectral density."""
        return f"{'var' if w.held or w.where in self.outputs else 'psd'}({w.where})"

    def with_inputs(self) -> tuple[Model, list[str]]:
        """The model with an input for every source of process noise, and their names."""
        model, names = self.model.copy(), []
        for source in self.process:
            names.append(source.where)
            if source.where in model.balances:
                names[-1] = f"noise of {source.where}"
                unit = model.balances[source.where].unit
                model.add_term(source.where, model.add_input(Input(names[-1], unit, "unknown")))
        return model, names

    def _sort_noise(self) -> None:
        places = [w.where for w in self.noise]
        twice = {w for w in places if places.count(w) > 1}
        if twice:
            raise ModelError(f"noise of {', '.join(sorted(twice))} stated twice; give it once")
        for name in self.outputs:
            if name not in places:
                raise ModelError(
                    f"{self.model.name}: output {name} has no noise; give White({name!r}, sd=...)"
                )
        unknown = [n for n, i in self.model.inputs.items() if i.kind == "unknown"]
        for name in unknown:
            if name not in places:
                raise ModelError(
                    f"{self.model.name}: input {name} is unknown; give White({name!r}, sd=...) if "
                    "it is white noise, make it a state (as_random_walk), or eliminate it"
                )
        self.measured = [w for name in self.outputs for w in self.noise if w.where == name]
        self.process = [w for w in self.noise if w.where not in self.outputs]
        for source in self.process:
            if source.where not in unknown and source.where not in self.model.balances:
                raise ModelError(
                    f"{self.model.name}: noise of {source.where!r} enters nowhere; name one of its "
                    f"outputs ({', '.join(self.outputs)}), balances "
                    f"({', '.join(self.model.balances) or 'none'}) or unknown inputs "
                    f"({', '.join(unknown) or 'none'})"
                )


class NoisyModel:
    """A model, linear or linearised about its rest, with its noise.

    Parameters
    ----------
    model : inputs that are unknown must be noise.
    noise : one `White` for each output, and for each source of process noise.
    free : names of the parameters to differentiate in.
    rest : state or input -> its value at rest, a number or an SX expression of the model's
        parameters; 0 for what is not given.

    Raises
    ------
    ModelError
        For noise that is missing, or enters nowhere; an input blended of two holds, or
        band-limited; a model that cannot be linearised.
    """

    def __init__(
        self,
        model: Model,
        noise: Sequence[White] | White,
        free: Sequence[str] = (),
        rest: Mapping[str, Any] | None = None,
    ) -> None:
        self.rest = dict(rest or {})
        self.places = NoisePlaces(model, noise)
        self.model, self.free = model, tuple(free)
        self.noise, self.outputs = self.places.noise, self.places.outputs
        self.process, self.measured = self.places.process, self.places.measured
        for entry in model.inputs.values():
            for blend in entry.blends:
                raise ModelError(
                    f"{model.name}: input {entry.name} blends two holds ({blend.parameter}), but "
                    "the sampled system holds it or joins it by straight lines; leave that effect "
                    "out and declare the hold (input(..., hold='zoh') or 'foh'), or use "
                    "casid.identify"
                )
            if entry.hold == "bandlimited":
                raise ModelError(
                    f"{model.name}: input {entry.name} is band-limited, and the sampled system of "
                    "a band-limited input has no finite order; declare hold='foh', or use "
                    "casid.identify"
                )
        driven = self.places.driven
        self.inputs = tuple(driven.inputs)
        self.hold = [driven.inputs[name].hold for name in self.inputs]
        self._matrices = self._linear()

    def _linear(self) -> Any:
        """p (np,) -> the entries of A, B, C, D, of y, x, u at rest, and their derivatives."""
        model, names = self.places.with_inputs()
        at_inputs = {n: v for n, v in self.rest.items() if n in model.inputs}
        at_states = {n: v for n, v in self.rest.items() if n not in model.inputs}
        self.linear = linear = linearise(model, x=at_states, u=at_inputs)
        order = [linear.inputs.index(n) for n in (*self.inputs, *names)]
        rest = [linear.equilibrium[n] for n in (*linear.outputs, *linear.states, *self.inputs)]
        parts = [linear.A, linear.B[:, order], linear.C, linear.D[:, order], ca.vertcat(*rest)]
        flat = ca.densify(ca.vertcat(*[ca.vec(ca.densify(m)) for m in parts]))
        columns = [linear.parameters.index(f) for f in self.free]
        slopes = ca.densify(ca.jacobian(flat, linear.p))[:, columns]
        return ca.Function("linear", [linear.p], [flat, slopes])

    def sampled(
        self, p: Array, variances: Array, Ts: float, wanted: Sequence[bool] | None = None
    ) -> Sampled:
        """The sampled system and its derivatives.

        Parameters
        ----------
        p : (np,) all parameters of the model in its order.
        variances : of `sources`.
        wanted : for each free parameter whether its derivative is (default all; else it is zero).
        """
        flat, slopes = (np.array(v) for v in self._matrices(p))
        m, k = len(self.free), len(self.noise)
        index = [i for i in range(m) if wanted is None or wanted[i]]
        # One stack: the model itself, a complex step in each parameter, a unit of each variance
        # (Q, S and R are linear in the variances).
        rows = np.concatenate(
            [flat, flat + 1j * _STEP * slopes[:, index], np.repeat(flat, k, 1)], 1
        )
        sizes = np.vstack([np.tile(variances, (1 + len(index), 1)), np.eye(k)])
        stack = self._sample(rows.T, sizes, Ts)
        tangents = [np.zeros((m + k, *part.shape[1:])) for part in stack]
        for tangent, part in zip(tangents, stack, strict=True):
            tangent[index] = part[1 : 1 + len(index)].imag / _STEP
        for i in (4, 5, 6):
            tangents[i][m:] = stack[i][1 + len(index) :].real
        A, B, C, D, Q, S, R, *rest = (np.ascontiguousarray(part[0].real) for part in stack)
        states = tuple(self.model.states)
        system = NoisySystem(A, B, C, D, Q, R, S, Ts, states, self.outputs, self.inputs)
        return Sampled(system, SystemTangent(*tangents[:7]), *rest, *tangents[7:])

    def _sample(self, flat: Array, variances: Array, Ts: float) -> tuple[Array, ...]:
        """A, B, C, D, Q, S, R, shift, offset, drift, lead of a stack of models, (rows, ...) each.

        `flat` (rows, entries) may be complex, `variances` (rows, sources).
        """
        nx, ny, nu = len(self.model.states), len(self.outputs), len(self.inputs)
        k = nu + len(self.process)
        cuts = np.cumsum([nx * nx, nx * k, ny * nx, ny * k])
        parts = np.split(flat, cuts, axis=1)
        A, B, C, D = (
            part.reshape((len(flat), columns, rows)).swapaxes(1, 2)
            for part, (rows, columns) in zip(
                parts, ((nx, nx), (nx, k), (ny, nx), (ny, k)), strict=False
            )
        )
        q, r = variances[:, None, : len(self.process)], variances[:, len(self.process) :]
        held = np.array([w.held for w in self.process], dtype=bool)
        flowing = B[:, :, nu:][:, :, ~held]
        instant = np.abs(D[0, :, nu:]) * ~held
        if np.any(instant > 1e-12 * max(float(np.max(np.abs(D[0]))), TINY)):
            self._refuse_instant(instant)
        index = [*range(nu), *(nu + np.flatnonzero(held)).tolist()]
        hold = [*self.hold, *["zoh"] * int(held.sum())]
        Ad, Bd, Cd, Dd, shift = sample_system(A, B[:, :, index], C, D[:, :, index], Ts, hold)
        G, E = Bd[:, :, nu:], Dd[:, :, nu:]
        Q = (G * q[:, :, held]) @ G.swapaxes(1, 2)
        if flowing.shape[2]:
            Q = Q + sample_noise(A, (flowing * q[:, :, ~held]) @ flowing.swapaxes(1, 2), Ts)
        S = (G * q[:, :, held]) @ E.swapaxes(1, 2)
        R = (E * q[:, :, held]) @ E.swapaxes(1, 2) + r[:, :, None] * np.eye(ny)
        Bd, Dd, shift = Bd[:, :, :nu], Dd[:, :, :nu], shift[:, :, :nu]
        y, x, u = np.split(parts[4], [ny, ny + nx], axis=1)
        ahead = u[:, :, None]
        offset, drift = y - (Dd @ ahead)[:, :, 0], -(Bd @ ahead)[:, :, 0]
        return Ad, Bd, Cd, Dd, Q, S, R, shift, offset, drift, (shift @ ahead)[:, :, 0] - x

    def _refuse_instant(self, gain: Array) -> None:
        for j, source in enumerate(self.process):
            reached = [o for o, g in zip(self.outputs, gain[:, j], strict=True) if g > 0]
            if reached:
                raise ModelError(
                    f"{self.model.name}: output {', '.join(reached)} responds to the noise of "
                    f"{source.where} at once, and continuous white noise has no finite variance at "
                    f"an instant; use White({source.where!r}, ..., held=True)"
                )
