# SPDX-License-Identifier: Apache-2.0
"""A node of rospy for launch files: it subscribes to fixed names, so that the graph shows its remaps."""

import os
import sys

import rospy  # type: ignore[import-not-found]
from std_msgs.msg import String  # type: ignore[import-not-found]

if __name__ == "__main__":
    rospy.init_node(os.path.basename(sys.argv[0]))  # noqa: PTH119
    for name in os.environ["LAB_NAMES"].split():
        rospy.Subscriber(name, String, lambda _: None)
    rospy.spin()
