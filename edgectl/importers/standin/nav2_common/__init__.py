"""Stand-in of the package nav2_common."""
