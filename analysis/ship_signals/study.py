"""What the ship's signals depend on (section 8.2), from the simulator's own linear model.

    python -m analysis.ship_signals [--quick] [--out DIR]

The five linear states in numbers and symbols; the formulas (8.22)-(8.38), those that are
misprinted shown to fail; the direct term from the torque to the accelerometer and none to the yaw
rate; correlations with the torque, on records of the linear system and of the nonlinear simulator,
beside the solution of a Lyapunov equation; what may serve as an input of which estimator; the zero
in the right half-plane from rudder to roll. The figures are block diagrams after Figures 8.4-8.8,
Bode plots, steps of the rudder and the correlations. --quick: fewer records. Exit 1 where a target
is missed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from analysis.common.runner import Run, Study
from analysis.common.targets import Target, at_most, holds
from analysis.ship_signals import formulas as section_8_2
from analysis.ship_signals.blocks import draw
from analysis.ship_signals.correlation import (
    SIGNALS,
    Drives,
    Found,
    linear_records,
    sampled,
    simulator_records,
)
from analysis.ship_signals.diagrams import diagrams, worst_departure
from analysis.ship_signals.figures import bode, correlations, steps
from analysis.ship_signals.inward_heel import HULLS, Lean, critical_height, lean
from analysis.ship_signals.model import (
    accelerometer,
    drawn_values,
    frequency_response,
    matrices,
    ship_model,
    values_of,
)
from casid.linear.linear_model import linearise
from casid.linear.loops.closed_loop import ClosedLoopView, closed_loop_view
from casid.linear.loops.loop_consistency import verdicts
from problems.ship import TABLE_8_2, indirect_model
from problems.ship_4dof import LOAD_CASES, linearised, tangent

A_2 = {"nominal": "0.037876", "calibration": "0.036756", "loaded": "0.036364"}
COEFFICIENTS = {
    "alpha1": "5.4573", "alpha2": "248.125", "beta1": "13.6530", "kappa1": "-13.2010",
    "gamma1": "-10.6928",
}  # fmt: skip
POLES = (-2.971, -0.697 - 5.241j, -0.697 + 5.241j, -0.334, 0.0)
"""Published, with the signs of Y_|u|v and N_|u|r corrected; two decimals rounded, one cut."""

ROUNDING = 1e-10  # relative; the worst of 300 random systems is 2e-14


def _printed(what: str, found: float, text: str) -> Target:
    """A number that must be a printed one to all its digits."""
    digits = len(text.partition(".")[2])
    return Target(what, f"{found:.{digits}f}", text, f"{found:.{digits}f}" == text)


# -- (a) the five states -------------------------------------------------------------------------


def five_states() -> Iterator[Target]:
    """The matrices, three ways; coefficients, poles, transfer functions."""
    values, linear = values_of(), linearised()
    E, F, B = matrices(values)
    for how, other in (("(8.3)-(8.7)", linear), ("the simulator's Jacobian", tangent())):
        apart = max(
            np.max(np.abs(E - other.E)),
            np.max(np.abs(F - other.F)),
            np.max(np.abs(B - np.column_stack([other.F_delta, other.T[:, 1]]))),
        )
        yield at_most(f"symbolic model against {how}", apart, 1e-11, "SI")
    for case, text in A_2.items():
        found = section_8_2.coefficients(values_of(load=LOAD_CASES[case]))["A_2"]
        yield _printed(f"A_2, {case} [kg m^2]", found, text)
    for name, text in COEFFICIENTS.items():
        yield _printed(f"{name}, nominal", section_8_2.coefficients(values)[name], text)
    poles = np.sort_complex(linear.poles())
    apart = float(np.max(np.abs(poles - np.sort_complex(np.array(POLES)))))
    yield at_most("poles -2.971, -0.334, -0.697 +- 5.241i, 0", apart, 7e-4, "1/s")
    model = linearise(ship_model(values))
    system, transfer = model.to_control(), model.transfer()
    den, num = transfer.evaluate()
    keep = len(den) - 1
    s = 0.3 + 2.1j
    exact = frequency_response(values, s)
    H = np.asarray(system(s))
    by_control = [abs(H[i, j] / exact[f"{y}/{u}"] - 1) for i, j, y, u in _entries(transfer)]
    by_casid = [
        abs(np.polyval(num[i][j], s) / np.polyval(den, s) / exact[f"{y}/{u}"] - 1)
        for i, j, y, u in _entries(transfer)
    ]
    yield at_most("transfer functions of python-control", max(by_control), ROUNDING, "rel.")
    yield at_most("transfer functions of casid", max(by_casid), ROUNDING, "rel.")
    print(f"  order {keep}; denominator {_polynomial(den)}")
    for i, j, y, u in _entries(transfer):
        print(f"  {y} / {u} = ({_polynomial(num[i][j])}) / denominator")


def _entries(transfer: Any) -> Iterator[tuple[int, int, str, str]]:
    for i, y in enumerate(transfer.outputs):
        for j, u in enumerate(transfer.inputs):
            yield i, j, y, u


def _polynomial(c: Any) -> str:
    c = np.where(np.abs(c) < 1e-9 * np.max(np.abs(c)), 0.0, c)
    n = len(c) - 1
    terms = [f"{x:.5g}{('', ' s')[n > k]}{f'^{n - k}' * (n - k > 1)}" for k, x in enumerate(c) if x]
    return " + ".join(terms).replace("+ -", "- ")


# -- (b) the formulas ----------------------------------------------------------------------------


def formulas(draws: int) -> Iterator[Target]:
    """(8.22)-(8.38) against the state space, symbolically and at random systems and frequencies."""
    zero = {
        "sway and yaw rows (8.33)-(8.35)": section_8_2.hull_residue(),
        "roll row (8.22)": section_8_2.roll_residue(),
    }
    for name, residue in zero.items():
        left = [e for e in residue if e != 0]
        yield holds(f"model less {name}, symbolic", left or 0, 0, not left)
    failing = [name for name, r in section_8_2.loop_residue().items() if r != 0]
    yield holds("(8.27)-(8.36), failing symbolic identities", failing, [], not failing)
    rng = np.random.default_rng(82)
    worst: dict[str, float] = {}
    least: dict[str, float] = {}
    for _ in range(draws):
        v, s = drawn_values(rng), 1j * 10 ** rng.uniform(-1.5, 1.5)
        exact, k, h = frequency_response(v, s), section_8_2.roll_at(v, s), section_8_2.hull_at(v, s)
        dr, dv = exact["yaw/delta"], exact["vdot/delta"]
        y, a = exact["gyro/delta"], exact["accel/delta"]
        # (8.22) and the sensor as two equations in y and a_s, the sway acceleration left out
        loop = np.array([[1.0, -k.G], [-k.F_y, 1.0]])
        _, no_sway = np.linalg.solve(loop, [k.G * (k.F_d + k.F_r * dr), -k.U * dr])
        by_formula = section_8_2.responses(k, h, -1 / (v["K_vdot"] + v["S"]))
        right = {
            "(8.30) rudder to roll rate": section_8_2.y_of_delta(k, dr, dv) / y,
            "(8.31), sign corrected": section_8_2.a_s_of_delta(k, dr, dv) / a,
            "(8.86), corrected": section_8_2.a_s_without_sway(k, dr) / no_sway,
        }
        right |= {f"(8.33)-(8.36) {n}": x / exact[n] for n, x in by_formula.items()}
        wrong = {
            "(8.31) as printed": section_8_2.printed_8_31(k, dr, dv) / a,
            "(8.86) as printed": section_8_2.printed_8_86(k, dr) / no_sway,
        }
        for name, ratio in right.items():
            worst[name] = max(worst.get(name, 0.0), abs(ratio - 1))
        for name, ratio in wrong.items():
            least[name] = min(least.get(name, np.inf), abs(ratio - 1))
    for name, apart in worst.items():
        yield at_most(f"{name}, {draws} random systems", apart, ROUNDING, "rel.")
    for name, apart in least.items():
        found = f"off by {100 * apart:.2g} % or more"
        yield holds(f"{name}, {draws} random systems", found, "> 0.01 %", apart > 1e-4)


def direct_terms(view: ClosedLoopView) -> Iterator[Target]:
    """From the torque to the accelerometer at once; to the yaw rate never at once."""
    import sympy

    q, found = section_8_2.symbols(), section_8_2.symbolic_direct_terms()
    ratio = found["a_s"] / found["p'"]
    apart = sympy.cancel(
        ratio - section_8_2.direct_term_a_s(q) / section_8_2.coefficients(q)["beta1"]
    )
    yield holds("(8.36)-(8.38) lim G Fbar_y, symbolic", apart, 0, apart == 0)
    turn = found["r'"] / found["p'"]
    apart = sympy.cancel(turn - section_8_2.yaw_limit(q))
    yield holds("lim r/y, [N_pdot (M_t-Y_vdot) + N_vdot (S+Y_pdot)]/..", apart, 0, apart == 0)
    as_printed = sympy.cancel(turn - section_8_2.printed_yaw_limit(q)) == 0
    yield holds("the same without N_vdot, as printed", as_printed, False, not as_printed)
    v = values_of()
    far = [1j * x for x in (1e4, 1e5)]
    loops = [
        (k.G * (k.F_y - h.vdot_y - k.U * h.r_y), k.G * k.F_r * h.r_y)
        for k, h in ((section_8_2.roll_at(v, s), section_8_2.hull_at(v, s)) for s in far)
    ]
    limit = section_8_2.direct_term_a_s(v)
    apart = abs(loops[1][0] / limit - 1)
    yield at_most("G Fbar_y at 1e5 rad/s against its limit", apart, 1e-3, "rel.")
    fall = abs(loops[1][1] / loops[0][1])
    yield holds("r-loop from 1e4 to 1e5 rad/s", f"{fall:.4f}", "0.1000", abs(fall - 0.1) < 1e-3)
    _, D = accelerometer(v)
    yield holds("a unit torque in a_s at once [m/s^2 per N m]", f"{D[1]:.4f}", "not 0", D[1] != 0.0)
    table = {n: x for n, x in roll_table().items() if n in view.parameters}
    own = float(view.direct_term_at(table)[0, 0])
    c = section_8_2.coefficients(v)
    apart = abs(own - c["beta1"] * v["z_s"])
    yield at_most("casid's direct term of the roll subsystem", apart, 1e-9, "1")
    print(f"  lim G F_y = beta1 z_s = {own:.4f}: the roll subsystem alone, v' and r held")
    print(f"  lim G Fbar_y = {limit:.4f}: sway gives way to the roll at once")
    print(
        f"  lim r/y = {section_8_2.yaw_limit(v):.5f}, "
        f"as printed {section_8_2.printed_yaw_limit(v):.5f}"
    )


def roll_table() -> dict[str, float]:
    """Table 8.2 without load, for the parameters of the indirect roll model."""
    names = indirect_model().parameters
    return {n: TABLE_8_2[n] for n in names} | {"m": 0.0}


# -- (c) correlations ----------------------------------------------------------------------------


def correlated(records: int, motions: int) -> Iterator[tuple[str, Found]]:
    """Records of the linear system, then of the simulator."""
    system = sampled()
    yield "linear", linear_records(system, records=records, N=3000, seed=8)
    found = simulator_records(system, records=motions, seconds=120.0, settle=20.0, seed=9)
    yield "simulator", found


def correlation_targets(found: Sequence[tuple[str, Found]]) -> Iterator[Target]:
    """Every number within 4.5 standard errors of the Lyapunov equation's, and none zero."""
    for label, f in found:
        for name, theory, mean, error, z in zip(
            f.names, f.theory, f.mean, f.error, f.z, strict=True
        ):
            wanted = f"{theory:.4f} (z = {z:+.1f})"
            text = f"{mean:.4f} +- {error:.4f}"
            yield holds(f"{label}: {name}", text, wanted, bool(abs(z) < 4.5))
    f = found[0][1]
    for i, signal in enumerate(SIGNALS):
        far = max(abs(f.mean[k] / f.error[k]) for k in (i, 3 + i))
        yield holds(
            f"{signal} is correlated with tau", f"{far:.0f} standard errors", "> 5", bool(far > 5)
        )
    coarse, fine = sampled(0.02).at_once(), sampled(0.002).at_once()
    for i, (signal, fall) in enumerate(zip(SIGNALS, (0.1, 1.0, 0.1), strict=True)):
        ratio = float(fine[i] / coarse[i])
        yield holds(
            f"gain at once of {signal}, Ts 0.02 to 0.002 s",
            f"{ratio:.3f}",
            f"{fall:g} +- 0.02",
            abs(ratio - fall) < 0.02,
        )
    print(
        "  the gain at once is what a signal holds of the torque that is new in the same sample: "
        "it vanishes with Ts but for the accelerometer"
    )


