"""Stand-in of the package launch_ros."""
