"""What a report says of γ0 by force."""

from __future__ import annotations

from typing import Any

from bubbleviz.calibration.tension.wrench_tension import WrenchTension


def wrench_numbers(by_wrench: WrenchTension | None) -> dict[str, Any] | None:
    """Numbers for JSON, SI units; None where there is no estimate."""
    if by_wrench is None:
        return None
    return {
        "tension_n_per_m": by_wrench.tension_n_per_m,
        "at_limit": by_wrench.at_limit,
        "fitted_rms_n": by_wrench.fitted_rms_n,
        "tested_rms_n": by_wrench.tested_rms_n,
        "given_rms_n": by_wrench.given_rms_n,
        "measured_mean_n": float(by_wrench.measured_n.mean()),
        "predicted_mean_n": float(by_wrench.predicted_n.mean()),
    }


def wrench_advice(by_wrench: WrenchTension | None, tension_n_per_m: float) -> list[str]:
    """One sentence, or none."""
    if by_wrench is None:
        return []
    error, size = by_wrench.given_rms_n, float(by_wrench.measured_n.mean())
    text = (
        f"On the half of the press not used for it, γ0 = {tension_n_per_m:.1f} N/m predicts the"
        f" measured force of {size:.2f} N with an error of {error:.2f} N rms"
    )
    if by_wrench.at_limit:
        return [
            f"{text}; no γ0 explains that force ({by_wrench.tested_rms_n:.2f} N at best): check"
            " the scale and bias of the force sensor, and the gauge pressure."
        ]
    return [
        f"{text}; γ0 by force is {by_wrench.tension_n_per_m:.1f} N/m, with"
        f" {by_wrench.tested_rms_n:.2f} N rms."
    ]


def wrench_rows(wrench: dict[str, Any] | None) -> list[tuple[str, str]]:
    """Rows of the table, from `wrench_numbers`."""
    if wrench is None:
        return []
    limit = " (end of what was tried: the force cannot be explained by γ0)"
    return [
        (
            "γ0 by force",
            f"{wrench['tension_n_per_m']:.1f} N/m{limit if wrench['at_limit'] else ''}",
        ),
        ("error of its force on frames not used", f"{wrench['tested_rms_n']:.2f} N rms"),
        ("the same with γ0 by Young–Laplace", f"{wrench['given_rms_n']:.2f} N rms"),
        ("mean force there", f"{wrench['measured_mean_n']:.2f} N"),
    ]
