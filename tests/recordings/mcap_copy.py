"""Copies of MCAP files by the format's own library, with changed messages or layout."""

from mcap.reader import make_reader
from mcap.writer import Writer


def copied(source, target, change=lambda topic, data, k: data, **options):
    """Copy a file; `change` gives the data of the k-th message of a topic, None to leave it out."""
    with source.open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    counts, channels = {}, {}
    with target.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2", "another recorder")
        for schema, channel, message in messages:
            topic = channel.topic
            k = counts[topic] = counts.get(topic, -1) + 1
            if topic not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[topic] = writer.register_channel(topic, "cdr", kind)
            if (data := change(topic, message.data, k)) is not None:
                at_ns = message.log_time
                writer.add_message(channels[topic], at_ns, data, at_ns, message.sequence)
        writer.finish()
    return target