def on_large_motions() -> None:
    """What sensors' noise and drag in sway make of it; printed, without a target."""
    system = sampled(drives=Drives(delta=0.1, tau=0.1))
    f = simulator_records(system, records=10, seconds=120.0, settle=20.0, seed=10, noisy=True)
    print("  rudder of 0.1 rad and torque of 0.1 N m rms, noisy sensors, beside the linear theory:")
    for name, theory, mean, error in zip(f.names, f.theory, f.mean, f.error, strict=True):
        print(f"    {name:<32}{mean:8.3f} +- {error:.3f}   {theory:8.3f}")


# -- (d) which signal may be an input of what -----------------------------------------------------


def inputs(view: ClosedLoopView) -> Iterator[Target]:
    """casid's verdicts on the accelerometer's loop and on the yaw rate's, in words."""
    text = str(view.external[0])
    yield holds("outside of the loop, a_s = F_y y + ..", text, "-U*r - vdot", text == "-U*r - vdot")
    left = [e for e in view.difference() if e != 0]
    yield holds("the loop is the direct model again (prop. 7.1)", not left, True, not left)
    wanted = {
        ("a_s", True, False): (False, False, False, True),
        ("a_s", True, True): (False, False, False, True),
        ("a_s", False, True): (False, False, False, True),
        ("a_s", False, False): (True, True, True, True),
        ("r", True, False): (False, True, False, True),
        ("r", True, True): (False, False, False, True),
        ("r", False, True): (False, False, False, True),
        ("r", False, False): (True, True, True, True),
    }
    for (signal, disturbed, noisy), row in wanted.items():
        acting = {"input_noise": noisy, "disturbed": disturbed}
        found = (
            view.estimators(**acting)
            if signal == "a_s"
            else verdicts(("gyro",), ("r",), direct_term=False, **acting)
        )
        good = tuple(v.is_consistent for v in found)
        acts = " and ".join([*(["torque"] * disturbed), *(["noise"] * noisy)]) or "nothing"
        what = f"{signal} as an input, {acts} acting: LS PE OE IV"
        yield holds(what, _marks(good), _marks(row), good == row)
        if disturbed and noisy:
            for v in found:
                for i, line in enumerate(wrap(v.why, 84)):
                    print(f"    {v.estimator if i == 0 else '':<46}{line}")
    for line in (
        "a_s: fed back with a direct term. Only instruments made of the rudder are consistent, and "
        "a loop is simulated closed, never by F_y.",
        "r: fed back by sway and yaw, without a direct term. A prediction error with the true "
        "noise model would do if r were measured without noise and a_s were no input beside it; "
        "(8.20) has both, so instruments again. In the roll subsystem alone r counts as external: "
        "that loop is seen in the whole ship only.",
        "v': would be as a_s, direct term and all; nobody measures it.",
        "delta: in open loop it depends on no signal and no torque: input of every estimator, "
        "source of every instrument. Moved by an autopilot it is r's and psi's function, and "
        "no reference (analysis.kvlcc2_zigzag).",
        "y_O: the output. Its past values are regressors of least squares, which the coloured "
        "error reaches; simulated from delta they are instruments.",
    ):
        print("\n".join(wrap(line, 96, initial_indent="  ", subsequent_indent="    ")))


