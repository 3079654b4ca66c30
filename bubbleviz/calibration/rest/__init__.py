"""The sensor at rest: contact-free frames, depth statistics, pixels to trust."""
