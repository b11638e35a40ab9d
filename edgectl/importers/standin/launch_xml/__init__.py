"""Stand-in of the package launch_xml."""
