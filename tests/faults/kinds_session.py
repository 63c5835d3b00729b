"""Kinds of broken session files."""

from faults.kind import Kind, replaced, written

KINDS = [
    Kind(
        "session.toml is empty",
        written("session.toml", ""),
        ("check", "."),
        ("session.toml", "format"),
    ),
    Kind(
        "a force of two components",
        replaced("session.toml", "force = [0, 0, -1.2]", "force = [0, -1.2]"),
        ("check", "."),
        ("session.toml", "force"),
    ),
]
