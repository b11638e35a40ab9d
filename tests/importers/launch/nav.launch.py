import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import LoadComposableNodes, Node, SetParameter
from launch_ros.descriptions import ComposableNode, ParameterFile
from nav2_common.launch import RewrittenYaml


def generate_launch_description():
    bringup_dir = get_package_share_directory('nav2_bringup')
    namespace = LaunchConfiguration('namespace')
    use_composition = LaunchConfiguration('use_composition')
    log_level = LaunchConfiguration('log_level')
    remappings = [('/tf', 'tf'), ('/tf_static', 'tf_static')]
    configured_params = ParameterFile(
        RewrittenYaml(
            source_file=LaunchConfiguration('params_file'),
            root_key=namespace,
            param_rewrites={'autostart': LaunchConfiguration('autostart')},
            convert_types=True),
        allow_substs=True)

    load_nodes = GroupAction(
        condition=IfCondition(PythonExpression(['not ', use_composition])),
        actions=[
            SetParameter('use_sim_time', LaunchConfiguration('use_sim_time')),
            Node(
                package='nav2_controller',
                executable='controller_server',
                output='screen',
                respawn=LaunchConfiguration('use_respawn'),
                respawn_delay=2.0,
                parameters=[configured_params],
                arguments=['--ros-args', '--log-level', log_level],
                remappings=remappings + [('cmd_vel', 'cmd_vel_nav')]),
            Node(
                package='nav2_lifecycle_manager',
                executable='lifecycle_manager',
                name='lifecycle_manager_navigation',
                parameters=[{'autostart': LaunchConfiguration('autostart')}, {'node_names': ['controller_server']}]),
        ])
    load_composable_nodes = GroupAction(
        condition=IfCondition(use_composition),
        actions=[
            LoadComposableNodes(
                target_container=(namespace, '/', 'nav2_container'),
                composable_node_descriptions=[ComposableNode(package='nav2_controller', plugin='nav2_controller::ControllerServer')]),
        ])

    ld = LaunchDescription()
    ld.add_action(SetEnvironmentVariable('RCUTILS_LOGGING_BUFFERED_STREAM', '1'))
    for name, default in (('namespace', ''), ('use_sim_time', 'false'), ('autostart', 'true'), ('use_composition', 'False'),
                          ('use_respawn', 'False'), ('log_level', 'info'),
                          ('params_file', os.path.join(bringup_dir, 'params', 'nav2_params.yaml'))):
        ld.add_action(DeclareLaunchArgument(name, default_value=default))
    ld.add_action(load_nodes)
    ld.add_action(load_composable_nodes)
    return ld
