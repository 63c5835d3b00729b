"""The virtual measurement facility."""
