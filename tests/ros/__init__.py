"""Tests on a real ROS: ``make ros``."""
