"""Arguments that cannot be: each is refused in one line, exit code 2, and nothing is written."""

import shlex
import shutil

import pytest

from tests.program import refusal

USUAL = {
    "simulate": "--sensor S --object sphere --out out.mcap",
    "simulate at": "--sensor S --object sphere --out out.mcap --pose POSE",
    "export": "REC --sensor S --out",
    "batch": "in --sensor S --out out",
    "estimate": "REC --sensor S --out",
    "open": "REC --sensor S",
    "publish": "--source synthetic:?frames=4 --duration 0.1",
    "record": "--out rec.mcap --duration 0.1 --source",
    "watch": "--out rec.mcap --duration 0.1 --sensor pico_flexx_75mm --source",
}
"""What the commands get besides, the last value of an option counts."""

REFUSED = [
    ("info", "nope.mcap", "nope.mcap: no such recording, or no access"),
    ("info", "", "Missing argument 'REC'; see bubbleviz info --help"),
    ("info", "--nope x", "--nope"),
    ("fly", "", "No such command 'fly'; see bubbleviz --help"),
    ("simulate", "", "--pose, or --path"),
    ("simulate", "--pose '0 0 40 0 0 0 1'", "millimetres"),
    ("simulate", "--pose '0 0 0.04'", "seven numbers"),
    ("simulate", "--pose '0 0 0.04 0 0 0 2'", "unit length"),
    ("simulate", "--path missing.csv", "missing.csv"),
    ("simulate", "--path poses.csv", "line 3"),
    ("simulate at", "--object nonesuch", "no such object"),
    ("simulate at", "--holes 1.5", "holes"),
    ("simulate at", "--noise-sigma -1", "absolute_m"),
    ("simulate at", "--frames -2", "--frames -2: give a whole number"),
    ("simulate at", "--truth out.mcap", "two names"),
    ("simulate at", "--out press.npz", "end it in .mcap"),
    ("simulate at", "--truth b.csv", "end it in .npz"),
    ("simulate at", "--model linear --friction 0.5", "the linear membrane has no friction"),
    ("simulate at", "--model rubber --drag 3", "frames"),
    ("simulate at", "--model rubber --drag 300 --frames 20", "drag"),
    ("simulate at", "--model rubber --twist 1000 --frames 20", "twist"),
    ("simulate at", "--model rubber --twist nan --frames 20", "twist"),
    ("export", "there --what vtk", "exists already"),
    ("export", "x", "nothing to export"),
    ("export", "x --what vtk,stl", '"stl": unknown; choose from table'),
    ("export", "x.csv --what vtk", "a .csv file holds table, not vtk"),
    ("export", "x.pvd", "a series of files needs a folder"),
    ("export", "x.mp4", "from the window"),
    ("export", "x.csv --frames 0:99", "outside its 5 frames"),
    ("export", "x.csv --kappa nan", "--kappa nan"),
    ("export", "x.csv --solver magic", "magic"),
    ("export", "x.csv --poses nope.csv", "nope.csv"),
    ("export", "no/x.csv", "does not exist"),
    ("batch", "--out there", "exists already"),
    ("batch", "--sensor nope.toml", "nope.toml: no such sensor file"),
    ("batch", "--jobs 2 --scheduler tcp://x:1", "--jobs counts processes on this machine"),
    ("batch nope", "--sensor S --out out", "nope: no such folder"),
    ("estimate nope.mcap", "--sensor S --out r.npz", "nope.mcap: no such recording"),
    ("estimate", "r.npz --sensor nope.toml", "no such sensor file; give a .toml file or one of"),
    ("estimate", "r.npz --sensor other.toml", "other.toml: not a sensor file (no [membrane])"),
    ("estimate", "r.npz --shear", "no colour images of this sensor in a known encoding"),
    ("estimate", "r.npz --colour-delay -0.05", "--colour-delay needs --shear"),
    ("estimate", "r.npz --shear --colour-delay -83", "-83.0: give a finite number from -0.5 to"),
    ("estimate", "result.csv", "result.csv: wrong suffix for this output; end it in .npz"),
    ("estimate", "result", "end it in .npz"),
    ("estimate", "result.npz --csv table.npz", "end it in .csv"),
    ("estimate", "result.npz --csv result.npz", "two names"),
    ("estimate", "result.npz --csv ''", "the path is empty"),
    ("pose", "REC --sensor S --object sphere --out poses.npz", "end it in .csv"),
    ("convert", "REC other.csv", "end it in .mcap, or give a folder"),
    ("record", "synthetic: --out rec.txt", "end it in .mcap"),
    ("record", "synthetic: --duration 0", "--duration 0.0: give a finite number of 0.001 or more"),
    ("validate", "REC --sensor S --out mine.txt", "end it in .png, .svg, .pdf, .csv or .json, or"),
    ("open", "--screenshot a.jpg", "a.jpg: wrong suffix for this output; end it in .png"),
    ("open nope.mcap", "--screenshot a.png", "nope.mcap: no such recording"),
    ("open", "--screenshot a.png --scene nope", "nope"),
    ("open REC", "--screenshot a.png", "punyo_oval_d405 (640×480)"),
    ("publish", "--listen tcp/127.0.0.1:1 --connect tcp/127.0.0.1:2", "not both"),
    ("publish", "--connect tcp/127.0.0.1:1", "no Zenoh session"),
    ("publish", "--listen tcp/192.0.2.1:1", "no Zenoh session"),  # no address of this computer
    *(
        (command, source, says)
        for command in ("record", "watch")
        for source, says in (
            ("replay:nowhere", "no such recording"),
            ("zenoh:nonsense", "no Zenoh session"),
        )
    ),
]


@pytest.mark.parametrize(("command", "more", "says"), REFUSED)
def test_refused_in_one_line_and_nothing_is_written(
    command, more, says, press, sensor, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for name in ("there", "in"):
        (tmp_path / name).mkdir()
    shutil.copy(press, tmp_path / "in")
    (tmp_path / "poses.csv").write_text(
        "x_m,y_m,z_m,qx,qy,qz,qw\n0,0,0.05,0,0,0,1\n0,0,nan,0,0,0,1\n"
    )
    (tmp_path / "other.toml").write_text("[project]\nname = 'other'\n")
    before = sorted(tmp_path.rglob("*"))
    given = {"REC": press, "S": sensor, "POSE": "0.004 0 0.040 0 0 0 1"}
    line = f"{command.split(' at')[0]} {USUAL.get(command, '')} {more}"
    told = refusal(*(given.get(word, word) for word in shlex.split(line)))
    assert says.lower() in told.lower()
    assert sorted(tmp_path.rglob("*")) == before
