"""The convex side of evrelax: the model of a trip, its relaxation, its refinement, its replay.

Importing the package costs next to nothing: every name is imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from relax.lazy import export

if TYPE_CHECKING:
    from relax.driven import Replay
    from relax.errors import DomainError, EvrelaxError, InputError
    from relax.execute import Execution, execute
    from relax.instance import Instance, make_drive, make_instance
    from relax.load import (
        load_trip,
        load_vehicle,
        shipped_routes,
        shipped_trips,
        shipped_vehicles,
        trip_schema,
        vehicle_schema,
    )
    from relax.maps import Table1, Table2
    from relax.plan import Controls, Trajectory
    from relax.plot import plot_case, save_plots
    from relax.refinement import Refined, RefineSettings, refine
    from relax.replay import replay
    from relax.report import PlanReport
    from relax.simulate import idle_controls, simulate
    from relax.trip import Charger, Grid, Route, Trip
    from relax.vehicle import Pack, RoadLoad, Vehicle

__all__ = [
    "Charger",
    "Controls",
    "DomainError",
    "EvrelaxError",
    "Execution",
    "Grid",
    "InputError",
    "Instance",
    "Pack",
    "PlanReport",
    "RefineSettings",
    "Refined",
    "Replay",
    "RoadLoad",
    "Route",
    "Table1",
    "Table2",
    "Trajectory",
    "Trip",
    "Vehicle",
    "execute",
    "idle_controls",
    "load_trip",
    "load_vehicle",
    "make_drive",
    "make_instance",
    "plot_case",
    "refine",
    "replay",
    "save_plots",
    "shipped_routes",
    "shipped_trips",
    "shipped_vehicles",
    "simulate",
    "trip_schema",
    "vehicle_schema",
]

export(
    __name__,
    {
        "Charger": "trip",
        "Controls": "plan",
        "DomainError": "errors",
        "EvrelaxError": "errors",
        "Execution": "execute",
        "Grid": "trip",
        "InputError": "errors",
        "Instance": "instance",
        "Pack": "vehicle",
        "PlanReport": "report",
        "RefineSettings": "refinement",
        "Refined": "refinement",
        "Replay": "driven",
        "RoadLoad": "vehicle",
        "Route": "trip",
        "Table1": "maps",
        "Table2": "maps",
        "Trajectory": "plan",
        "Trip": "trip",
        "Vehicle": "vehicle",
        "execute": "execute",
        "idle_controls": "simulate",
        "load_trip": "load",
        "load_vehicle": "load",
        "make_drive": "instance",
        "make_instance": "instance",
        "plot_case": "plot",
        "refine": "refinement",
        "replay": "replay",
        "save_plots": "plot",
        "shipped_routes": "load",
        "shipped_trips": "load",
        "shipped_vehicles": "load",
        "simulate": "simulate",
        "trip_schema": "load",
        "vehicle_schema": "load",
    },
)
