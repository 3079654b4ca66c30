"""Interface of the exporters."""

from __future__ import annotations

from typing import Protocol

from bubbleviz.files.result_writer import UNKNOWN
from bubbleviz.pipeline import Product
from bubbleviz.result import Estimate, Result


class Exporter(Protocol):
    """Takes the results of frames one after the other and writes files.

    Attributes
    ----------
    products : frozenset of Product
        What each result must hold; nothing else is computed for it.
    """

    products: frozenset[Product]

    def add(self, result: Result) -> None:
        """Take the next frame."""

    def finish(self) -> None:
        """Write what needs all frames."""


def estimate_of(result: Result) -> Estimate:
    """The estimate of a result that was processed with the product `estimate`."""
    if result.estimate is None:
        raise ValueError("the product estimate was not asked for")
    return result.estimate


def is_known(estimate: Estimate) -> bool:
    """Whether the estimate has a membrane shape."""
    return estimate.status not in UNKNOWN
