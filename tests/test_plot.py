"""Pictures show the report's arrays, name every axis with its unit, and land in files."""

from __future__ import annotations

import dataclasses
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from subprocess import run

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from trips import small_trip

from enumerate import plan
from relax.panels import plot_power, plot_soc, plot_temperature
from relax.plot import plot_case, save_plots
from relax.report import PlanReport
from relax.trip import Trip


@pytest.fixture(scope="module")
def trip() -> Trip:
    return small_trip(start_soc=0.45)


@pytest.fixture(scope="module")
def report(trip: Trip) -> PlanReport:
    found = plan(trip).plan
    assert found is not None and found.stops
    return found


def steps(ax, label: str) -> tuple[np.ndarray, np.ndarray]:
    (patch,) = [p for p in ax.patches if p.get_label() == label]
    values, edges, _ = patch.get_data()
    return edges, values


def test_states_over_distance_are_the_reports(report: PlanReport) -> None:
    for draw, values, factor in (
        (plot_soc, report.drive.soc, 100.0),
        (plot_temperature, report.drive.temperature_c, 1.0),
    ):
        ax = Figure().subplots()
        assert draw(ax, report) is ax
        x, y = ax.get_lines()[0].get_data()
        assert np.all(np.diff(x) >= 0.0)
        assert x.size == report.drive.node_km.size + 2 * len(report.stops)
        positions = [s.position_km for s in report.stops]
        regular = ~np.isin(x, positions)
        kept = ~np.isin(report.drive.node_km, positions)
        np.testing.assert_array_equal(x[regular], report.drive.node_km[kept])
        np.testing.assert_allclose(y[regular], factor * values[kept])
    soc = plot_soc(Figure().subplots(), report).get_lines()[0].get_data()
    for stop in report.stops:
        there = soc[1][soc[0] == stop.position_km]
        assert there[-2:].tolist() == [100.0 * stop.arrive_soc, 100.0 * stop.depart_soc]


def test_powers_are_the_reports(report: PlanReport) -> None:
    ax = plot_power(Figure().subplots(), report)
    edges, battery = steps(ax, "battery")
    np.testing.assert_array_equal(edges, report.drive.node_km)
    np.testing.assert_array_equal(battery, report.drive.battery_kw)
    np.testing.assert_array_equal(steps(ax, "propulsion")[1], report.drive.propulsion_kw)
    low, high = ax.get_ylim()
    assert low < report.drive.battery_kw.min() and high > report.drive.battery_kw.max()
    for trace in report.charge:
        ax = plot_power(Figure().subplots(), trace)
        minutes, grid = steps(ax, "grid")
        np.testing.assert_allclose(minutes, 60.0 * trace.time_h)
        np.testing.assert_array_equal(grid, trace.grid_kw)
        np.testing.assert_array_equal(steps(ax, "battery limits")[1], trace.limit_kw)


def test_case_has_a_labelled_column_per_stop(report: PlanReport, trip: Trip) -> None:
    figure = plot_case(report, trip)
    columns = 1 + len(report.charge)
    assert len(figure.axes) == 5 * columns
    grid = np.array(figure.axes).reshape(5, columns)
    assert all("[" in ax.get_ylabel() for ax in grid[:, 0]), "units on every axis"
    assert grid[-1, 0].get_xlabel() == "distance [km]"
    for ax, trace in zip(grid[0, 1:], report.charge, strict=True):
        assert trace.charger in ax.get_title()
    assert all(ax.get_xlabel() == "charging time [min]" for ax in grid[-1, 1:])
    assert all(ax.get_legend() is not None for ax in grid[2:, 0])
    demand = trip.vehicle.cabin_heating_kw(trip.route.ambient_c)
    np.testing.assert_array_equal(steps(grid[3, 0], "demand")[1], demand)
    heat = steps(grid[3, 0], "heater")[1]
    np.testing.assert_allclose(heat, demand.mean(), rtol=1e-6)  # the cabin stays warm


@pytest.mark.parametrize(
    ("ambient_c", "panels"),
    [(-5.0, {"cabin heat"}), (20.0, set()), (30.0, {"cabin cooling"})],
)
def test_of_the_cabin_only_what_the_weather_asks_for_is_drawn(
    ambient_c: float, panels: set[str]
) -> None:
    hot = small_trip(ambient_c=ambient_c, start_soc=0.45)
    found = plan(hot).plan
    assert found is not None and found.charge
    figure = plot_case(found, hot)
    columns = 1 + len(found.charge)
    grid = np.array(figure.axes).reshape(-1, columns)
    names = {ax.get_ylabel().removesuffix(" [kW]") for ax in grid[:, 0]}
    assert names & {"cabin heat", "cabin cooling"} == panels
    for panel in grid[3:-1]:
        for ax in panel:
            drawn = [p.get_data().values for p in ax.patches if hasattr(p, "get_data")]
            assert max(float(np.max(values)) for values in drawn) > 0.0, "no empty panel"
    if "cabin cooling" in panels:
        power = hot.vehicle.cabin_cooling_kw.at(ambient_c)
        for ax in grid[3]:
            np.testing.assert_allclose(steps(ax, "cabin cooling")[1], power)


def test_legends_and_titles_do_not_overlap(report: PlanReport, trip: Trip) -> None:
    figure = plot_case(report, trip)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    boxes = [ax.get_legend().get_window_extent(renderer) for ax in figure.axes if ax.get_legend()]
    boxes += [ax.title.get_window_extent(renderer) for ax in figure.axes if ax.get_title()]
    boxes += [ax.bbox for ax in figure.axes]
    for i, a in zip(range(len(boxes)), boxes, strict=True):
        assert figure.bbox.x1 >= a.x1 and a.x0 >= 0.0, "nothing is cut off"
        for b in boxes[i + 1 :]:
            assert not a.overlaps(b)


def test_files_are_written(report: PlanReport, trip: Trip, tmp_path: Path) -> None:
    named = dataclasses.replace(trip, name="à la carte/../x $y$ $\\z$")
    paths = save_plots(report, named, tmp_path / "new" / "folder")
    assert [p.suffix for p in paths] == [".png", ".svg"]
    assert all(p.parent == tmp_path / "new" / "folder" for p in paths)
    assert paths[0].read_bytes().startswith(b"\x89PNG")
    assert ET.parse(paths[1]).getroot().tag.endswith("svg")
    again = save_plots(report, named, tmp_path)
    assert again[1].read_bytes() == paths[1].read_bytes(), "same plan, same file"


def test_a_result_without_plan_is_refused(trip: Trip) -> None:
    class Nothing:
        plan = None

    with pytest.raises(ValueError, match="no plan"):
        plot_case(Nothing(), trip)


def test_no_stops_and_many_stops(report: PlanReport, trip: Trip) -> None:
    bare = dataclasses.replace(report, stops=(), charge=())
    assert len(plot_case(bare, trip).axes) == 5
    many = dataclasses.replace(report, charge=report.charge * 9)
    assert len(plot_case(many, trip, max_stops=3).axes) == 20


def test_matplotlib_is_imported_on_first_use_only() -> None:
    code = "import sys, relax.plot; sys.exit('matplotlib' in sys.modules)"
    assert run([sys.executable, "-c", code], check=False).returncode == 0
