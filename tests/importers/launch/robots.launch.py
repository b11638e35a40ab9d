from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def make_robots(context, prefix):
    count = int(LaunchConfiguration("count").perform(context))
    return [
        Node(
            package="topic_tools",
            executable="relay",
            name="slam",
            namespace=f"{prefix}{number}",
            remappings=[("scan", f"/{prefix}{number}/scan")],
            parameters=[{"frame": f"{prefix}{number}_map"}],
        )
        for number in range(1, count + 1)
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("count", default_value="2", description="how many"),
            OpaqueFunction(function=make_robots, args=["robot"]),
        ]
    )