def _marks(row: Sequence[bool]) -> str:
    return " ".join("yes" if a else "no" for a in row)


# -- (e) the lean --------------------------------------------------------------------------------


def leaning() -> tuple[dict[str, Lean], list[Target]]:
    """Zeros and first heel with the rudder low, at the origin, and at either side of z_r*."""
    import sympy

    targets: list[Target] = []
    formula = critical_height()
    print(f"  the lean begins at z_r* = {formula}")
    kept: dict[str, Lean] = {}
    for hull, K_vdot in HULLS.items():
        v = values_of() | {"K_vdot": K_vdot, "Y_pdot": K_vdot}
        star = float(formula.subs({sympy.Symbol(n): x for n, x in v.items()}))
        print(f"  {hull}, K_vdot = {K_vdot:g} kg m: z_r* = {1e3 * star:.1f} mm")
        for z_r, is_right in ((None, True), (star + 0.002, True), (star - 0.002, False)):
            found = lean(z_r, hull=hull)
            what = f"{hull}, z_r = {1e3 * found.z_r:.1f} mm: zero to the right"
            zero = ", ".join(f"{a:.4g}" for a in found.right) or "none"
            met = (len(found.right) == 1) == is_right and (found.onset < 0) == is_right
            targets.append(holds(what, zero, "one" if is_right else "none", met))
            if z_r is None:
                low = found
                heel = f"{np.degrees(low.inward):.4f} in, {np.degrees(low.outward):.3f} out"
                met = 0.0 < low.inward < low.outward and low.turn < 0
                targets.append(
                    holds(f"{hull}, the simulator's heel [deg]", heel, "in, then out", met)
                )
        level = lean(0.0, hull=hull)
        share = level.inward / low.inward
        what = f"{hull}, z_r = 0: lean by that of the low rudder"
        if star > 0.0:
            met = not level.right and level.inward == 0.0
            targets.append(holds(what, f"{share:.2g}, no zero", "0, no zero", met))
        else:
            met = share < 1e-3 and level.right[0] > 100.0
            found_text = f"{share:.2g}, zero at {level.right[0]:.0f}"
            targets.append(holds(what, found_text, "< 1e-3, zero > 100", met))
        if hull == "chapter 9":
            kept |= {"z_r = 112.5 mm": low}
        kept[f"z_r = 0, K_vdot of {hull}"] = level
    print(
        "  with K_vdot of Table 8.2 S + K_vdot < 0: at z_r = 0 the rudder's side force still rolls "
        "the ship inwards by way of the sway, for some milliseconds"
    )
    return kept, targets


