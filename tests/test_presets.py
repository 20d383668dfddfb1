"""The shipped presets: valid, with provenance, physically plausible, reproducible from sources."""

from __future__ import annotations

import doctest
import importlib
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.data import cars, figures, long_route, paper, routes, trips, vehicles
from benchmarks.data.emit import DATA, SOURCES, Field, deliver, render
from relax.load import load_trip, load_vehicle
from relax.propulsion import propulsion_kw, wheel_force_n
from relax.schema import TripFile, VehicleFile
from relax.vehicle import Vehicle

VEHICLES = sorted(path.stem for path in (DATA / "vehicles").glob("*.toml"))
TRIPS = sorted(path.stem for path in (DATA / "trips").glob("*.toml"))
ROUTES = sorted(path.stem for path in (DATA / "routes").glob("*.csv"))
STATED_KWH = {
    "paper-2022": 78.0,
    "polestar-2-dual": 78.0,
    "tesla-model-3-rwd": 54.0,
    "audi-e-tron-55": 86.5,
}
KINDS = re.compile(r"published|calibrated|measured|computed|assumed|FASTSim|usable", re.IGNORECASE)


def read(kind: str, name: str) -> str:
    return (DATA / kind / f"{name}.{'csv' if kind == 'routes' else 'toml'}").read_text("utf-8")


def source_rows(name: str) -> list[dict[str, str]]:
    lines = [x for x in (SOURCES / name).read_text("utf-8").splitlines() if x[0] != "#"]
    keys = lines[0].split(",")
    return [dict(zip(keys, line.split(","), strict=True)) for line in lines[1:]]


@pytest.fixture(params=VEHICLES)
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    return load_vehicle(request.param)


def flat_kwh_per_100km(car: Vehicle, speed_kmh: float) -> float:
    speed = np.array([speed_kmh])
    force = wheel_force_n(car.road_load, np.array([0.0, 100.0]), speed, np.zeros(1))
    power = float(propulsion_kw(car.road_load, force, speed)[0])
    return (power + car.auxiliary_kw) / speed_kmh * 100.0


class TestFiles:
    def test_the_presets_that_are_named_exist(self) -> None:
        assert set(VEHICLES) == set(STATED_KWH)
        assert set(ROUTES) == {"longhaul-400km", "goteborg-stockholm", "long-1000km"}
        assert set(TRIPS) == {
            "paper-400km",
            "goteborg-stockholm-winter",
            "goteborg-stockholm-summer",
            "long-1000km-winter",
        }

    @pytest.mark.parametrize("name", VEHICLES)
    def test_vehicle_obeys_the_schema_and_its_file_name(self, name: str) -> None:
        document = json.dumps(tomllib.loads(read("vehicles", name)))
        assert VehicleFile.model_validate_json(document).name == name

    @pytest.mark.parametrize("name", TRIPS)
    def test_trip_obeys_the_schema_and_its_file_name(self, name: str) -> None:
        document = json.dumps(tomllib.loads(read("trips", name)))
        assert TripFile.model_validate_json(document).name == name

    @pytest.mark.parametrize("name", VEHICLES)
    def test_every_figure_of_a_vehicle_says_where_it_comes_from(self, name: str) -> None:
        text = read("vehicles", name)
        assert len(tomllib.loads(text)["source"]) > 40
        for block in text.split("\n\n"):
            if re.search(r"^\w+ = ", block, re.MULTILINE) and not block.startswith("name ="):
                comment = " ".join(line for line in block.splitlines() if line.startswith("#"))
                assert KINDS.search(comment), block[:200]

    @pytest.mark.parametrize("name", ROUTES)
    def test_every_route_names_its_source(self, name: str) -> None:
        head = [line for line in read("routes", name).splitlines() if line.startswith("#")]
        assert re.search(r"Apache|BSD", " ".join(head))

    @pytest.mark.parametrize("name", TRIPS)
    def test_every_trip_says_what_is_assumed(self, name: str) -> None:
        head = read("trips", name).split("\n\n")[0]
        assert "Assumed:" in head and re.search(r"Published:|Facts:", head)

    def test_every_source_names_origin_and_terms(self) -> None:
        files = sorted(SOURCES.glob("*.csv"))
        assert files
        for file in files:
            head = " ".join(x for x in file.read_text("utf-8").splitlines() if x[0] == "#")
            assert re.search(r"BSD|MIT|Apache|public domain|CC BY", head), file.name


