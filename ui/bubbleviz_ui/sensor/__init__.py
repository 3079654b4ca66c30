"""Sensor panel: values of the sensor file, editing of a copy, changes on disk."""
