"""Live sources behind one protocol: simulated, replayed, Zenoh, RealSense; opened by URI."""
