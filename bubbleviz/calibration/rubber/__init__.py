"""What inflation or a press tells of the rubber: pre-stretch, gauge and atmospheric pressure."""
