from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    print("this goes nowhere")
    return LaunchDescription(
        [Node(package="topic_tools", executable="relay", name="relay", arguments=["/chatter", "/copy"])]
    )
