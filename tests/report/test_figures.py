"""The figures show the result's numbers, and nothing that the names in a file smuggle in."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.advice.isolability import Isolability
from casid.diagnosis.diagnosis import Ranked
from casid.diagnosis.verdict.remainder import Moved, what_remains
from casid.report.figures.candidate_ranking import ranking_figure
from casid.report.figures.diagnosis import diagnosis_figures, gain_figure
from casid.report.figures.estimates import parameter_figure
from casid.report.figures.isolability import isolability_figure
from casid.report.figures.misfit_shares import remaining_figure
from casid.report.figures.moved_parameters import moved_figure
from casid.report.figures.record_views import drawn
from casid.report.figures.residuals import residual_against_figure, residual_spectrum_figure
from casid.report.figures.simulated import residual_time_figure, simulation_figure
from casid.report.figures.sizes_by_record import by_record_figure
from casid.report.figures.style import figure_text
from casid.report.figures.thinning import POINTS, thinned
from tests.support import samples


def trace(figure, name, row=0):
    axis = "y" if row == 0 else f"y{row + 1}"
    (found,) = [t for t in figure.data if t.name == name and (t.yaxis or "y") == axis]
    return found


def test_thinning_keeps_a_spike_of_one_sample_and_the_ends():
    rng = np.random.default_rng(3)
    y = rng.standard_normal(150_000)
    y[77_777], y[101] = 40.0, -30.0
    i = thinned(y, 4000)
    assert {0, 101, 77_777, 149_999} <= set(i.tolist())
    assert i.size <= 4002
    assert np.all(np.diff(i) > 0)


def test_thinning_changes_nothing_in_a_short_record():
    assert thinned(np.arange(4000.0), 4000).tolist() == list(range(4000))


@pytest.mark.parametrize("n", [4001, 5000, 12_345])
def test_thinning_keeps_gaps_as_gaps_and_ignores_infinities(n):
    y = np.sin(np.arange(n))
    y[1000:2000] = np.nan
    y[3000] = np.inf
    kept = y[thinned(y, 400)]
    assert np.isnan(kept).any()
    assert not np.isinf(kept).any()


def test_of_many_records_the_worst_are_drawn_and_the_page_stays_light():
    """Forty records of ten thousand samples: below 1 MB, plotly.js (0.65 MB) included."""
    d = samples.deficient(N=10_000)
    (view,) = d.records
    rng = np.random.default_rng(1)
    loud = {3, 21, 39}
    views = []
    for i in range(40):
        noise = (0.5 if i in loud else 0.02) * rng.standard_normal(view.measured.shape)
        views.append(replace(view, name=f"run {i}", measured=view.measured + noise))
    shown, note = drawn(views)
    assert {v.name for v in shown} >= {f"run {i}" for i in loud}
    assert len(shown) == 8
    assert "Of 40 records, the 8" in note
    assert drawn(views[:8]) == (tuple(views[:8]), "")
    page = samples.page_of(samples.changed(d, records=tuple(views)))
    assert "Of 40 records, the 8 with the largest errors" in page
    assert len(page.encode("utf-8")) < 1_000_000


def test_simulation_shows_data_as_points_and_both_simulations_as_lines():
    d = samples.deficient(N=1500)
    v = d.records[0]
    figure = simulation_figure(d.records)
    measured, before, after = (trace(figure, n) for n in ("measured", "before", "after"))
    assert (measured.mode, before.mode, after.mode) == ("markers", "lines", "lines")
    assert before.line.dash != after.line.dash  # told apart without colour
    np.testing.assert_array_equal(after.y, v.extended[:, 0])
    np.testing.assert_array_equal(before.x, v.t)
    shown = np.asarray(measured.y, dtype=float)
    np.testing.assert_array_equal(np.isfinite(shown), v.used[:, 0])
    left_out = trace(figure, "measured, left out")
    assert list(left_out.x) == [v.t[1234]]
    assert figure.layout.yaxis.title.text == "gyro [rad/s]"
    assert figure.layout.xaxis.title.text == "time [s]"


def test_times_of_the_day_have_all_their_digits():
    """33,382 s, and not 33.4k."""
    records = samples.deficient(N=1500).records
    late = casid.Record({"y": np.ones(300)}, {"y": "m"}, 0.1, t0=33382.0)
    for figure in (late.plot(), simulation_figure(records), residual_time_figure(records)):
        (named,) = [a for a in figure.select_xaxes() if (a.title.text or "").startswith("time [")]
        assert named.exponentformat == "none"


def test_a_fault_value_that_is_left_out_does_not_flatten_the_readings():
    v = samples.deficient(N=1500).records[0]
    far = v.measured.copy()
    far[~v.used[:, 0], 0] = 85000.0
    shown = [t.y for t in simulation_figure([replace(v, measured=far)]).data]
    assert max(np.nanmax(np.asarray(y, dtype=float)) for y in shown if len(y)) < 100


def test_fitted_and_held_out_parts_are_labelled_and_only_the_held_out_is_shaded():
    v = samples.deficient(N=3000).records[0]
    fitted, held_out = simulation_figure([v]).layout.shapes
    assert (fitted.label.text, held_out.label.text) == ("fitted", "held out")
    assert fitted.fillcolor == "rgba(0,0,0,0)" != held_out.fillcolor
    assert fitted.x1 == held_out.x0 == v.t[2100]
    assert held_out.x1 == v.t[-1]


def test_long_records_are_thinned_for_drawing_and_the_caption_says_so():
    d = samples.deficient()
    figure = simulation_figure(d.records)
    for t in figure.data:
        assert len(t.x) <= POINTS + 2
    assert "from 6000 samples" in figure.layout.meta["caption"]
    assert (
        "Thinned" not in simulation_figure(samples.deficient(N=1500).records).layout.meta["caption"]
    )


def test_each_of_several_records_is_chosen_from_a_menu():
    d = samples.deficient(records=3, N=500)
    figure = simulation_figure(d.records)
    buttons = figure.layout.updatemenus[0].buttons
    assert [b.label for b in buttons] == [
        "record: swing-07",
        "record: swing-08",
        "record: swing-09",
    ]
    shown = np.array([b.args[0]["visible"] for b in buttons])
    assert shown.shape == (3, len(figure.data))
    assert np.all(shown.sum(axis=0) == 1)  # every trace belongs to one record
    assert [t.visible for t in figure.data] == shown[0].tolist()


def test_the_time_of_a_long_record_is_in_hours():
    (view,) = samples.deficient(N=1500).records
    day = replace(view, t=np.linspace(0.0, 43200.0, view.t.size))
    for make in (simulation_figure, residual_time_figure):
        figure = make([day])
        assert figure.layout.xaxis.title.text == "time [h]"
        assert max(trace(figure, "after").x) == pytest.approx(12.0)
        assert make([view]).layout.xaxis.title.text == "time [s]"


def test_a_simulation_that_runs_away_leaves_the_data_readable():
    v = samples.view(N=3000)
    runaway = v.baseline * np.exp(0.01 * np.arange(3000))[:, None]
    runaway[2900:] = np.inf
    figure = simulation_figure([replace(v, baseline=runaway)])
    low, high = figure.layout.yaxis.range
    data = v.measured[v.used]
    assert low < data.min() < data.max() < high < 6 * np.ptp(data)
    assert "axis is cut" in figure.layout.meta["caption"]
    assert np.isfinite([t for t in figure.data[1].y if t is not None and not math.isnan(t)]).all()


def test_the_error_is_measured_minus_simulated():
    v = samples.view(N=1500)
    figure = residual_time_figure([v])
    expected = np.where(v.used[:, 0], v.measured[:, 0] - v.baseline[:, 0], np.nan)
    np.testing.assert_array_equal(np.asarray(trace(figure, "before").y, float), expected)


def test_errors_of_samples_that_stand_alone_are_points():
    """A line between neighbours shows nothing of a channel that is read at every tenth sample."""
    v = samples.view(N=1500)
    rare = np.zeros_like(v.used)
    rare[::10] = v.used[::10]
    (before,) = [
        t for t in residual_time_figure([replace(v, used=rare)]).data if t.name == "before"
    ]
    assert before.mode == "markers"
    expected = (v.measured[:, 0] - v.baseline[:, 0])[rare[:, 0]]
    np.testing.assert_array_equal(np.asarray(before.y, float), expected)
    assert trace(residual_time_figure([v]), "before").mode == "lines"


def test_error_against_rate_shows_the_missing_damping_and_nothing_after_naming_it():
    """Where the model lacks -d_2 |p| p, the error falls with the rate; after, it is noise alone."""
    d = samples.deficient()
    figure = residual_against_figure(d.records)
    titles = [getattr(figure.layout, f"xaxis{i}").title.text for i in ("", 2, 3)]
    assert titles == ["phi [rad]", "p [rad/s]", "accel [m/s\u00b2]"]
    means = {t.name: t for t in figure.data if t.mode == "lines+markers" and t.xaxis == "x2"}
    before, after = means["before"], means["after"]
    assert np.corrcoef(before.x, before.y)[0, 1] < -0.8
    # Noise of standard deviation NOISE; bins hold far more than four samples: mean below NOISE / 2.
    assert np.max(np.abs(after.y)) < samples.NOISE / 2


def test_the_band_of_the_binned_mean_covers_zero_as_often_as_it_says():
    """White error: 95 % of the bins' bands cover its mean, zero; 5 records, 120 bins, 3.3 sigma."""
    covered = []
    for seed in range(5):
        v = samples.view(seed=seed)
        v = replace(v, inputs=(), input_units=(), u=v.u[:, :0], states=("p",), x=v.x[:, 1:])
        v = replace(v, state_units=("rad/s",), used=np.isfinite(v.measured), extended=None)
        noise = samples.NOISE * np.random.default_rng(100 + seed).standard_normal(v.measured.shape)
        figure = residual_against_figure([replace(v, measured=v.baseline + noise)])
        (band,) = [t for t in figure.data if t.fill == "toself"]
        upper, lower = np.split(np.asarray(band.y), 2)
        covered += list((upper >= 0) & (lower[::-1] <= 0))
    assert np.mean(covered) == pytest.approx(0.95, abs=3.3 * math.sqrt(0.95 * 0.05 / len(covered)))


