"""Live sources: connecting, recording, publishing, a second sensor."""
