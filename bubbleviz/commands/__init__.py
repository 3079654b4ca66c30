"""The work behind the commands, one file a command."""
