"""Fixtures of the room."""

from cube_green import green as green, session as session
