"""What tests do with messages: make frames of them, record, play and publish them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from benchmarks.window.live_soak import free_port
from bubbleviz.live import (
    FrameAssembler,
    LiveStream,
    RawMessage,
    Recorder,
    SessionOptions,
    ZenohPublisher,
    open_session,
)
from bubbleviz.recordings import Frame, Message


def frames_of(assembler: FrameAssembler, *messages: RawMessage) -> list[Frame]:
    """The frames that messages are made into."""
    found = [frame for message in messages for frame in assembler.push(message)]
    return found + assembler.flush()


def recorded(path: Path, messages: Iterable[RawMessage], recorder: Recorder | None = None) -> Path:
    """A recording of messages."""
    recorder = recorder or Recorder()
    recorder.start(path)
    for message in messages:
        recorder.push(message)
    recorder.stop()
    return path


def played(stream: LiveStream) -> Frame | None:
    """Play a stream to its end; the last frame."""
    last = None
    with stream:
        while (frame := stream.take(5.0)) is not None:
            last = frame
    return last


def over_zenoh(
    messages: list[Message], domain: int, eventually: Callable[[Callable[[], object]], None]
) -> dict[str, bytes]:
    """What a subscriber gets of messages that are published, by key."""
    endpoint, got = f"tcp/127.0.0.1:{free_port()}", dict[str, bytes]()
    with ZenohPublisher(SessionOptions("out", listen=endpoint), domain=domain) as out:
        listener = open_session(SessionOptions("in", endpoint))

        def note(sample: Any) -> None:
            got[str(sample.key_expr)] = sample.payload.to_bytes()

        def sent() -> bool:
            for message in messages:
                out.put(*message)
            return len(got) == len(messages)

        try:
            subscriber = listener.declare_subscriber(f"{domain}/**", note)
            eventually(sent)
            subscriber.undeclare()
        finally:
            listener.close()
    return got
