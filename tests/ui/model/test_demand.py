"""Hidden means not asked for."""

from __future__ import annotations

from dataclasses import replace

from bubbleviz_ui.model.choices import Choices
from bubbleviz_ui.model.demand import products
from bubbleviz_ui.model.registry import LAYERS
from bubbleviz_ui.view3d.drawn_layers import CLASSES

NOTHING = Choices(layers=frozenset(), panels=frozenset())


def test_a_layer_is_asked_for_by_its_name_in_the_registry() -> None:
    assert [made.name for made in CLASSES] == list(LAYERS)


def test_nothing_visible_needs_nothing() -> None:
    assert products(NOTHING) == frozenset()
    assert products(replace(NOTHING, layers=frozenset({"rim", "frustum"}))) == frozenset()


def test_a_plain_cloud_needs_no_solve() -> None:
    choices = replace(NOTHING, layers=frozenset({"cloud"}), cloud_colour="plain")
    assert products(choices) == {"cloud"}


def test_the_colour_of_a_hidden_cloud_needs_nothing() -> None:
    assert "residual" not in products(replace(NOTHING, layers=frozenset({"membrane"})))


def test_the_cloud_by_patch_needs_its_pixels() -> None:
    choices = replace(NOTHING, layers=frozenset({"cloud"}), cloud_colour="patch")
    assert products(choices) == {"cloud", "estimate", "patch", "pixel_mask"}
