"""A frame's force and doubts in words, the same wherever the window shows them. No Qt in here."""

from __future__ import annotations

import numpy as np

from bubbleviz.diagnostics.probe import Probed
from bubbleviz.result import Result
from bubbleviz_ui.model.units import Units

DOUBTS = {
    "no_data": "no depth data",
    "not_converged": "not converged",
    "implausible": "implausible",
}
"""Headline of each status without a number to trust."""


def doubt_text(result: Result) -> str:
    """Why the numbers of a result are not to be trusted; empty where they are."""
    estimate = result.estimate
    if estimate is None or estimate.trusted:
        return ""
    headline = DOUBTS[estimate.status]
    return f"{headline}: {estimate.reason}" if estimate.reason else headline


def force_text(result: Result, units: Units) -> str:
    """|F| ± half of its 95 % interval where it is known; a dash where it is not to be trusted."""
    estimate, patch = result.trusted_estimate, result.trusted_patch
    if estimate is None or patch is None:
        return units.force.text(None)
    force = float(np.linalg.norm(patch.force_n))
    return units.force.with_interval(force, estimate.force_half_width_n)


def tangential_text(result: Result, units: Units) -> str:
    """The part of the force that is friction; a dash where no friction was estimated."""
    patch = result.trusted_patch
    if patch is None:
        return units.force.text(None)
    tangential = float(np.linalg.norm(patch.tangential_force_n))
    # An estimated amplitude is never exactly 0.
    estimated = tangential > 0.0 or not patch.force_n.any()
    return units.force.text(tangential if estimated else None)


def pressure_text(place: Probed, units: Units) -> str:
    """Contact pressure at a place, or the pressure there that is not contact."""
    if place.unexplained_pa > 0.0:
        return f"{units.pressure.text(place.unexplained_pa)} without evidence of contact"
    return f"p_c {units.pressure.text(place.pressure_pa)}"
