"""Error of shear force, torque and slip against truths with friction."""
