"""What a source offers, found while one chooses it."""

from __future__ import annotations

from PySide6.QtCore import QObject, QTimer, Signal

from bubbleviz.live.sources.live_source import LiveSource
from bubbleviz.live.sources.open_stream import open_stream
from bubbleviz.live.sources.source_uri import parse_uri
from bubbleviz.live.sources.zenoh_session import SessionOptions
from bubbleviz.live.sources.zenoh_source import ZenohSource
from bubbleviz.live.topic_names import TopicNames
from bubbleviz.sensor import Sensor
from bubbleviz_ui.engine.jobs import Done, Jobs

LOOK_MS = 250  # between looks for new topics
NOTHING = "\0"
"""No topic begins with it: topics are looked for and none is subscribed to."""


class Discovery(QObject):
    """Looks at one source at a time, until another one or none is asked for.

    Attributes
    ----------
    found : Signal
        Topics as `OfferedTopic`, and what is wrong, in a sentence; empty while nothing is.
    """

    found = Signal(object, str)

    def __init__(self) -> None:
        super().__init__()
        self._source: LiveSource | None = None
        self._asked = ""
        self._jobs = Jobs("discovery")
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self._look)

    def look_at(self, text: str, sensor: Sensor) -> None:
        """Look at a source, given as `--source`."""
        self.stop()
        self._asked = text

        def take(done: Done) -> None:
            source: LiveSource | None = done.answer
            if text != self._asked:
                self._let_go(source)
            elif source is None:
                self.found.emit((), done.message)
            else:
                self._source = source
                self._timer.start()
                self._look()

        self._jobs.run(lambda _: _begin(text, sensor), take)

    def stop(self) -> None:
        """Look at nothing."""
        self._asked = ""
        self._timer.stop()
        source, self._source = self._source, None
        self._let_go(source)

    def close(self) -> None:
        """Stop; what is on ends by itself."""
        self.stop()
        self._jobs.close(0.0)

    def _let_go(self, source: LiveSource | None) -> None:
        if source is not None:
            self._jobs.run(lambda _: source.stop())

    def _look(self) -> None:
        if self._source is not None:
            problem = self._source.problem()
            told = f"{problem} ({self._source.name})" if problem else ""
            self.found.emit(self._source.topics(), told)


def _begin(text: str, sensor: Sensor) -> LiveSource:
    """The source, started only where its topics are found by that."""
    uri = parse_uri(text)
    if uri.scheme != "zenoh":
        return open_stream(text, sensor, any_size=True).source
    topics = TopicNames(prefix=NOTHING)
    source = ZenohSource(SessionOptions.of(uri), topics, uri.options.domain)
    source.start(lambda _: None)
    return source
