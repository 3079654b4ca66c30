"""Live sources in the window: connecting, following, recording, publishing, a second sensor."""
