from launch import LaunchDescription
from launch.actions import EmitEvent, ExecuteProcess, LogInfo, RegisterEventHandler, TimerAction
from launch.event_handlers import OnProcessExit, OnProcessIO, OnProcessStart
from launch.events import Shutdown
from launch_ros.actions import Node


def generate_launch_description():
    prepare = ExecuteProcess(cmd=["mkdir", "-p", "/tmp/maps"], name="prepare")
    slam = Node(package="topic_tools", executable="relay", name="slam")
    nav = Node(package="topic_tools", executable="relay", name="nav", respawn=True, respawn_delay=2.0)
    late = Node(package="topic_tools", executable="relay", name="late")
    return LaunchDescription(
        [
            prepare,
            RegisterEventHandler(
                OnProcessExit(target_action=prepare, on_exit=[slam, LogInfo(msg="prepared")])
            ),
            RegisterEventHandler(OnProcessStart(target_action=slam, on_start=[nav])),
            RegisterEventHandler(OnProcessExit(target_action=nav, on_exit=[EmitEvent(event=Shutdown())])),
            RegisterEventHandler(OnProcessIO(target_action=nav, on_stdout=lambda event: None)),
            TimerAction(period=3.0, actions=[late]),
        ]
    )
