"""The LeRobot dataset, read back by pyarrow and pandas as the format's own reader does."""

import json

import numpy as np
import pandas
import pyarrow.parquet
import pytest

import bubbleviz as bv
from tests.shear.texture_bag import HELD, write_texture_press

FIRST = "chunk-000/file-000.parquet"
DEFAULT_FEATURES = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}
"""Of every dataset v3.0, as `lerobot/datasets/utils.py` has them."""
ARROW = {"float32": "float", "int64": "int64", "bool": "bool"}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, press, sensor):
    out = tmp_path_factory.mktemp("out") / "dataset"
    bv.export(press, out, sensor, what="lerobot")
    return out


def test_columns_match_the_description(dataset):
    info = json.loads((dataset / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["splits"] == {"train": "0:1"}
    assert info["features"].items() >= DEFAULT_FEATURES.items()
    path = dataset / info["data_path"].format(chunk_index=0, file_index=0)
    table = pyarrow.parquet.read_table(path)
    assert table.column_names == list(info["features"])
    assert len(table) == info["total_frames"]
    for name, feature in info["features"].items():
        kind, (size,) = table.schema.field(name).type, feature["shape"]
        wanted = ARROW[feature["dtype"]]
        assert str(kind) in (wanted, f"fixed_size_list<element: {wanted}>[{size}]")
        assert "/" not in name


def test_numbers_equal_those_of_the_estimate(dataset, estimated):
    table = pyarrow.parquet.read_table(dataset / "data" / FIRST).to_pydict()
    wrench = np.array(table["observation.wrench"])
    np.testing.assert_allclose(wrench[:, :3], estimated["force_n"], rtol=1e-6)
    torque = np.nan_to_num(estimated["torque_nm"])  # not known of no contact
    np.testing.assert_allclose(wrench[:, 3:], torque, rtol=1e-6)
    sigma = np.array(table["observation.force_sigma_n"])
    np.testing.assert_allclose(sigma, estimated["force_sigma_n"], rtol=1e-6)
    nodes = np.array(table["observation.node_forces_n"])
    whole = nodes.reshape(len(nodes), -1, 3).sum(axis=1)
    np.testing.assert_allclose(whole, estimated["force_n"], atol=1e-5)
    np.testing.assert_allclose(table["timestamp"], estimated["time_s"], atol=1e-6)
    assert table["observation.trusted"] == [True] * len(nodes)
    assert table["index"] == table["frame_index"] == list(range(len(nodes)))


def test_episode_task_and_statistics(dataset):
    info = json.loads((dataset / "meta/info.json").read_text())
    (episode,) = pyarrow.parquet.read_table(dataset / "meta/episodes" / FIRST).to_pylist()
    assert (episode["dataset_from_index"], episode["dataset_to_index"]) == (0, episode["length"])
    assert episode["length"] == info["total_frames"]
    tasks = pandas.read_parquet(dataset / "meta/tasks.parquet")
    assert tasks.iloc[0].name == episode["tasks"][0] and tasks["task_index"].tolist() == [0]
    stats = json.loads((dataset / "meta/stats.json").read_text())
    wrench = np.array(
        pyarrow.parquet.read_table(dataset / "data" / FIRST)["observation.wrench"].to_pylist()
    )
    assert set(stats) == set(info["features"])
    for name, found in (("min", wrench.min(0)), ("max", wrench.max(0)), ("mean", wrench.mean(0))):
        np.testing.assert_allclose(stats["observation.wrench"][name], found, rtol=1e-5, atol=1e-9)
        np.testing.assert_allclose(episode[f"stats/observation.wrench/{name}"], found, rtol=1e-5)


def test_slip_is_there_where_shear_was_asked_for_and_only_there(dataset, tmp_path):
    pytest.importorskip("cv2", reason="OpenCV, an extra, is not installed")
    assert not [name for name in described(dataset) if "slip" in name]
    press, sensor = write_texture_press(tmp_path, {})
    frames, out = bv.open(press)[HELD - 1 : HELD + 2], tmp_path / "sheared"
    bv.export(frames, out, sensor, what="lerobot", shear=True)
    table = pyarrow.parquet.read_table(out / "data" / FIRST).to_pydict()
    rows = bv.estimate(frames, sensor, shear=True).rows()
    for column in ("slip", "slip_sigma"):
        assert described(out)[f"observation.{column}"]["dtype"] == "float32"
        found, known = table[f"observation.{column}"], [row[column] for row in rows]
        np.testing.assert_allclose(found, known, rtol=1e-5, atol=1e-7)  # NaN where it is NaN
        assert np.isfinite(found).any()


def described(dataset):
    return json.loads((dataset / "meta/info.json").read_text())["features"]
