"""Membrane meshes from file: every format gives the same mesh; what is broken is refused."""

import struct

import numpy as np
import pytest

from bubbleviz.errors import InputError
from bubbleviz.membrane import load_membrane, membrane_from_triangles, mesh_cap, spherical_cap
from bubbleviz.simulation import study_object


@pytest.fixture(scope="module")
def cap():
    return mesh_cap(spherical_cap(0.075, 0.05), 200)


def write_ply_ascii(path, nodes, triangles):
    head = (
        f"ply\nformat ascii 1.0\ncomment z first\nelement face {len(triangles)}\n"
        f"property list uchar int vertex_index\nelement vertex {len(nodes)}\n"
        "property double z\nproperty uchar red\nproperty double x\nproperty double y\nend_header\n"
    )
    faces = "".join(f"3 {a} {b} {c}\n" for a, b, c in triangles)
    rows = "".join(f"{z!r} 7 {x!r} {y!r}\n" for x, y, z in nodes.tolist())
    path.write_text(head + faces + rows)


def write_ply_big_endian(path, nodes, triangles):
    head = (
        f"ply\nformat binary_big_endian 1.0\nelement vertex {len(nodes)}\nproperty double x\n"
        f"property double y\nproperty double z\nproperty float q\nelement face {len(triangles)}\n"
        "property uchar flags\nproperty list uchar uint vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(">dddf", *p, 1.0) for p in nodes.tolist())
    body += b"".join(struct.pack(">BBIII", 1, 3, *t) for t in triangles.tolist())
    path.write_bytes(head.encode() + body)


def write_obj(path, nodes, triangles):
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in nodes.tolist())
    path.write_text(text + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in triangles))


def write_stl(path, nodes, triangles):
    soup = nodes[triangles].astype("<f4").reshape(len(triangles), 9)
    rows = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("v", "<f4", 9), ("a", "<u2")])
    rows["v"] = soup
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(triangles)) + rows.tobytes())


def write_vtk(path, nodes, triangles):
    points = "\n".join(f"{x!r} {y!r} {z!r}" for x, y, z in nodes.tolist())
    faces = "\n".join(f"3 {a} {b} {c}" for a, b, c in triangles)
    path.write_text(
        f"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS {len(nodes)} double\n"
        f"{points}\nPOLYGONS {len(triangles)} {4 * len(triangles)}\n{faces}\n"
    )


WRITERS = {
    "a.ply": write_ply_ascii,
    "b.ply": write_ply_big_endian,
    "c.obj": write_obj,
    "d.stl": write_stl,
    "e.vtk": write_vtk,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_membrane(tmp_path, cap, name):
    rng = np.random.default_rng(0)
    flipped = cap.triangles[rng.permutation(len(cap.triangles))].copy()
    inward = rng.random(len(flipped)) < 0.5
    inward[0] = True  # the others follow the first
    flipped[inward] = flipped[inward][:, [0, 2, 1]]
    WRITERS[name](tmp_path / name, cap.nodes, flipped)
    mesh = load_membrane(tmp_path / name)
    assert len(mesh.nodes) == len(cap.nodes)
    assert mesh.rim.sum() == cap.rim.sum()
    assert mesh.cap_volume() == pytest.approx(cap.cap_volume(), rel=1e-6)
    centre = np.array([0.0, 0.0, 0.05 - (0.075**2 + 0.05**2) / 0.1])
    outward = mesh.nodes[~mesh.rim] - centre
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert (np.einsum("ij,ij->i", outward, mesh.normals[~mesh.rim]) > 0.95).all()


def test_polygons_are_triangulated(tmp_path):
    path = tmp_path / "quads.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 7\nproperty float x\nproperty float y\n"
        "property float z\nelement face 3\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 .01\n.02 0 0\n.02 .02 0\n0 .02 0\n-.02 .02 0\n-.02 -.02 0\n.02 -.02 0\n"
        "4 0 1 2 3\n4 0 3 4 5\n4 0 5 6 1\n"
    )
    mesh = load_membrane(path)
    assert len(mesh.triangles) == 6
    assert mesh.rim.tolist() == [False] + [True] * 6


def with_a_fin(nodes, triangles):
    top = np.vstack([nodes, [0.0, 0.0, 0.08]])
    return top, np.vstack([triangles, [*triangles[0, :2], len(nodes)]])


def flattened(nodes, triangles):
    moved, (a, b, c) = nodes.copy(), triangles[0]
    moved[c] = 0.5 * (moved[a] + moved[b])
    return moved, triangles


def twice(nodes, triangles):
    lifted = nodes + np.array([0.0, 0.0, 0.1])
    return np.vstack([nodes, lifted]), np.vstack([triangles, triangles + len(nodes)])


