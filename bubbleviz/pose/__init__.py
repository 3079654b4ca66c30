"""Where an object is that touches the membrane: dual-stage registration and tracking."""
