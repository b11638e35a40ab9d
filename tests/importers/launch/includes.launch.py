import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution, ThisLaunchFileDir
from launch_ros.actions import Node, PushRosNamespace, SetParameter, SetRemap
from launch_ros.substitutions import FindPackageShare
from launch_xml.launch_description_sources import XMLLaunchDescriptionSource


def generate_launch_description():
    share = get_package_share_directory("lab_bringup")
    deep = XMLLaunchDescriptionSource(os.path.join(share, "launch", "level3.launch.xml"))
    return LaunchDescription(
        [
            GroupAction(
                [
                    PushRosNamespace("lab"),
                    SetParameter(name="use_sim_time", value=True),
                    SetRemap(src="chatter", dst="/lab/chatter"),
                    IncludeLaunchDescription(
                        deep, launch_arguments={"rate": "4", "topic": "/lab/in"}.items()
                    ),
                    IncludeLaunchDescription(
                        PythonLaunchDescriptionSource([ThisLaunchFileDir(), "/minimal.launch.py"])
                    ),
                ]
            ),
            Node(
                package="topic_tools",
                executable="relay",
                parameters=[
                    os.path.join(share, "config", "gains.yaml"),
                    PathJoinSubstitution([FindPackageShare("elsewhere"), "config", "more.yaml"]),
                ],
            ),
        ]
    )