def test_the_spectrum_of_white_noise_lies_on_the_noise_floor():
    """Parseval: one-sided density sigma sqrt(2 Ts) at every frequency; 15 averages, so 1/15 rms."""
    v = samples.view()
    figure = residual_spectrum_figure(
        [replace(v, used=np.isfinite(v.measured) & v.used)], {"gyro": samples.NOISE}
    )
    after, floor = trace(figure, "after"), trace(figure, "noise floor, were it white")
    assert floor.y[0] == pytest.approx(samples.NOISE * math.sqrt(2 * samples.TS))
    assert np.sqrt(np.mean(np.square(after.y))) == pytest.approx(floor.y[0], rel=0.06)
    assert np.max(trace(figure, "before").y) > 20 * floor.y[0]
    assert figure.layout.xaxis.title.text == "frequency [Hz]"


@pytest.mark.parametrize(("causes", "step"), [(8, 1), (24, 3)])
def test_columns_of_a_map_are_numbered_as_far_as_a_telephone_has_room(causes, step):
    keys = tuple(("parameter_jump", f"p{i}") for i in range(causes))
    figure = isolability_figure(Isolability(keys, np.eye(causes), (), ()))
    numbers = list(figure.layout.xaxis.ticktext)
    assert numbers[::step] == [str(i) for i in range(1, causes + 1, step)]
    assert set(numbers) - set(numbers[::step]) <= {""}
    assert [row.split("<b>")[1] for row in figure.layout.yaxis.ticktext] == [
        f"{i}</b>" for i in range(1, causes + 1)
    ]


