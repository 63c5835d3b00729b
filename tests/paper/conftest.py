"""Sessions on disk."""

from cube_session import cube_session as cube_session
from paper.rigid_sessions import rigid_session as rigid_session
