"""The convex side of evrelax: the model of a trip, its relaxation, its refinement, its replay."""

from relax.errors import DomainError, EvrelaxError, InputError
from relax.instance import Instance, make_drive, make_instance
from relax.maps import Table1, Table2
from relax.plan import Controls, Trajectory
from relax.refinement import Refined, RefineSettings, refine
from relax.replay import Replay, replay
from relax.simulate import idle_controls, simulate
from relax.trip import Charger, Grid, Route, Trip
from relax.vehicle import Pack, RoadLoad, Vehicle

__all__ = [
    "Charger",
    "Controls",
    "DomainError",
    "EvrelaxError",
    "Grid",
    "InputError",
    "Instance",
    "Pack",
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
    "idle_controls",
    "make_drive",
    "make_instance",
    "refine",
    "replay",
    "simulate",
]
