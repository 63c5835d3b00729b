"""A session on disk."""

from cube_session import cube_session as cube_session
