"""Values of --source, and messages for invalid ones."""

import pytest

import bubbleviz as bv
from bubbleviz.errors import InputError
from bubbleviz.live import open_stream, parse_uri


def test_uri_is_parsed():
    uri = parse_uri("zenoh:tcp/10.0.0.7:7447?depth=/cam/depth&lag=-0.01&info=%3F")
    assert (uri.scheme, uri.place) == ("zenoh", "tcp/10.0.0.7:7447")
    options = uri.options
    assert (options.depth, options.info, options.wrench) == ("/cam/depth", "?", None)
    assert options.lag == -0.01 and options.domain == 0


@pytest.mark.parametrize("place", ["/a/b#1.mcap", "//host/a.mcap", "C:/a%20b.mcap"])
def test_path_of_a_uri_is_kept(place):
    assert parse_uri(f"replay:{place}?loop=1").place == place.replace("%20", " ")


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("", "begin with one of synthetic:"),
        ("/dev/video0", "begin with one of"),
        ("ftp:there", "begin with one of"),
        ("synthetic:?rate", "write it as SCHEME:PLACE"),
        ("synthetic:?rate=30&rate=60", "twice"),
        ("synthetic:?rate=fast", "rate=fast: give a number from"),
        ("synthetic:?frames=2.5", "frames=2.5: give a whole number from 1"),
        ("synthetic:?rate=nan", "rate=nan: give a number from"),
        ("synthetic:?noise=-1", "noise=-1"),
        ("synthetic:?speed=2", "speed: synthetic has no such option"),
        ("synthetic:?ahead=perhaps", "ahead=perhaps: give 1 or 0"),
        ("synthetic:?encoding=rgb8", "choose one of 32FC1, 16UC1"),
        ("synthetic:no_such_object", "no such object"),
        ("replay:", "give the recording"),
        ("replay:nowhere.mcap", "no such recording"),
        ("replay:nowhere.mcap?speed=0", "speed=0"),
        ("zenoh:?domain=1000", "domain=1000"),
        ("realsense:no_such_file.bag", "no such file"),
        ("realsense:0123456789", "RealSense"),
    ],
)
def test_errors_are_one_line_with_the_source(source, says, small_sensor, tmp_path):
    with pytest.raises(InputError, match=says.replace("(", r"\(")) as caught:
        open_stream(source, small_sensor)
    assert "\n" not in str(caught.value)


def test_an_open_stream_is_no_source(small_sensor):
    with (
        bv.connect("synthetic:sphere?frames=1", small_sensor) as stream,
        pytest.raises(InputError, match=r"not a LiveStream; .* use estimate or track"),
    ):
        bv.watch(stream)