def test_ranking_shows_evidence_gain_and_status_in_words():
    figure = ranking_figure(samples.deficient())
    labels = figure.layout.yaxis.ticktext
    assert labels[0] == "quadratic damping, torque<br>named"
    assert labels[1] == "dry friction, torque<br>cannot be rejected"
    assert len(labels) == 7  # the invisible one is left to the table
    bars = {t.name: t for t in figure.data if t.type == "bar" and t.xaxis == "x"}
    assert bars["cannot be rejected"].x[0] == pytest.approx(10.0)  # -log10 1e-10
    assert bars["named"].x[0] == 30.0
    assert "cut at 30" in figure.layout.meta["caption"]
    assert figure.layout.shapes[0].x0 == pytest.approx(-math.log10(0.05))
    texts = [t.text for t in figure.data if t.name == "numbers"]
    assert "not refitted" in texts[1][3]


@pytest.mark.parametrize("p", [0.0, 1.0, math.nan])
def test_ranking_draws_every_p_value(p):
    d = replace(
        samples.deficient(N=100), ranking=(Ranked("offset", "torque", p, p, math.nan, "named"),)
    )
    figure = ranking_figure(d)
    assert 0 <= figure.data[0].x[0] <= 30


def test_parameters_are_drawn_relative_to_the_baseline_with_their_intervals():
    d = samples.deficient(N=100)
    figure = parameter_figure({"before": d.baseline, "after": d.extended})
    before, after = figure.data
    assert list(before.x) == [0.0, 0.0, 0.0]
    assert after.x[1] == pytest.approx(100 * (0.081 - 0.33) / 0.33)
    assert after.error_x.array[1] == pytest.approx(100 * 1.96 * 0.004 / 0.33)
    assert figure.layout.yaxis.ticktext[0] == "k<br>10.52 N m/rad"
    caption = figure.layout.meta["caption"]
    assert "Without an interval: z_s" in caption
    assert "Not in the baseline: d_2" in caption


