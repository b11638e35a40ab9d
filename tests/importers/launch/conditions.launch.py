from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    SetEnvironmentVariable,
    SetLaunchConfiguration,
)
from launch.conditions import IfCondition, LaunchConfigurationEquals, UnlessCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PythonExpression
from launch_ros.actions import ComposableNodeContainer, LifecycleNode, Node
from launch_ros.descriptions import ComposableNode
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description():
    sim = LaunchConfiguration("sim")
    return LaunchDescription(
        [
            DeclareLaunchArgument("sim", default_value="false", choices=["true", "false"]),
            SetLaunchConfiguration("speed", "7"),
            SetEnvironmentVariable("LAB", EnvironmentVariable("LAB_OUT", default_value="eight")),
            Node(package="topic_tools", executable="relay", name="never", condition=IfCondition(sim)),
            Node(
                package="topic_tools",
                executable="relay",
                name="always",
                condition=UnlessCondition(sim),
                parameters=[
                    {
                        "speed": LaunchConfiguration("speed"),
                        "text": ParameterValue(LaunchConfiguration("speed"), value_type=str),
                        "topic": ["/lab/", LaunchConfiguration("speed")],
                        "list": [1.0, 2.5],
                        "nested": {"deep": True},
                    }
                ],
            ),
            Node(
                package="topic_tools",
                executable="relay",
                name="equal",
                condition=LaunchConfigurationEquals("speed", "7"),
            ),
            ExecuteProcess(
                cmd=["echo", ["a", sim]],
                condition=IfCondition(PythonExpression(["'", sim, "' == 'false'"])),
                shell=False,
            ),
            LifecycleNode(package="topic_tools", executable="relay", name="states", namespace=""),
            ComposableNodeContainer(
                package="rclcpp_components",
                executable="component_container",
                name="container",
                namespace="",
                composable_node_descriptions=[
                    ComposableNode(package="image_proc", plugin="image_proc::RectifyNode")
                ],
            ),
        ]
    )
