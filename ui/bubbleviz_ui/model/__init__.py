"""State of the session: open source, cursor, settings; no widgets."""
