import pytest

from bubbleviz.sensor import load_sensor


@pytest.fixture(scope="session")
def sensor():
    """The sensor of the paper, of constant tension."""
    return load_sensor("pico_flexx_75mm")
