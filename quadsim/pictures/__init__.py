"""Pictures and videos of flights."""