class TestReproduction:
    def test_vehicles_are_reproduced_bit_for_bit(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert vehicles.main(["--check"]) == 0
        assert set(vehicles.texts()) == set(VEHICLES)
        assert "DIFFERS" not in capsys.readouterr().out

    def test_routes_from_sources_are_reproduced_bit_for_bit(self) -> None:
        assert routes.main(["--check", "--offline"]) == 0

    def test_the_generated_trip_is_reproduced_bit_for_bit(
        self, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert trips.main(["--check"]) == 0
        assert capsys.readouterr().out.split() == ["same", "trips/long-1000km-winter.toml"]

    def test_another_seed_makes_another_road_and_other_sites(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        road, made = long_route.long_route_text(), trips.sites()
        monkeypatch.setattr(long_route, "SEED", 1001)
        monkeypatch.setattr(trips, "SEED", 21)
        assert long_route.long_route_text() != road
        assert trips.sites() != made

    def test_a_changed_file_is_noticed(self, tmp_path: Path) -> None:
        text = render("A car.", [Field("aux", 0.5, "assumed")])
        file = tmp_path / "car.toml"
        assert not deliver(file, text, check=True)
        assert deliver(file, text, check=False)
        assert deliver(file, text, check=True)
        file.write_text(text.replace("0.5", "0.51"), encoding="utf-8")
        assert not deliver(file, text, check=True)

    def test_rendered_text_is_read_back(self) -> None:
        pairs = [(float(k), k / 3) for k in range(40)]
        fields = [
            Field("name", 'a "b"', "why"),
            Field("points", list(pairs)),
            Field("limit", {"soc": [0.0, 1.0], "power_kw": [[1.0, 2.0], [3.0, 4.0]]}, "why"),
        ]
        back = tomllib.loads(render("head", fields))
        assert back["name"] == 'a "b"'
        assert np.allclose(back["points"], pairs, rtol=1e-6)
        assert back["limit"] == {"soc": [0.0, 1.0], "power_kw": [[1.0, 2.0], [3.0, 4.0]]}

    @pytest.mark.parametrize(
        "module",
        [
            "cars",
            "corridor",
            "emit",
            "figures",
            "long_route",
            "paper",
            "routes",
            "trips",
            "vehicles",
        ],
    )
    def test_examples_of_the_scripts_run(self, module: str) -> None:
        outcome = doctest.testmod(importlib.import_module(f"benchmarks.data.{module}"))
        assert outcome.attempted > 0 and outcome.failed == 0


class TestPlausible:
    def test_pack_holds_the_stated_energy(self, vehicle: Vehicle) -> None:
        assert float(vehicle.pack.energy_kwh(1.0)) == pytest.approx(
            STATED_KWH[vehicle.name], rel=0.03
        )

    def test_voltage_rises_with_charge(self, vehicle: Vehicle) -> None:
        assert np.all(np.diff(vehicle.pack.ocv_v.f) > 0)

    def test_resistance_falls_with_temperature(self, vehicle: Vehicle) -> None:
        table = vehicle.pack.resistance_ohm
        assert np.all(np.diff(table.f) < 0)
        assert 0.015 < table.at(25.0) < 0.12
        assert 2.0 < table.at(-10.0) / table.at(25.0) < 7.0

    def test_loss_at_the_discharge_limit_is_possible(self, vehicle: Vehicle) -> None:
        """R*P^2/U^2 <= P/2: beyond it the terminal power falls with the internal power."""
        limit = vehicle.pack.discharge_limit_soc_kw
        soc, t = np.meshgrid(limit.x, limit.y, indexing="ij")
        r = vehicle.pack.resistance_ohm(np.clip(t, -30.0, 50.0))
        volt = vehicle.pack.ocv_v(soc)
        assert np.all(1000.0 * limit.f * r / volt**2 <= 0.5)

    def test_heat_pump_beats_the_heater_and_likes_warmth(self, vehicle: Vehicle) -> None:
        table = vehicle.heat_pump_cop
        worst = table.f.min() * (1.0 - vehicle.heat_pump_droop_per_kw * vehicle.heat_pump_kw)
        assert worst > 1.0
        assert np.all(np.diff(table.f) >= 0)

    def test_heat_pump_stays_below_carnot(self, vehicle: Vehicle) -> None:
        t = np.arange(-30.0, 38.0, 1.0)
        carnot = 328.15 / (55.0 - t)
        assert np.all(vehicle.heat_pump_cop(t) < carnot)

    def test_charge_limit_rises_with_temperature_up_to_25_c(self, vehicle: Vehicle) -> None:
        soc, t = np.linspace(0.05, 0.95, 19), np.arange(-30.0, 25.1, 1.0)
        power = vehicle.pack.charge_limit_soc_kw(soc[:, None], t[None, :])
        assert np.all(np.diff(np.atleast_2d(power), axis=1) >= -1e-9)

    def test_charge_limit_falls_with_charge_above_its_plateau(self, vehicle: Vehicle) -> None:
        soc = np.linspace(0.0, 1.0, 201)
        power = np.asarray(vehicle.pack.charge_limit_soc_kw(soc, np.full(soc.size, 30.0)))
        top = int(power.argmax())
        assert np.all(np.diff(power[top:]) <= 0.02)  # a flat grid power: less loss at more volts
        assert 100.0 < power[top] < 200.0
        assert power[: top + 1].min() > 0.8 * power[top]

    def test_a_cold_pack_charges_slowly(self, vehicle: Vehicle) -> None:
        limit = vehicle.pack.charge_limit_soc_kw
        share = limit.at(0.4, -10.0) / limit.at(0.4, 25.0)
        assert 0.10 <= share <= 0.25

    def test_motorway_consumption(self, vehicle: Vehicle) -> None:
        assert 11.0 < flat_kwh_per_100km(vehicle, 90.0) < 21.0
        assert 14.0 < flat_kwh_per_100km(vehicle, 110.0) < 26.0

    def test_maps_cover_the_experiments(self, vehicle: Vehicle) -> None:
        for table in (vehicle.cabin_heating_kw, vehicle.cabin_cooling_kw):
            assert table.lo <= -15.0 and table.hi >= 30.0 and table.f.min() >= 0.0
        assert vehicle.heat_loss_kw_per_k.lo == 0.0 and vehicle.heat_loss_kw_per_k.hi >= 130.0
        for table in (vehicle.pack.resistance_ohm, vehicle.heat_pump_cop):
            assert table.lo <= vehicle.pack.temperature_min_c
            assert table.hi >= vehicle.pack.temperature_max_c

    def test_lfp_is_flat_and_nmc_is_not(self) -> None:
        swing = {}
        for name in ("tesla-model-3-rwd", "polestar-2-dual"):
            ocv = load_vehicle(name).pack.ocv_v
            swing[name] = ocv.at(0.9) / ocv.at(0.2) - 1.0
        assert swing["tesla-model-3-rwd"] < 0.05 < 0.10 < swing["polestar-2-dual"]


class TestDerivedFigures:
    @pytest.mark.parametrize("car", cars.CARS, ids=lambda car: car.name)
    def test_town_test_is_predicted_by_the_efficiency_from_the_highway_test(
        self, car: cars.Car
    ) -> None:
        """EPA's UDDS consumption was not used: an independent check of road load and losses."""
        row = next(r for r in source_rows("road_load.csv") if r["vehicle"] == car.name)
        efficiency = figures.drive_efficiency(car.name)
        battery = figures.driving_cycle_kwh_per_100km(car.name, "udds", efficiency)
        assert battery / figures.WALL_TO_BATTERY == pytest.approx(float(row["udds_wall"]), rel=0.12)

    @pytest.mark.parametrize("car", cars.CARS, ids=lambda car: car.name)
    def test_warm_car_takes_what_the_published_curve_says(self, car: cars.Car) -> None:
        pack = load_vehicle(car.name).pack
        for row in source_rows("dc_curves.csv"):
            if row["vehicle"] == car.name:
                soc = float(row["soc"])
                power = pack.charge_limit_soc_kw.at(soc, 30.0)
                loss = pack.resistance_ohm.at(30.0) * power**2 * 1000 / pack.ocv_v.at(soc) ** 2
                assert power + loss == pytest.approx(float(row["power_kw"]), rel=0.005)

    def test_resistance_of_the_nmc_cars_follows_the_measured_pack(self) -> None:
        ratio = load_vehicle("polestar-2-dual").pack.resistance_ohm
        rows = source_rows("bmw_i3_resistance.csv")
        at_25 = next(float(r["resistance_ohm"]) for r in rows if r["temperature_c"] == "25.0")
        for row in rows:
            t = float(row["temperature_c"])
            if t >= 0.0:
                expected = float(row["resistance_ohm"]) / at_25
                assert ratio.at(t) / ratio.at(25.0) == pytest.approx(expected, rel=0.08)

    def test_tables_of_the_paper_car_are_close_to_their_closed_forms(self) -> None:
        errors = paper.interpolation_errors()
        assert max(errors["charge_limit"], errors["resistance"], errors["cop"]) < 0.002
        assert errors["discharge_limit"] < 0.01

    def test_paper_car_as_loaded_keeps_the_closed_form(self) -> None:
        pack = load_vehicle("paper-2022").pack
        soc, t = np.meshgrid(np.linspace(0.05, 0.9, 86), np.linspace(-30.0, 40.0, 71))
        loaded = pack.charge_limit_kw(pack.energy_kwh(soc), t)
        assert np.max(np.abs(loaded / paper.charge_limit_kw(soc, t) - 1.0)) < 0.003


class TestTrips:
    def test_paper_trip_has_the_published_figures(self) -> None:
        trip = load_trip("paper-400km")
        assert trip.route.length_km == pytest.approx(400.0)
        assert trip.route.driving_h == pytest.approx(4.2, abs=0.01)
        assert np.allclose(np.diff(trip.route.node_km), 4.0)
        assert np.allclose(trip.route.ambient_c, -10.0) and trip.start_temperature_c == -10.0
        assert trip.start_soc == 0.9 and trip.end_soc_min == 0.1
        for charger in trip.chargers:
            assert charger.power_kw == 200.0 and charger.price_per_kwh == 8.7
            assert charger.detour_h == pytest.approx(300 / 3600)
            assert charger.detour_in_kwh + charger.detour_out_kwh == pytest.approx(0.45)

    def test_paper_trip_has_the_calibrated_propulsion(self) -> None:
        route = load_trip("paper-400km").route
        energy = float(route.propulsion_kw @ route.duration_h)
        heat = float(route.drivetrain_heat_kw @ route.duration_h)
        fit = paper.FIT
        assert energy == pytest.approx(fit.propulsion_factor * 78.14, abs=0.05)
        loss_kw = 2.30  # mean of the drivetrain on this route, whatever part of it is heat
        assert heat / route.driving_h == pytest.approx(
            fit.drivetrain_heat_share * loss_kw, rel=0.01
        )

    @pytest.mark.parametrize("name", [n for n in TRIPS if n.startswith("goteborg")])
    def test_corridor_has_eight_sites_and_is_longer_than_the_range(self, name: str) -> None:
        trip = load_trip(name)
        pack, route = trip.vehicle.pack, trip.route
        position = [charger.position_km for charger in trip.chargers]
        assert len(position) == 8 and position == sorted(position)
        assert position[0] > 0 and position[-1] < route.length_km
        usable = float(pack.energy_kwh(trip.start_soc) - pack.energy_kwh(trip.end_soc_min))
        need = float(route.propulsion_kw @ route.duration_h)
        assert usable < need < 3.0 * usable

    def test_corridor_is_a_plausible_road(self) -> None:
        route = load_trip("goteborg-stockholm-winter").route
        assert route.length_km == pytest.approx(473.0, abs=0.1)
        assert 80.0 < route.length_km / route.driving_h < 110.0

    def test_long_road_is_a_motorway_with_gentle_hills(self) -> None:
        lines = [x for x in read("routes", "long-1000km").splitlines() if x[0] != "#"]
        km, speed, height = np.array([row.split(",") for row in lines[1:]], dtype=float).T
        assert km[0] == 0.0 and km[-1] == 1000.0 and np.allclose(np.diff(km), 0.5)
        assert km[-1] / np.sum(np.diff(km) / speed[:-1]) == pytest.approx(110.0, abs=2.0)
        assert 0.8 < np.mean(speed >= 107.0) < 0.97 and speed.min() == 50.0
        assert np.abs(np.diff(height)).max() < 0.02 * 500.0
        assert np.ptp(height) > 100.0

    def test_long_trip_has_twenty_sites_that_compete(self) -> None:
        made = load_trip("long-1000km-winter").chargers
        position = np.array([charger.position_km for charger in made])
        power = np.array([charger.power_kw for charger in made])
        price = np.array([charger.price_per_kwh for charger in made])
        detour = np.array([charger.detour_in_kwh + charger.detour_out_kwh for charger in made])
        assert len(made) == 20 and np.all(np.diff(position) > 15.0)
        assert np.diff(np.concatenate([[0.0], position, [1000.0]])).max() < 75.0
        assert power.min() == 50.0 and power.max() == 300.0
        assert price.min() >= 3.5 and price.max() <= 8.5 and np.ptp(price) > 4.0
        assert detour.min() >= 0.3 and detour.max() <= 0.9
        assert all(3.0 <= 60.0 * charger.detour_h <= 8.0 for charger in made)
        assert np.mean(price[power >= 250.0]) > np.mean(price[power <= 100.0]) + 2.0
        assert 3 <= sum(charger.occupancy_price_per_h > 0.0 for charger in made) <= 10

    def test_long_trip_needs_three_stops_by_its_energy_alone(self) -> None:
        """Without any loss, charging the pack to the brim from its least charge, two stops fall
        short: the need counts propulsion, consumers and the cabin at the pump's best CoP.
        """
        trip = load_trip("long-1000km-winter")
        route, car = trip.route, trip.vehicle
        cabin_kw = car.cabin_heating_kw(route.ambient_c) / car.heat_pump_cop.f.max()
        power_kw = route.propulsion_kw + car.auxiliary_kw + cabin_kw
        need = float(power_kw @ route.duration_h)
        start, least, full, end = car.pack.energy_kwh(
            np.array([trip.start_soc, 0.05, trip.soc_max, trip.end_soc_min])
        )
        assert trip.soc_min(np.array([0.0, 500.0])).tolist() == [0.05, 0.05]
        detour = min(c.detour_in_kwh + c.detour_out_kwh for c in trip.chargers)
        two, three = (start - end + n * (full - least - detour) for n in (2, 3))
        assert two < need < 0.9 * three

    def test_sampling_a_cycle_with_a_stop_keeps_distance_and_moving_time(self) -> None:
        speed = np.array([10.0, 10.0, 0.0, 0.0, 0.0, 10.0, 10.0, 10.0])
        time = np.array([0.0, 100.0, 101.0, 150.0, 199.0, 200.0, 300.0, 400.0])
        cycle = np.stack([time, speed, np.full(8, 0.01)], axis=1)
        border, mean, grade = routes.resample(cycle, sample_m=100.0)
        moved = float(np.sum(100.0 / mean))
        assert moved == pytest.approx(border[-1] / 10.0, rel=0.01)
        assert np.allclose(grade, 0.01) and border[-1] == 3000.0
