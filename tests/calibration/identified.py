"""Identification from contact-free frames alone."""

from dataclasses import replace

import bubbleviz as bv
from bubbleviz.calibration import rest_gauge
from tests.small_press import changed


def identify(source, sensor, frames=None, **settings):
    return bv.identify(source, sensor, contact_free=frames, held_press=False, **settings).found


def opened(found, vented):
    """The same with the gas pressure of the open chamber."""
    gauge = rest_gauge(found.samples, found.given, vented)
    return replace(found, gauge=gauge, vented=vented)


def with_air(sensor, pressure_pa):
    """The same sensor file with another atmospheric pressure, whose error is not known."""
    air = {"atmospheric_pressure_pa": pressure_pa, "gauge_sigma_pa": None}
    return changed(sensor, pneumatics=air)
