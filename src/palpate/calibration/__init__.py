"""Cameras calibrated from pictures of boards."""