def test_a_hopeless_interval_does_not_flatten_the_others():
    d = samples.deficient(N=100)
    e = d.baseline
    wild = replace(e, parameters=(*e.parameters[:2], replace(e.parameters[2], std_error=1e6)))
    figure = parameter_figure({"estimate": wild})
    assert figure.layout.xaxis.range[1] < 100
    name = e.parameters[2].name
    assert f"Consistent with zero: {name} (see the table)." in figure.layout.meta["caption"]
    clear = replace(e.parameters[2], std_error=None, interval_kind="profile", ends=(1e-9, 1e6))
    one_sided = replace(e, parameters=(*e.parameters[:2], clear))
    figure = parameter_figure({"estimate": one_sided})
    assert "leave the axis" in figure.layout.meta["caption"]


def test_gain_shows_both_parts_and_the_noise_floor_where_it_is_known():
    figure = gain_figure(samples.deficient(N=100))
    before, after, floor = figure.data
    assert (list(before.x), list(before.y)) == (["fitted", "held out"], [31.0, 34.0])
    assert list(after.y) == pytest.approx([10.1, 10.4])
    assert (list(floor.x), list(floor.y)) == (["held out"], [10.0])
    assert figure.layout.yaxis.title.text == "rms error of gyro [mrad/s]"


def test_moved_parameters_are_drawn_from_before_to_after_each_in_its_own_unit():
    d = samples.rich()
    figure = moved_figure(d.moved, d.problem)
    assert [m.name for m in d.moved] == ["d", "k", "s"]
    before, after, line = (trace(figure, n, row=1) for n in ("before", "after", "moved"))
    assert (list(before.x), list(after.x)) == ([10.52], [10.41])
    assert list(line.x) == [10.52, 10.41]
    assert after.error_x.array[0] == pytest.approx(1.96 * 0.02)
    assert figure.layout.yaxis2.ticktext[0] == "k<br>[N m/rad]"
    low, high = figure.layout.xaxis2.range
    assert low < 10.41 - 1.96 * 0.02 < 10.52 + 1.96 * 0.02 < high


def test_a_move_of_the_fifth_digit_is_written_with_it():
    d = samples.rich()
    moved = (Moved("kT", "N", 26.0012, 25.9987, 0.001), Moved("k", "N m", 10.52, 10.41, 0.02))
    text = str(replace(d, gain=replace(d.gain, moved=moved)))
    assert "kT from 26.0012 to 25.9987 N" in text
    assert "k from 10.52 to 10.41 N m" in text


