"""Helpers that make frames of messages, record, play and publish them."""

import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from mcap.reader import make_reader

from benchmarks.window.live_soak import free_port
from bubbleviz.live import Recorder, SessionOptions, ZenohPublisher, open_session


@contextmanager
def robot(port, first=0, *mode, layout="rmw"):
    """Publishes images as a ROS 2 node does, in a process of its own, until it is killed."""
    module = ["-m", "tests.live.robot", str(port), layout, str(first), *mode]
    process = subprocess.Popen(
        [sys.executable, *module], stdout=subprocess.DEVNULL, cwd=Path(__file__).parents[2]
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def listens(port):
    """Whether somebody does at this port of this computer."""
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


def frames_of(assembler, *messages):
    """The frames that messages are made into."""
    found = [frame for message in messages for frame in assembler.push(message)]
    return found + assembler.flush()


def recorded(path, messages, recorder=None):
    """A recording of messages."""
    recorder = recorder or Recorder()
    recorder.start(path)
    for message in messages:
        recorder.push(message)
    recorder.stop()
    return path


def messages_in(path, *topics):
    """Schema, channel and message, in the order written, as the `mcap` library reads them."""
    with path.open("rb") as file:
        return list(make_reader(file).iter_messages(topics or None, log_time_order=False))


def played(stream):
    """Play a stream to its end; the last frame."""
    last = None
    with stream:
        while (frame := stream.take(5.0)) is not None:
            last = frame
    return last


def over_zenoh(messages, domain, eventually):
    """What a subscriber gets of messages that are published, by key."""
    endpoint, got = f"tcp/127.0.0.1:{free_port()}", dict[str, bytes]()
    with ZenohPublisher(SessionOptions("out", listen=endpoint), domain=domain) as out:
        listener = open_session(SessionOptions("in", endpoint))

        def note(sample):
            got[str(sample.key_expr)] = sample.payload.to_bytes()

        def sent():
            for message in messages:
                out.put(message)
            return len(got) == len(messages)

        try:
            subscriber = listener.declare_subscriber(f"{domain}/**", note)
            eventually(sent)
            subscriber.undeclare()
        finally:
            listener.close()
    return got