# -- all of it -----------------------------------------------------------------------------------


def drawn() -> Iterator[Target]:
    """The block diagrams say what the formulas say."""
    v, s = values_of(), 0.2 + 1.7j
    k, h = section_8_2.roll_at(v, s), section_8_2.hull_at(v, s)
    for name, apart in worst_departure(k, h, torque=-1 / (v["K_vdot"] + v["S"])).items():
        yield at_most(f"{name}, solved", apart, 1e-12, "rel.")


def study(run: Run) -> Iterator[Target | str]:
    """All targets, a section at a time."""
    view = closed_loop_view(indirect_model())
    yield "Five linear states"
    yield from five_states()
    yield "Formulas of section 8.2"
    yield from formulas(50 if run.quick else 300)
    yield "Direct terms"
    yield from direct_terms(view)
    records = list(correlated(*((150, 12) if run.quick else (800, 60))))
    yield "Correlation with the torque"
    yield from correlation_targets(records)
    on_large_motions()
    yield "Inputs of estimators"
    yield from inputs(view)
    leans, targets = leaning()
    yield "The inward lean"
    yield from targets
    yield "Block diagrams"
    yield from drawn()
    if run.folder is not None:
        figures = {name: draw(d) for name, d in diagrams().items()}
        figures |= {"bode": bode(), "rudder_steps": steps(leans)}
        figures["correlations"] = correlations(sampled(), records)
        for name, figure in figures.items():
            run.output.figure(name, figure)


STUDY = Study(
    study,
    quick="fewer records",
    out="folder for the figures and ship_signals.json",
    file="ship_signals.json",
)
