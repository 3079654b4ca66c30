"""What inflation tells of the rubber: pre-stretch, gauge pressure, atmospheric pressure."""