BROKEN = {
    "two loops": (lambda n, t: (n, t[5:]), "boundary loops"),
    "three triangles on an edge": (with_a_fin, r"edge \d+–\d+ from \("),
    "two pieces": (twice, "pieces"),
    "degenerate": (flattened, "no area"),
    "duplicate": (lambda n, t: (n, np.vstack([t, t[0, [1, 2, 0]]])), "twice"),
    "millimetres": (lambda n, t: (n * 1e3, t), "scale the mesh to metres"),
    "upside down": (lambda n, t: (n * [1, 1, -1], t), "points to -z"),
    "on its side": (lambda n, t: (n[:, [2, 0, 1]], t), "tilted"),
    "closed": (
        lambda *_: (study_object("sphere").vertices, study_object("sphere").triangles),
        "closed",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_mesh_is_refused_in_one_line(cap, kind):
    change, words = BROKEN[kind]
    with pytest.raises(InputError, match=words) as caught:
        membrane_from_triangles(*change(cap.nodes, cap.triangles))
    assert "\n" not in str(caught.value)


def test_hole_is_distinguished_from_the_rim(cap):
    inner = np.flatnonzero(~cap.rim[cap.triangles].any(axis=1))[0]
    i, j, k = cap.triangles[inner]
    named = "|".join(f"{a}–{b}" for a, b in ((i, j), (j, i), (j, k), (k, j), (k, i), (i, k)))
    with pytest.raises(InputError, match=f"2 boundary loops, the smallest through edge ({named}) "):
        membrane_from_triangles(cap.nodes, np.delete(cap.triangles, inner, axis=0))


@pytest.mark.parametrize(("tilt_deg", "lift", "words"), [
    (25.0, 0.0, None), (35.0, 0.0, "tilted 35°"),
    (0.0, 0.012, None), (0.0, 0.018, "rim lies at z = 0.018 m"), (0.0, -0.018, "z = -0.018 m"),
])  # fmt: skip
def test_small_deviations_of_the_rim_are_accepted(cap, tilt_deg, lift, words):
    """By 30°, and by a tenth of the rim's width of 150 mm."""
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    nodes = cap.nodes @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T + [0.0, 0.0, lift]
    if words is None:
        assert len(membrane_from_triangles(nodes, cap.triangles).nodes) == len(nodes)
    else:
        with pytest.raises(InputError, match=words):
            membrane_from_triangles(nodes, cap.triangles)


def test_unreadable_files_are_refused(tmp_path, cap, capfd):
    write_ply_big_endian(tmp_path / "whole.ply", cap.nodes, cap.triangles)
    whole = (tmp_path / "whole.ply").read_bytes()
    (tmp_path / "cut.ply").write_bytes(whole[: len(whole) // 2])
    write_ply_ascii(
        tmp_path / "nan.ply", np.where(cap.nodes == 0, np.nan, cap.nodes), cap.triangles
    )
    write_ply_ascii(tmp_path / "short.ply", cap.nodes, cap.triangles)
    text = (tmp_path / "short.ply").read_text()
    (tmp_path / "short.ply").write_text(text.rsplit("\n", 2)[0])  # without its last vertex
    for name, text in {"x.stl": "solid", "x.obj": "", "x.vtk": "hello", "x.ply": "hello"}.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "x.txt").write_text("hello")
    others = ("nan.ply", "x.stl", "x.obj", "x.vtk", "x.ply", "x.txt", "none.ply")
    for name in (r"cut.ply.*truncated", r"short.ply.*truncated", *others):
        with pytest.raises(InputError, match=name) as caught:
            load_membrane(tmp_path / name.split(".*")[0])
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")  # the readers print nothing of their own


def test_sliver_triangle_is_refused_in_any_orientation(cap):
    """Sliver of height 1e-7 of its length, along directions whose components cancel or add up."""
    nodes, triangles = cap.nodes.copy(), cap.triangles
    inner = np.flatnonzero(~cap.rim[triangles].any(axis=1))[0]
    a, b, c = triangles[inner]
    for direction in ((1.0, -1.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0)):
        along = 5e-3 * np.array(direction) / np.linalg.norm(direction)
        nodes[b] = nodes[a] + along
        nodes[c] = nodes[a] + 0.5 * along + [0.0, 0.0, 5e-10]
        with pytest.raises(InputError, match="no area"):
            membrane_from_triangles(nodes, triangles)


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_binary_file_may_mix_polygons(tmp_path, order):
    """And carry texture coordinates, edges, and bytes behind its last element."""
    path = tmp_path / "mixed.ply"
    name = {"<": "little", ">": "big"}[order]
    head = (
        f"ply\nformat binary_{name}_endian 1.0\nelement vertex 7\nproperty float y\n"
        "property double x\nproperty float z\nelement face 4\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
        "element edge 1\nproperty int vertex1\nproperty int vertex2\nend_header\n"
    )
    rim = [0.02 * np.exp(1j * np.pi * k / 3) for k in range(6)]
    nodes = [(0.0, 0.0, 0.01), *((w.real, w.imag, 0.0) for w in rim)]
    faces = [(0, 1, 2), (0, 2, 3, 4), (0, 4, 5), (0, 5, 6, 1)]
    body = b"".join(struct.pack(f"{order}fdf", y, x, z) for x, y, z in nodes)
    for face in faces:
        k = len(face)
        body += struct.pack(f"{order}B{k}iB{2 * k}f", k, *face, 2 * k, *[0.5] * (2 * k))
    path.write_bytes(head.encode() + body + struct.pack(f"{order}ii", 0, 1) + b"\n")
    mesh = load_membrane(path)
    np.testing.assert_allclose(mesh.nodes, nodes, atol=1e-8)
    assert sorted(map(sorted, mesh.triangles.tolist())) == [
        [0, 1, 2], [0, 1, 6], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 6]
    ]  # fmt: skip
    path.write_bytes(head.encode() + body[:-1])
    with pytest.raises(InputError, match="truncated"):
        load_membrane(path)
