"""Numbers that decide how effects are searched: grids, ranges, smoothing, and what each costs.

One frozen group a question; each entry has its value, what it means, where it comes from and the
test that pins it. Numbers that keep a division regular stand where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass

from casid.threshold_table import threshold as _is

_TESTS = "tests/model/effects"
_CATALOGUE = f"{_TESTS}/test_effect.py"
_BALANCES = f"{_TESTS}/balances/test_balance_effects.py"
_CHANNELS = f"{_TESTS}/channels/test_channel_effects.py"
_ACTUATORS = f"{_TESTS}/channels/test_actuator_effects.py"
_RATES = f"{_TESTS}/channels/test_rate_limit.py"
_CONTACT = f"{_TESTS}/balances/test_contact_effects.py"
_FRICTION = f"{_TESTS}/balances/test_friction_effects.py"
_PLANES = f"{_TESTS}/places/test_planes.py"
_SCHEDULED = f"{_TESTS}/test_scheduled_parameter.py"
_LAGS = f"{_TESTS}/channels/test_actuator_lag.py"
_PARTS = f"{_TESTS}/balances/test_missing_parts.py"
_BENDS = f"{_TESTS}/channels/test_laws_of_outputs.py"
_FLOW_LAWS = f"{_TESTS}/balances/test_flow_laws.py"
_UNNAMED = f"{_TESTS}/balances/test_unnamed_effects.py"


@dataclass(frozen=True, slots=True)
class ParameterJumps:
    """The search for a parameter that jumps."""

    times: int = _is(
        12, "instants, evenly inside the window, that a jump is first searched at", _CATALOGUE
    )
    times_of_biases: int = _is(
        5,
        "instants for a bias that sets in, which looks alike from one to the next",
        f"{_TESTS}/test_clock_effects.py",
    )
    cost: int = _is(
        3, "parameters that a jump at a searched instant costs", _CATALOGUE, "Zhang, Siegmund 2007"
    )
    cost_of_two: int = _is(
        5,
        "parameters that a change costs which is over again: a size and two searched instants",
        f"{_TESTS}/test_clock_effects.py",
        "Zhang, Siegmund 2007",
    )


@dataclass(frozen=True, slots=True)
class Saturations:
    """The search for a parameter that falls with the square of a state, as iron saturates."""

    poles: float = _is(
        4.0,
        "one over the slope, in units of the parameter over the largest square, beyond half of "
        "which a parameter that grows is not searched: it is infinite at one",
        _SCHEDULED,
    )
    falls: float = _is(
        20.0, "times the slope at which a straight line is zero on average", _SCHEDULED
    )
    left: float = _is(
        0.05,
        "of a parameter that is no less than zero, what a straight fall leaves at least: at zero "
        "an inertia is singular and beyond it turns round, where a simulation says nothing",
        _SCHEDULED,
    )
    powers: int = _is(2, "highest power of a state that a parameter falls with", _SCHEDULED)


@dataclass(frozen=True, slots=True)
class MissingModes:
    """The search for a part that swings along."""

    frequencies: int = _is(7, "frequencies, evenly in their logarithm, to begin from", _PARTS)
    slowest: float = _is(4.0, "cycles in the window, of the lowest of them", _PARTS)
    fastest: float = _is(3.0, "Nyquist's frequency over the highest of them", _PARTS)
    widest: float = _is(100.0, "of the lowest, the highest without a sample time", _PARTS)
    lower: float = _is(0.3, "of its start, the lowest frequency of an estimate", _PARTS)
    upper: float = _is(3.0, "of its start, the highest frequency of an estimate", _PARTS)
    damping: float = _is(0.05, "damping ratio that the search starts from", _PARTS)
    least_damping: float = _is(0.001, "lower bound of the damping ratio", _PARTS)
    cost: int = _is(3, "parameters that a searched frequency costs", _PARTS)
    cost_in_motion: int = _is(5, "the same where it moves when the record begins", _PARTS)


@dataclass(frozen=True, slots=True)
class MissingStores:
    """The search for a store that follows another with a time constant."""

    time_constants: int = _is(5, "time constants, evenly in their logarithm, to begin from", _PARTS)
    shortest: float = _is(4.0, "samples, the shortest of them", _PARTS)
    longest: float = _is(
        0.25, "of the window, the longest: what follows more slowly is a drift", _PARTS
    )
    widest: float = _is(100.0, "the longest over the shortest without a sample time", _PARTS)
    lower: float = _is(0.2, "of its start, the shortest time constant of an estimate", _PARTS)
    upper: float = _is(5.0, "of its start, the longest time constant of an estimate", _PARTS)
    cost: int = _is(
        4,
        "parameters that it costs: a capacity, a level at the beginning, a searched time constant",
        _PARTS,
    )


@dataclass(frozen=True, slots=True)
class PeriodicForces:
    """The search for a line in the residual's spectrum."""

    cost: int = _is(
        5,
        "parameters that a sinusoid costs, the frequency three of them",
        "tests/diagnosis/evidence/residual/test_spectral_peaks.py",
        "Djuric 1996",
    )
    lowest: float = _is(
        0.1,
        "of its start, the lowest frequency of an estimate",
        "tests/diagnosis/evidence/residual/test_spectral_peaks.py",
    )


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Where corners are rounded, to keep the simulation differentiable."""

    speed: float = _is(0.03, "of the rms rate, below which dry friction is rounded", _BALANCES)
    width: float = _is(0.01, "of the rms position, to which the corners of play extend", _BALANCES)
    stop: float = _is(
        1e-3,
        "of half the range, to which the corner of a stop extends: at ten times that the force "
        "before the stop moves the position found by several standard errors",
        "tests/diagnosis/search/test_stops.py",
    )
    power: float = _is(1e-3, "of the typical level, below which a power law is rounded", _FLOW_LAWS)
    motion: float = _is(4.0, "rms values that the largest motion is taken as", _CATALOGUE)
    above_zero: float = _is(
        1e-3, "of its largest value, by which a state that keeps its sign exceeds zero", _UNNAMED
    )
    at_rest: float = _is(
        1e-9,
        "SI unit, the size of a vector below which its direction fades: simulations start there",
        _PLANES,
    )


@dataclass(frozen=True, slots=True)
class FrictionRanges:
    """The speeds over which friction falls as the motion begins."""

    starts: tuple[float, ...] = _is(
        (0.1, 0.35), "of the rms rate, the decay speeds that the search starts from", _FRICTION
    )
    decay: tuple[float, float] = _is(
        (0.03, 1.0), "of the rms rate, lower and upper bound of the decay speed", _FRICTION
    )
    directions: int = _is(
        3, "components of a vector in space: more balances of one kind are a chain", _PLANES
    )


@dataclass(frozen=True, slots=True)
class Hysteresis:
    """The search for a force with a memory of the motion before."""

    starts: tuple[float, ...] = _is(
        (0.05, 0.2, 0.7), "of half the range, the travels that the search starts from", _FRICTION
    )
    travel: tuple[float, float] = _is(
        (0.01, 2.0),
        "of half the range, bounds of the travel: below them it is dry friction, above a spring",
        _FRICTION,
    )
    samples: float = _is(
        1.0,
        "samples that the fastest motion takes over the travel, at least: a shorter one is dry "
        "friction, and the simulation's steps would be too long for it",
        _FRICTION,
    )
    start: float = _is(0.75, "shape of the loop that the search starts from", _FRICTION)
    shape: tuple[float, float] = _is(
        (0.5, 1.5),
        "bounds of the shape: from 0.5 on, a loop takes energy and gives none",
        _FRICTION,
        "Ismail, Ikhouane, Rodellar 2009",
    )
    exponent: tuple[float, float] = _is(
        (1.0, 6.0), "bounds of the exponent, a soft loop to one with corners", _FRICTION
    )
    rounding: float = _is(1e-8, "square of the memory below which its power is rounded", _FRICTION)
    cost: int = _is(
        6,
        "parameters that it costs: a force, a memory at the beginning, four of the loop",
        _FRICTION,
    )


@dataclass(frozen=True, slots=True)
class ContactRanges:
    """Where a stop is searched."""

    starts: tuple[float, ...] = _is(
        (0.5, 0.7, 0.85),
        "of half the range from its middle, the positions that the search starts from; a fit from "
        "the first of them reaches stops that are nearer to the middle",
        _CONTACT,
    )
    of_stores: tuple[float, ...] = _is(
        (-0.5, 0.0),
        "further ones for a store: where short peaks make up most of its range, it may run over "
        "for most of the time, at or below the middle of that range",
        _CONTACT,
    )
    one: float = _is(
        -0.8,
        "of half the range, the position of a stop on one side that is nearest to the other end: "
        "a soft stop may be passed over most of the motion, but at that end it is a spring",
        _CONTACT,
    )
    two: float = _is(
        0.3,
        "of half the range, the distance from its middle of a stop on either side: nearer to it "
        "two soft stops are a spring that hardens, and were named for cubic stiffness",
        _CONTACT,
    )


@dataclass(frozen=True, slots=True)
class Actuators:
    """Limits and play of commands."""

    starts: tuple[float, ...] = _is(
        (0.5, 0.8), "of the largest command, the limits that the search starts from", _ACTUATORS
    )
    limit: tuple[float, float] = _is(
        (0.4, 1.6), "of its start, lower and upper bound of a limit", _ACTUATORS
    )
    gap: float = _is(0.4, "of the command's range, the widest play", _ACTUATORS)
    noise: float = _is(
        5.0,
        "standard deviations of a command's own noise, the narrowest play: a narrower one takes "
        "noise out of a command that was measured",
        _ACTUATORS,
    )
    zero: float = _is(
        0.02,
        "of the largest command, within which it comes to zero where it has a dead zone: that of a "
        "command that does not is a bias",
        _ACTUATORS,
    )
    tick: float = _is(0.005, "of the widest play, what is none beside it", _ACTUATORS)
    begins: tuple[float, ...] = _is(
        (-1.0, -0.5, 0.5, 1.0),
        "of the play, where else than in its middle what acts may stand as a record begins: at a "
        "contact, or halfway to one",
        _ACTUATORS,
    )
    rates: int = _is(6, "largest rates of an actuator that the search starts from, at most", _RATES)
    halvings: int = _is(
        16, "times that the largest rate of a command is halved, in search of those", _RATES
    )
    rate: tuple[float, float] = _is(
        (0.2, 5.0),
        "of its start, lower and upper bound of a rate: two steps of the grid of starts where that "
        "is widest",
        _RATES,
    )
    felt: tuple[float, float] = _is(
        (0.02, 0.9),
        "of a command's standard deviation, the rms of what an actuator at its largest rate leaves "
        "of it, at least and at most: less is nothing that a simulation shows, and with more the "
        "actuator hardly moves",
        _RATES,
    )


@dataclass(frozen=True, slots=True)
class Ranges:
    """Bounds of what an effect's first parameter may be."""

    actuator_lag: float = _is(0.2, "of the window, the longest lag of an actuator", _LAGS)
    dead_time: float = _is(
        0.1,
        "of the window, the longest dead time of an input: as much of every output is left out, as "
        "it is due to what was before the record",
        f"{_TESTS}/channels/test_dead_time.py",
    )
    sensor_lag: float = _is(2.0, "longest delays, the longest lag of a sensor", _CHANNELS)
    lowest_scale: float = _is(
        -0.9995,
        "lower bound of a sensor's scale error: metres that were read as millimetres",
        _CHANNELS,
    )
    highest_scale: float = _is(
        1999.0,
        "upper bound of a sensor's scale error: millimetres that were read as metres",
        _CHANNELS,
    )
    limits: tuple[float, ...] = _is(
        (0.96, 0.98, 0.995), "of the largest reading, where a clipping is searched", _CHANNELS
    )
    lowest_limit: float = _is(0.8, "of its start, the lowest limit of a clipping", _CHANNELS)
    highest_limit: float = _is(1.2, "of its start, the highest limit of a clipping", _CHANNELS)