def test_a_hopeless_interval_does_not_hide_a_move():
    figure = moved_figure([Moved("k", "N m", 1.0, 2.0, 0.1, 1e6)], "pendulum")
    low, high = figure.layout.xaxis.range
    assert high - low < 20
    with pytest.raises(ValueError, match="no parameter moved"):
        moved_figure([], "pendulum")


def test_what_remains_is_drawn_with_the_causes_shares_and_sums_to_a_whole():
    r = samples.rich().remaining
    explained, left = remaining_figure(r).data
    assert list(explained.x) == pytest.approx([100 * e.share for e in r.explained])
    assert list(left.x) == pytest.approx([100 * r.unexplained])
    assert sum(explained.x) + sum(left.x) == pytest.approx(100.0)
    assert remaining_figure(r).layout.yaxis.ticktext[-1] == "unexplained"


def test_nothing_explained_leaves_everything():
    r = what_remains([], {"baseline_rmse": {"gyro": 2.0}, "noise_floor": {"gyro": 1.0}})
    (bars,) = remaining_figure(r).data
    assert list(bars.x) == [100.0]


def test_values_by_record_have_a_row_a_record_and_the_common_value():
    cause = samples.rich().causes[1]
    figure = by_record_figure(cause)
    values = trace(figure, "value in this record")
    assert list(values.x) == [found["h"].value for found in cause.by_record.values()]
    assert values.error_x.array[0] == pytest.approx(1.96 * 0.008)
    assert list(trace(figure, "one value for all").x) == [0.064, 0.064]
    assert list(figure.layout.yaxis.ticktext) == list(cause.by_record)
    with pytest.raises(ValueError, match="one value explains all"):
        by_record_figure(samples.rich().causes[0])


@pytest.mark.parametrize(
    "make", [samples.rich, samples.deficient, samples.adequate, samples.undecided, samples.hostile]
)
def test_every_figure_has_a_caption_and_its_legend_above(make):
    d = make()
    for name, figure in diagnosis_figures(d).items():
        assert figure.layout.meta["caption"].strip(), name
        assert figure.layout.autosize
        assert figure.layout.legend.orientation == "h", name
        json.loads(figure.to_json())


def test_an_undecided_diagnosis_without_records_has_only_the_figures_it_can_fill():
    d = samples.changed(samples.undecided(), records=())
    assert list(diagnosis_figures(d)) == ["parameters"]
    with pytest.raises(ValueError, match="no record"):
        simulation_figure(d.records)


@pytest.mark.parametrize("n", [0, 1, 20])
def test_a_record_too_short_for_a_curve_is_no_fault(n):
    v = samples.view(N=100)
    arrays = ("t", "measured", "used", "fitted", "baseline", "extended", "u", "x")
    short = replace(v, **{name: getattr(v, name)[:n] for name in arrays})
    figures = diagnosis_figures(samples.changed(samples.deficient(N=100), records=(short,)))
    assert len(figures) == 7


def test_names_from_files_reach_plotly_as_plain_text():
    """Plotly reads <b>, entities and %{...} in texts: none may survive from a name."""

    def texts(value):
        if isinstance(value, str):
            yield value
        elif isinstance(value, dict):
            for k, v in value.items():
                if k != "meta":  # data for the page, which escapes it, never rendered by Plotly
                    yield from texts(v)
        elif isinstance(value, list):
            for v in value:
                yield from texts(v)

    for figure in diagnosis_figures(samples.hostile()).values():
        for text in texts(json.loads(figure.to_json())):
            rest = re.sub(r"<br>|<b>\d+</b>|<extra>(%{fullData.name})?</extra>", "", text)
            assert "<" not in rest, text
            assert "&amp;%{" not in text
            assert "\u202e" not in text
            text.encode("utf-8")  # no lone surrogate


def test_a_name_cannot_fill_a_template():
    assert figure_text("%{y} <b> & \u202e\x00") == "&#37;{y} &lt;b&gt; &amp; \ufffd\ufffd"
    assert len(figure_text("n" * 1000)) == 40
