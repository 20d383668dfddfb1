"""Owns the way from a road profile to a :class:`~relax.trip.Route`: road load and sampling.

Powers are computed at the profile's own resolution and averaged in time
afterwards, so that sampling preserves energy and time. Knows nothing of files.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from relax.trip import Route
from relax.vehicle import RoadLoad

__all__ = ["Profile", "drivetrain_loss_kw", "make_route", "propulsion_kw", "wheel_force_n"]

Array = npt.NDArray[np.float64]

GRAVITY_M_PER_S2 = 9.81
KMH_PER_MPS = 3.6

TAIL = 1e-9
"""A last sample shorter than this share of a sample is merged into the one before."""


@dataclass(frozen=True)
class Profile:
    """Road profile as given, constant within each row.

    Parameters
    ----------
    name : str
        For reports.
    node_km : ndarray, shape (n + 1,)
        Row borders, strictly increasing from 0 [km].
    speed_kmh : ndarray, shape (n,)
        Mean speed, > 0 [km/h].
    grade : ndarray, shape (n,)
        dz/ds.
    propulsion_kw, drivetrain_heat_kw, ambient_c : ndarray, shape (n,), or None
        Given instead of computed: battery-side power [kW], heat that reaches
        the battery [kW], ambient temperature [degrees C].

    Examples
    --------
    >>> import numpy as np
    >>> flat = Profile("flat", np.array([0.0, 10.0]), np.array([90.0]), np.array([0.0]))
    >>> flat.cut(2.0, 8.0).node_km
    array([0., 6.])
    """

    name: str
    node_km: Array
    speed_kmh: Array
    grade: Array
    propulsion_kw: Array | None = None
    drivetrain_heat_kw: Array | None = None
    ambient_c: Array | None = None

    def row_at(self, position_km: npt.ArrayLike) -> npt.NDArray[np.intp]:
        """Return the row that holds at a position (the next one at a border)."""
        row = np.searchsorted(self.node_km, position_km, side="right") - 1
        return np.clip(row, 0, self.speed_kmh.size - 1)

    def cut(self, start_km: float, end_km: float) -> Profile:
        """Return the profile between two positions, counted from the first."""
        inner = self.node_km[(self.node_km > start_km) & (self.node_km < end_km)]
        node = np.concatenate([[start_km], inner, [end_km]])
        row = self.row_at(node[:-1])

        def take(column: Array | None) -> Array | None:
            return None if column is None else column[row]

        return Profile(
            self.name,
            node - start_km,
            self.speed_kmh[row],
            self.grade[row],
            take(self.propulsion_kw),
            take(self.drivetrain_heat_kw),
            take(self.ambient_c),
        )


def wheel_force_n(load: RoadLoad, node_km: Array, speed_kmh: Array, grade: Array) -> Array:
    """Force at the wheel: F = a + b*v + c*v^2 + m*g*sin(slope) + m*dv^2/(2*ds).

    The speed at a border is the mean of the two rows' speeds, at the ends of the
    route the row's own, so the kinetic energies of all rows telescope to that
    between the first and the last speed.

    Parameters
    ----------
    load : RoadLoad
        Coefficients.
    node_km : ndarray, shape (n + 1,)
        Row borders [km].
    speed_kmh, grade : ndarray, shape (n,)
        Mean speed [km/h] and dz/ds.

    Returns
    -------
    ndarray, shape (n,)
        Mean force [N]; negative when braking.

    Examples
    --------
    >>> import numpy as np
    >>> load = RoadLoad(2000.0, 100.0, 1.0, 0.03, 0.9, 0.9, 50.0, 1.0, 0.5)
    >>> wheel_force_n(load, np.array([0.0, 1.0]), np.array([100.0]), np.array([0.0]))
    array([500.])
    """
    slope = grade / np.sqrt(1.0 + grade**2)
    border = np.concatenate([speed_kmh[:1], 0.5 * (speed_kmh[1:] + speed_kmh[:-1]), speed_kmh[-1:]])
    kinetic_j = 0.5 * load.mass_kg * np.diff((border / KMH_PER_MPS) ** 2)
    steady = load.a_n + load.b_n_per_kmh * speed_kmh + load.c_n_per_kmh2 * speed_kmh**2
    force: Array = (
        steady + load.mass_kg * GRAVITY_M_PER_S2 * slope + kinetic_j / (1000.0 * np.diff(node_km))
    )
    return force


def propulsion_kw(load: RoadLoad, force_n: Array, speed_kmh: Array) -> Array:
    """Battery-side power: F*v/eta_drive, or -min(|F*v|, regen_max)*eta_regen, times the factor.

    Parameters
    ----------
    load : RoadLoad
        Efficiencies and factor.
    force_n, speed_kmh : ndarray, shape (n,)
        Force at the wheel [N], speed [km/h].

    Returns
    -------
    ndarray, shape (n,)
        Power drawn from the battery [kW].

    Examples
    --------
    >>> import numpy as np
    >>> load = RoadLoad(2000.0, 100.0, 1.0, 0.03, 0.8, 0.5, 10.0, 1.0, 0.5)
    >>> propulsion_kw(load, np.array([360.0, -360.0]), np.array([80.0, 200.0]))
    array([10., -5.])
    """
    wheel = force_n * speed_kmh / (1000.0 * KMH_PER_MPS)
    braking = np.minimum(-wheel, load.regen_max_kw) * load.regen_efficiency
    power: Array = np.where(wheel > 0.0, wheel / load.drive_efficiency, -braking) * load.factor
    return power


def drivetrain_loss_kw(load: RoadLoad, power_kw: Array) -> Array:
    """Loss between battery and wheel at a battery-side power.

    Driving (1 - eta_drive)*P; recuperating (1/eta_regen - 1)*abs(P), the loss of the
    recuperated part only: the rest goes into the brakes.

    Parameters
    ----------
    load : RoadLoad
        Efficiencies.
    power_kw : ndarray, shape (n,)
        Battery-side power [kW].

    Returns
    -------
    ndarray, shape (n,)
        Loss [kW], >= 0.

    Examples
    --------
    >>> import numpy as np
    >>> load = RoadLoad(2000.0, 100.0, 1.0, 0.03, 0.75, 0.5, 10.0, 1.0, 0.5)
    >>> drivetrain_loss_kw(load, np.array([8.0, -3.0]))
    array([2., 3.])
    """
    driving = power_kw * (1.0 - load.drive_efficiency)
    braking = -power_kw * (1.0 / load.regen_efficiency - 1.0)
    return np.maximum(driving, braking)


def make_route(
    profile: Profile,
    load: RoadLoad,
    ambient: Callable[[Array], Array] | None = None,
    sample_km: float | None = None,
) -> Route:
    """Return the route of a profile, averaged in time over samples.

    Parameters
    ----------
    profile : Profile
        The road. A given ``propulsion_kw`` is used as it is, without the factor.
    load : RoadLoad
        For what is not given.
    ambient : callable, optional
        Integral of the ambient temperature over position from km 0
        [degrees C * km over km]; the profile's column when left out.
    sample_km : float, optional
        Length of the samples [km], the last one shorter; the profile's own rows
        when left out. Time and propulsion energy of the whole are preserved.

    Returns
    -------
    Route

    Examples
    --------
    >>> import numpy as np
    >>> load = RoadLoad(2000.0, 100.0, 1.0, 0.03, 0.9, 0.9, 50.0, 1.0, 0.5)
    >>> hill = Profile("hill", np.array([0.0, 1.0, 3.0]), np.array([50.0, 100.0]), np.zeros(2),
    ...                ambient_c=np.zeros(2))
    >>> route = make_route(hill, load, sample_km=3.0)
    >>> route.speed_kmh, route.driving_h
    (array([75.]), 0.04)
    """
    rows = profile.node_km
    power = profile.propulsion_kw
    if power is None:
        force = wheel_force_n(load, rows, profile.speed_kmh, profile.grade)
        power = propulsion_kw(load, force, profile.speed_kmh)
    heat = profile.drivetrain_heat_kw
    if heat is None:
        heat = load.heat_share * drivetrain_loss_kw(load, power)
    node = rows if sample_km is None else _samples(rows[-1], sample_km)
    pieces = np.union1d(rows, node)
    row = profile.row_at(pieces[:-1])
    hours = np.diff(pieces) / profile.speed_kmh[row]
    if ambient is not None:
        outside = np.diff(ambient(pieces)) / np.diff(pieces)
    elif profile.ambient_c is not None:
        outside = profile.ambient_c[row]
    else:
        raise ValueError("ambient temperature: neither given nor in the profile")
    first = np.searchsorted(pieces, node[:-1])
    duration = np.add.reduceat(hours, first)

    def mean(column: Array) -> Array:
        return np.add.reduceat(column * hours, first) / duration

    speed = np.diff(node) / duration
    return Route(profile.name, node, speed, mean(power[row]), mean(heat[row]), mean(outside))


def _samples(length_km: float, sample_km: float) -> Array:
    """Borders every ``sample_km`` from 0, and the end."""
    count = max(1, int(np.ceil(length_km / sample_km - TAIL)))
    node = sample_km * np.arange(count + 1, dtype=np.float64)
    node[-1] = length_km
    return node