@dataclass(frozen=True, slots=True)
class RectifiedSensors:
    """Sensors that show absolute values."""

    below_zero: float = _is(
        0.1,
        "of its largest reading, how far the noise of a channel of sizes may reach below zero, how "
        "near its least reading is to zero, and the least that a simulation of either sign has on "
        "both sides",
        "tests/diagnosis/evidence/recording_faults/test_rectified_channels.py",
    )


@dataclass(frozen=True, slots=True)
class UnnamedEffects:
    """Effects without an established name."""

    priority: int = _is(
        3, "of two effects that do the same, the lower is reported: the named one", _UNNAMED
    )
    rests: tuple[float, ...] = _is(
        (-3.0, -0.5, 0.5, 3.0),
        "times half the range of a state, from its mean to where a loss in proportion to it may "
        "vanish: between two of these the angle of the signatures is at most 22 degrees",
        _UNNAMED,
    )
    lowest_power: float = _is(0.1, "lower bound of the exponent of a power law", _FLOW_LAWS)
    highest_power: float = _is(4.0, "upper bound of the exponent of a power law", _FLOW_LAWS)
    most_saturated: float = _is(
        100.0,
        "typical amounts over the one at which a saturating uptake is half its most, at most: "
        "beyond it the uptake is a constant",
        _FLOW_LAWS,
    )
    faster: float = _is(
        2.5,
        "times as large at twice the speed, at least, where drag is more than a friction in "
        "proportion: with its square it is 4, and what a dry friction is smoothed by is 1",
        f"{_TESTS}/balances/test_moving_media.py",
    )
    used_up: float = _is(
        0.003,
        "of the largest amount, below which what uses it up ends: few sensors resolve less, and a "
        "tenth of that would be stiff",
        _UNNAMED,
    )


@dataclass(frozen=True, slots=True)
class Bends:
    """The search for a bend in what an output shows of a state."""

    starts: tuple[float, ...] = _is(
        (0.1, 0.4),
        "of the range of the state, from which the width of the bend is searched",
        _BENDS,
    )
    widths: tuple[float, float] = _is(
        (0.01, 4.0),
        "of that range, the bounds of the width: a narrower one is a corner within a few samples, "
        "a wider one a parabola to 1 % of its size",
        _BENDS,
    )
    grows: float = _is(
        20.0, "widths beyond the range, from which the exponential goes on straight", _BENDS
    )


PARAMETER_JUMPS = ParameterJumps()
BENDS = Bends()
SATURATIONS = Saturations()
MISSING_MODES = MissingModes()
MISSING_STORES = MissingStores()
PERIODIC_FORCES = PeriodicForces()
SMOOTHING = Smoothing()
FRICTION_RANGES = FrictionRanges()
HYSTERESIS = Hysteresis()
CONTACT_RANGES = ContactRanges()
ACTUATORS = Actuators()
RANGES = Ranges()
RECTIFIED = RectifiedSensors()
UNNAMED_EFFECTS = UnnamedEffects()
