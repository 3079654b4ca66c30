"""Between model and solver thread: requests out, answers in, work off the GUI thread."""
