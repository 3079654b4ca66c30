"""The sensor in use: what its file says, a copy with other values, changes on disk."""
