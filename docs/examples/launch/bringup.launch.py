from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, RegisterEventHandler
from launch.event_handlers import OnProcessStart
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description():
    slam = Node(package="slam_toolbox", executable="async_slam_toolbox_node", name="slam",
                namespace=LaunchConfiguration("robot"), parameters=[{"use_sim_time": False}])
    nav = Node(package="nav2_controller", executable="controller_server", namespace=LaunchConfiguration("robot"))
    return LaunchDescription([
        DeclareLaunchArgument("robot", default_value="robot1"),
        slam,
        RegisterEventHandler(OnProcessStart(target_action=slam, on_start=[nav])),
    ])
